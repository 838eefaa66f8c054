/// Pictures small enough to stand in a page.
#pragma once

#include <cstdint>
#include <string>

namespace energyprof::analysis {

/// A PNG file's bytes with the picture at most `max_width` wide, each pixel the mean of those it
/// stands for, in 64 colours chosen for it: heat maps and shaded models lose nothing that eyes see,
/// and take a third of the bytes. What gets no smaller by that, or is no PNG, comes back as it is.
std::string shrink_png(std::string file, uint32_t max_width);

}  // namespace energyprof::analysis
