#include "analysis/shrink_png.h"

#include <gtest/gtest.h>
#include <png.h>

#include <vector>

namespace energyprof::analysis {
namespace {

png_image header(uint32_t width, uint32_t height) {
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  image.width = width;
  image.height = height;
  image.format = PNG_FORMAT_RGB;
  return image;
}

std::string png_of(uint32_t width, uint32_t height, const std::vector<uint8_t>& rgb) {
  png_image image = header(width, height);
  png_alloc_size_t bytes = 0;
  png_image_write_to_memory(&image, nullptr, &bytes, 0, rgb.data(), 0, nullptr);
  std::string file(bytes, '\0');
  png_image_write_to_memory(&image, file.data(), &bytes, 0, rgb.data(), 0, nullptr);
  return file;
}

std::vector<uint8_t> pixels_of(const std::string& file, uint32_t width, uint32_t height) {
  png_image image = header(0, 0);
  EXPECT_NE(png_image_begin_read_from_memory(&image, file.data(), file.size()), 0);
  EXPECT_EQ(image.width, width);
  EXPECT_EQ(image.height, height);
  image.format = PNG_FORMAT_RGB;
  std::vector<uint8_t> rgb(PNG_IMAGE_SIZE(image));
  EXPECT_NE(png_image_finish_read(&image, nullptr, rgb.data(), 0, nullptr), 0);
  return rgb;
}

TEST(ShrinkPng, TakesTheMeanOfFourPixels) {
  // Four by two, of which each two by two are 10, 20, 30, 40 and 0, 0, 0, 255.
  std::vector<uint8_t> rgb;
  for (const int value : {10, 20, 0, 0, 30, 40, 0, 255})
    for (int c = 0; c < 3; ++c) rgb.push_back(static_cast<uint8_t>(value));
  EXPECT_EQ(pixels_of(shrink_png(png_of(4, 2, rgb), 3), 2, 1),
            (std::vector<uint8_t>{25, 25, 25, 64, 64, 64}));
}

TEST(ShrinkPng, HalvesUntilItFits) {
  const std::string file = png_of(50, 20, std::vector<uint8_t>(3 * 50 * 20, 7));
  EXPECT_EQ(pixels_of(shrink_png(file, 13), 12, 5), std::vector<uint8_t>(3 * 12 * 5, 7));
}

TEST(ShrinkPng, LeavesAloneWhatFitsAndWhatIsNoPicture) {
  const std::string file = png_of(8, 8, std::vector<uint8_t>(3 * 64, 1));
  EXPECT_EQ(shrink_png(file, 8), file);
  EXPECT_EQ(shrink_png("no picture", 8), "no picture");
  EXPECT_EQ(shrink_png(file.substr(0, file.size() / 2), 4), file.substr(0, file.size() / 2));
}

}  // namespace
}  // namespace energyprof::analysis
