#include "app/png.h"

#include <fmt/format.h>
#include <png.h>

#include <cerrno>
#include <cstring>
#include <stdexcept>

namespace energyprof::app {

void write_png(const std::filesystem::path& file, uint32_t width, uint32_t height,
               std::span<const uint8_t> rgb) {
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  image.width = width;
  image.height = height;
  image.format = PNG_FORMAT_RGB;
  const std::filesystem::path unfinished = file.string() + ".part";
  errno = 0;
  if (png_image_write_to_file(&image, unfinished.c_str(), 0, rgb.data(), 0, nullptr) == 0) {
    const std::string why = errno != 0 ? std::strerror(errno) : image.message;
    std::error_code ignored;
    std::filesystem::remove(unfinished, ignored);
    throw std::runtime_error(fmt::format("cannot write '{}': {}.", file.string(), why));
  }
  std::filesystem::rename(unfinished, file);
}

}  // namespace energyprof::app
