/// Pictures side by side, each with its name above it.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "app/image.h"

namespace energyprof::app {

struct Tile {
  std::string label;  ///< A to Z, 0 to 9, '_' and ' ' are drawn, lower case as upper case
  Image image;        ///< all tiles of a montage have the same size
};

/// `image` shrunk by a whole number, averaging, to at most `max_width`.
Image shrink(const Image& image, uint32_t max_width);

/// Writes `text` into the image, letters of 5x7 pixels times `scale`; what does not fit is cut off.
void draw_text(Image& image, uint32_t x, uint32_t y, std::string_view text, uint32_t scale);

/// The tiles row by row in `columns` columns. Where a `full_scale` is given, a bar below them has
/// the heat map's colours from 0 to that cost. Empty without tiles.
Image montage(std::span<const Tile> tiles, uint32_t columns, std::optional<int> full_scale);

}  // namespace energyprof::app
