#include "analysis/shrink_png.h"

#include <png.h>

#include <cstddef>
#include <vector>

namespace energyprof::analysis {
namespace {

struct Picture {
  uint32_t width = 0;
  uint32_t height = 0;
  std::vector<uint8_t> rgb;
};

/// Without the last row or column of an odd size.
Picture halved(const Picture& from) {
  Picture to{from.width / 2, from.height / 2, {}};
  to.rgb.reserve(std::size_t{3} * to.width * to.height);
  const std::size_t row_bytes = std::size_t{3} * from.width;
  for (std::size_t y = 0; y < to.height; ++y)
    for (std::size_t x = 0; x < to.width; ++x)
      for (std::size_t c = 0; c < 3; ++c) {
        const uint8_t* corner = from.rgb.data() + 2 * y * row_bytes + 6 * x + c;
        to.rgb.push_back(static_cast<uint8_t>(
            (corner[0] + corner[3] + corner[row_bytes] + corner[row_bytes + 3] + 2) / 4));
      }
  return to;
}

}  // namespace

std::string shrink_png(std::string file, uint32_t max_width) {
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  if (png_image_begin_read_from_memory(&image, file.data(), file.size()) == 0) return file;
  if (image.width <= max_width || image.height < 2) {
    png_image_free(&image);
    return file;
  }
  image.format = PNG_FORMAT_RGB;
  Picture picture{image.width, image.height, std::vector<uint8_t>(PNG_IMAGE_SIZE(image))};
  if (png_image_finish_read(&image, nullptr, picture.rgb.data(), 0, nullptr) == 0) return file;
  while (picture.width > max_width && picture.height >= 2) picture = halved(picture);

  png_image small{};
  small.version = PNG_IMAGE_VERSION;
  small.width = picture.width;
  small.height = picture.height;
  small.format = PNG_FORMAT_RGB;
  png_alloc_size_t bytes = 0;
  if (png_image_write_to_memory(&small, nullptr, &bytes, 0, picture.rgb.data(), 0, nullptr) == 0)
    return file;
  std::string shrunk(bytes, '\0');
  if (png_image_write_to_memory(&small, shrunk.data(), &bytes, 0, picture.rgb.data(), 0, nullptr) ==
      0)
    return file;
  shrunk.resize(bytes);
  return shrunk;
}

}  // namespace energyprof::analysis
