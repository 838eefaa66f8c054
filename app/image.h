/// 8-bit RGB images.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace energyprof::app {

struct Rgb {
  uint8_t r = 0;
  uint8_t g = 0;
  uint8_t b = 0;

  bool operator==(const Rgb&) const = default;
};

struct Image {
  uint32_t width = 0;
  uint32_t height = 0;
  std::vector<uint8_t> rgb;  ///< row by row from the top, 3 bytes a pixel

  Image() = default;
  Image(uint32_t w, uint32_t h, Rgb colour = {}) : width(w), height(h), rgb(size_t{3} * w * h) {
    for (size_t i = 0; i < rgb.size(); i += 3) {
      rgb[i] = colour.r;
      rgb[i + 1] = colour.g;
      rgb[i + 2] = colour.b;
    }
  }

  [[nodiscard]] size_t offset(uint32_t x, uint32_t y) const { return 3 * (size_t{y} * width + x); }
  [[nodiscard]] Rgb at(uint32_t x, uint32_t y) const {
    const size_t i = offset(x, y);
    return {rgb[i], rgb[i + 1], rgb[i + 2]};
  }
  /// Outside the image nothing is drawn.
  void set(uint32_t x, uint32_t y, Rgb colour) {
    if (x >= width || y >= height) return;
    const size_t i = offset(x, y);
    rgb[i] = colour.r;
    rgb[i + 1] = colour.g;
    rgb[i + 2] = colour.b;
  }
};

}  // namespace energyprof::app
