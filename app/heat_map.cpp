#include "app/heat_map.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace energyprof::app {
namespace {

/// Ten equally spaced colours of "plasma", by N. Smith and S. van der Walt, matplotlib 1.5, 2015
/// (released under CC0); between them sRGB is interpolated linearly.
constexpr std::array<Rgb, 10> plasma_stops{{{13, 8, 135},
                                            {70, 3, 159},
                                            {114, 1, 168},
                                            {156, 23, 158},
                                            {189, 55, 134},
                                            {216, 87, 107},
                                            {237, 121, 83},
                                            {251, 159, 58},
                                            {253, 202, 38},
                                            {240, 249, 33}}};

uint8_t mix(uint8_t a, uint8_t b, float share) {
  return static_cast<uint8_t>(
      std::lround(static_cast<float>(a) + share * (static_cast<float>(b) - static_cast<float>(a))));
}

}  // namespace

float heat_cost(const gpu::PixelCounts& counts) {
  return 0.5f * static_cast<float>(counts.box_tests) + static_cast<float>(counts.prim_tests);
}

float heat_full_scale(std::string_view model) {
  return model == "teapot" || model.starts_with("teapot:") ? 40.0f : 50.0f;
}

Rgb plasma(float share) {
  const float place = std::clamp(share, 0.0f, 1.0f) * static_cast<float>(plasma_stops.size() - 1);
  const size_t below = std::min(static_cast<size_t>(place), plasma_stops.size() - 2);
  const float rest = place - static_cast<float>(below);
  const Rgb& a = plasma_stops[below];
  const Rgb& b = plasma_stops[below + 1];
  return {mix(a.r, b.r, rest), mix(a.g, b.g, rest), mix(a.b, b.b, rest)};
}

Image heat_map(std::span<const gpu::PixelCounts> counts, uint32_t width, uint32_t height,
               float full_scale) {
  Image image(width, height);
  for (uint32_t y = 0; y < height; ++y)
    for (uint32_t x = 0; x < width; ++x)
      image.set(x, y, plasma(heat_cost(counts[size_t{y} * width + x]) / full_scale));
  return image;
}

}  // namespace energyprof::app
