#include "app/montage.h"

#include <algorithm>
#include <array>
#include <cctype>

#include "app/heat_map.h"

namespace energyprof::app {
namespace {

constexpr uint32_t glyph_width = 5;
constexpr uint32_t glyph_height = 7;
constexpr uint32_t advance = glyph_width + 1;
constexpr uint32_t gap = 4;
constexpr uint32_t bar_height = 10;
constexpr Rgb paper{255, 255, 255};
constexpr Rgb ink{16, 16, 16};

/// Rows from the top, the leftmost pixel in bit 4.
using Glyph = std::array<uint8_t, glyph_height>;
constexpr std::array<Glyph, 10> digits{{{0x0E, 0x11, 0x11, 0x15, 0x11, 0x11, 0x0E},
                                        {0x04, 0x0C, 0x14, 0x04, 0x04, 0x04, 0x1F},
                                        {0x0E, 0x11, 0x01, 0x06, 0x08, 0x10, 0x1F},
                                        {0x0E, 0x11, 0x01, 0x06, 0x01, 0x11, 0x0E},
                                        {0x02, 0x06, 0x0A, 0x12, 0x1F, 0x02, 0x02},
                                        {0x1F, 0x10, 0x1E, 0x01, 0x01, 0x11, 0x0E},
                                        {0x06, 0x08, 0x10, 0x1E, 0x11, 0x11, 0x0E},
                                        {0x1F, 0x01, 0x02, 0x02, 0x04, 0x04, 0x04},
                                        {0x0E, 0x11, 0x11, 0x0E, 0x11, 0x11, 0x0E},
                                        {0x0E, 0x11, 0x11, 0x0F, 0x01, 0x02, 0x0C}}};
constexpr std::array<Glyph, 26> letters{{{0x04, 0x0A, 0x11, 0x11, 0x1F, 0x11, 0x11},    // A
                                         {0x1E, 0x11, 0x11, 0x1E, 0x11, 0x11, 0x1E},    // B
                                         {0x0E, 0x11, 0x10, 0x10, 0x10, 0x11, 0x0E},    // C
                                         {0x1E, 0x11, 0x11, 0x11, 0x11, 0x11, 0x1E},    // D
                                         {0x1F, 0x10, 0x10, 0x1E, 0x10, 0x10, 0x1F},    // E
                                         {0x1F, 0x10, 0x10, 0x1E, 0x10, 0x10, 0x10},    // F
                                         {0x0E, 0x11, 0x10, 0x17, 0x11, 0x11, 0x0F},    // G
                                         {0x11, 0x11, 0x11, 0x1F, 0x11, 0x11, 0x11},    // H
                                         {0x0E, 0x04, 0x04, 0x04, 0x04, 0x04, 0x0E},    // I
                                         {0x07, 0x02, 0x02, 0x02, 0x02, 0x12, 0x0C},    // J
                                         {0x11, 0x12, 0x14, 0x18, 0x14, 0x12, 0x11},    // K
                                         {0x10, 0x10, 0x10, 0x10, 0x10, 0x10, 0x1F},    // L
                                         {0x11, 0x1B, 0x15, 0x15, 0x11, 0x11, 0x11},    // M
                                         {0x11, 0x19, 0x19, 0x15, 0x13, 0x13, 0x11},    // N
                                         {0x0E, 0x11, 0x11, 0x11, 0x11, 0x11, 0x0E},    // O
                                         {0x1E, 0x11, 0x11, 0x1E, 0x10, 0x10, 0x10},    // P
                                         {0x0E, 0x11, 0x11, 0x11, 0x15, 0x12, 0x0D},    // Q
                                         {0x1E, 0x11, 0x11, 0x1E, 0x14, 0x12, 0x11},    // R
                                         {0x0F, 0x10, 0x10, 0x0E, 0x01, 0x01, 0x1E},    // S
                                         {0x1F, 0x04, 0x04, 0x04, 0x04, 0x04, 0x04},    // T
                                         {0x11, 0x11, 0x11, 0x11, 0x11, 0x11, 0x0E},    // U
                                         {0x11, 0x11, 0x11, 0x11, 0x0A, 0x0A, 0x04},    // V
                                         {0x11, 0x11, 0x11, 0x15, 0x15, 0x1B, 0x11},    // W
                                         {0x11, 0x11, 0x0A, 0x04, 0x0A, 0x11, 0x11},    // X
                                         {0x11, 0x11, 0x0A, 0x04, 0x04, 0x04, 0x04},    // Y
                                         {0x1F, 0x01, 0x02, 0x04, 0x08, 0x10, 0x1F}}};  // Z
constexpr Glyph underscore{0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x1F};
constexpr Glyph blank{};

const Glyph& glyph_of(char c) {
  const auto letter = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  if (letter >= '0' && letter <= '9') return digits[static_cast<size_t>(letter - '0')];
  if (letter >= 'A' && letter <= 'Z') return letters[static_cast<size_t>(letter - 'A')];
  return letter == '_' ? underscore : blank;
}

uint32_t text_width(std::string_view text, uint32_t scale) {
  return static_cast<uint32_t>(text.size()) * advance * scale;
}

void copy(const Image& from, Image& to, uint32_t x, uint32_t y) {
  for (uint32_t row = 0; row < from.height; ++row)
    std::copy_n(from.rgb.data() + from.offset(0, row), size_t{3} * from.width,
                to.rgb.data() + to.offset(x, y + row));
}

/// The colours from 0 to the full scale over the whole width, and the numbers below.
void draw_bar(Image& image, uint32_t y, int full_scale, uint32_t scale) {
  const uint32_t width = image.width - 2 * gap;
  for (uint32_t x = 0; x < width; ++x)
    for (uint32_t row = 0; row < bar_height * scale; ++row)
      image.set(gap + x, y + row, plasma(static_cast<float>(x) / static_cast<float>(width)));
  const uint32_t text_y = y + bar_height * scale + gap;
  const std::string end = std::to_string(full_scale);
  draw_text(image, gap, text_y, "0", scale);
  draw_text(image, image.width - gap - std::min(text_width(end, scale), width), text_y, end, scale);
  constexpr std::string_view title = "COST PER PIXEL";
  if (text_width(title, scale) + 4 * text_width(end, scale) < width)
    draw_text(image, (image.width - text_width(title, scale)) / 2, text_y, title, scale);
}

}  // namespace

Image shrink(const Image& image, uint32_t max_width) {
  const uint32_t factor = (image.width + max_width - 1) / max_width;
  if (factor <= 1) return image;
  Image small(std::max(image.width / factor, 1u), std::max(image.height / factor, 1u));
  for (uint32_t y = 0; y < small.height; ++y)
    for (uint32_t x = 0; x < small.width; ++x) {
      std::array<uint32_t, 3> sum{};
      uint32_t count = 0;
      for (uint32_t v = y * factor; v < std::min((y + 1) * factor, image.height); ++v)
        for (uint32_t u = x * factor; u < (x + 1) * factor; ++u, ++count)
          for (size_t c = 0; c < 3; ++c) sum[c] += image.rgb[image.offset(u, v) + c];
      const auto mean = [&](size_t c) {
        return static_cast<uint8_t>((sum[c] + count / 2) / count);
      };
      small.set(x, y, {mean(0), mean(1), mean(2)});
    }
  return small;
}

void draw_text(Image& image, uint32_t x, uint32_t y, std::string_view text, uint32_t scale) {
  for (const char c : text) {
    const Glyph& glyph = glyph_of(c);
    for (uint32_t row = 0; row < glyph_height * scale; ++row)
      for (uint32_t column = 0; column < glyph_width * scale; ++column)
        if ((glyph[row / scale] >> (glyph_width - 1 - column / scale) & 1u) != 0)
          image.set(x + column, y + row, ink);
    x += advance * scale;
  }
}

Image montage(std::span<const Tile> tiles, uint32_t columns, std::optional<int> full_scale) {
  if (tiles.empty()) return {};
  const Image& first = tiles.front().image;
  const auto count = static_cast<uint32_t>(tiles.size());
  columns = std::min(columns, count);
  const uint32_t rows = (count + columns - 1) / columns;
  const uint32_t scale = first.width >= 240 ? 2 : 1;
  const uint32_t label_height = glyph_height * scale + 2 * gap;
  const uint32_t row_height = label_height + first.height;
  const uint32_t bar = full_scale ? (bar_height + glyph_height) * scale + 2 * gap : 0;
  Image image(columns * (first.width + gap) + gap, rows * row_height + gap + bar, paper);
  for (uint32_t i = 0; i < count; ++i) {
    const uint32_t x = gap + i % columns * (first.width + gap);
    const uint32_t y = i / columns * row_height;
    // A label that is wider than its tile ends there.
    const auto fitting = std::max<size_t>(1, first.width / (advance * scale));
    draw_text(image, x, y + gap, std::string_view(tiles[i].label).substr(0, fitting), scale);
    copy(tiles[i].image, image, x, y + label_height);
  }
  if (full_scale) draw_bar(image, rows * row_height + gap, *full_scale, scale);
  return image;
}

}  // namespace energyprof::app
