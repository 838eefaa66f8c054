/// Pictures small enough to stand in a page.
#pragma once

#include <cstdint>
#include <string>

namespace energyprof::analysis {

/// A PNG file's bytes with the picture halved as often as it takes to be at most `max_width` wide,
/// each pixel the mean of four; what is small enough, or no PNG, comes back as it is.
std::string shrink_png(std::string file, uint32_t max_width);

}  // namespace energyprof::analysis
