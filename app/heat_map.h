/// What each pixel cost, as colours.
#pragma once

#include <span>
#include <string_view>

#include "app/image.h"
#include "core/gpu_layout.h"

namespace energyprof::app {

/// The cost of a pixel in the study that this project repeats: half a box test, plus triangle
/// tests.
float heat_cost(const gpu::PixelCounts& counts);

/// The cost that the brightest colour stands for: 40 for the teapot, 50 for any other model.
float heat_full_scale(std::string_view model);

/// The colour of `share`, 0 to 1 and cut off there: matplotlib's colour map "plasma".
Rgb plasma(float share);

/// One pixel a pixel; `counts` row by row.
Image heat_map(std::span<const gpu::PixelCounts> counts, uint32_t width, uint32_t height,
               float full_scale);

}  // namespace energyprof::app
