#include "analysis/shrink_png.h"

#include <gtest/gtest.h>
#include <png.h>

#include <algorithm>
#include <cmath>
#include <random>
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

/// A heat map as the kernels' counts make them: smooth shades along one curve through the colours,
/// with noise.
std::vector<uint8_t> heat(uint32_t width, uint32_t height) {
  std::mt19937 random(1);
  std::vector<uint8_t> rgb;
  for (uint32_t y = 0; y < height; ++y)
    for (uint32_t x = 0; x < width; ++x) {
      const double t = std::clamp(0.5 + 0.4 * std::sin(x * 0.02) * std::cos(y * 0.03) +
                                      0.0004 * static_cast<double>(random() % 200),
                                  0.0, 1.0);
      rgb.push_back(static_cast<uint8_t>(240 * t));
      rgb.push_back(static_cast<uint8_t>(250 * t * t));
      rgb.push_back(static_cast<uint8_t>(130 + 90 * std::sin(3 * t)));
    }
  return rgb;
}

TEST(ShrinkPng, TakesTheMeanOfThePixelsThatOneStandsFor) {
  // Four by two, of which each two by two are 10, 20, 30, 40 and 0, 0, 0, 255.
  std::vector<uint8_t> rgb;
  for (const int value : {10, 20, 0, 0, 30, 40, 0, 255})
    for (int c = 0; c < 3; ++c) rgb.push_back(static_cast<uint8_t>(value));
  // Padded, as a file of eight pixels is no larger than one of two.
  const std::string file = png_of(4, 2, rgb) + std::string(1000, ' ');
  EXPECT_EQ(pixels_of(shrink_png(file, 2), 2, 1), (std::vector<uint8_t>{25, 25, 25, 64, 64, 64}));
}

TEST(ShrinkPng, GivesAnyWidthAndKeepsTheShape) {
  const std::string file = png_of(500, 200, heat(500, 200));
  for (const uint32_t width : {13u, 240u}) {
    const std::string small = shrink_png(file, width);
    pixels_of(small, width, 200 * width / 500);
  }
}

TEST(ShrinkPng, TakesAThirdOfTheBytesAndLooksTheSame) {
  const std::vector<uint8_t> rgb = heat(320, 180);
  const std::string file = png_of(320, 180, rgb);
  const std::string small = shrink_png(file, 320);
  EXPECT_LT(3 * small.size(), file.size() * 11 / 10);
  const std::vector<uint8_t> seen = pixels_of(small, 320, 180);
  double error2 = 0;
  for (std::size_t i = 0; i < rgb.size(); ++i) error2 += (rgb[i] - seen[i]) * (rgb[i] - seen[i]);
  EXPECT_LT(std::sqrt(error2 / static_cast<double>(rgb.size())), 2) << "of 255";
}

TEST(ShrinkPng, LeavesAloneWhatGetsNoSmallerAndWhatIsNoPicture) {
  const std::string file = png_of(8, 8, std::vector<uint8_t>(3 * 64, 1));
  EXPECT_LE(shrink_png(file, 8).size(), file.size());
  EXPECT_EQ(shrink_png(shrink_png(file, 8), 8), shrink_png(file, 8));
  EXPECT_EQ(shrink_png("no picture", 8), "no picture");
  EXPECT_EQ(shrink_png(file.substr(0, file.size() / 2), 4), file.substr(0, file.size() / 2));
}

}  // namespace
}  // namespace energyprof::analysis
