#include "analysis/shrink_png.h"

#include <png.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <optional>
#include <utility>
#include <vector>

namespace energyprof::analysis {
namespace {

constexpr std::size_t max_color_count = 64;

struct Picture {
  uint32_t width = 0;
  uint32_t height = 0;
  std::vector<uint8_t> rgb;
};

std::optional<Picture> read_png(const std::string& file) {
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  if (png_image_begin_read_from_memory(&image, file.data(), file.size()) == 0) return std::nullopt;
  image.format = PNG_FORMAT_RGB;
  Picture picture{image.width, image.height, std::vector<uint8_t>(PNG_IMAGE_SIZE(image))};
  if (png_image_finish_read(&image, nullptr, picture.rgb.data(), 0, nullptr) == 0)
    return std::nullopt;
  return picture;
}

/// Each pixel the mean of the whole pixels whose place it takes.
Picture resized(const Picture& from, uint32_t width) {
  const uint32_t height =
      std::max(1u, static_cast<uint32_t>(uint64_t{from.height} * width / from.width));
  Picture to{width, height, {}};
  to.rgb.reserve(std::size_t{3} * width * height);
  const auto edge = [](uint32_t i, uint32_t of, uint32_t count) {
    return static_cast<uint32_t>(uint64_t{i} * of / count);
  };
  for (uint32_t y = 0; y < height; ++y)
    for (uint32_t x = 0; x < width; ++x) {
      std::array<uint64_t, 3> sum{};
      uint64_t count = 0;
      for (uint32_t v = edge(y, from.height, height); v < edge(y + 1, from.height, height); ++v)
        for (uint32_t u = edge(x, from.width, width); u < edge(x + 1, from.width, width); ++u) {
          const uint8_t* pixel = from.rgb.data() + 3 * (std::size_t{v} * from.width + u);
          for (std::size_t c = 0; c < 3; ++c) sum[c] += pixel[c];
          ++count;
        }
      for (const uint64_t total : sum)
        to.rgb.push_back(static_cast<uint8_t>((total + count / 2) / count));
    }
  return to;
}

/// Colours of a picture that become one.
struct Box {
  struct Color {
    std::array<uint8_t, 3> rgb;
    std::size_t count;
  };
  std::vector<Color> colors;
  std::array<double, 3> mean{};
  std::size_t axis = 0;   ///< the channel in which its pixels differ most
  double deviation2 = 0;  ///< sum over its pixels, in that channel
};

Box box_of(std::vector<Box::Color> colors) {
  Box box;
  box.colors = std::move(colors);
  double count = 0;
  for (const Box::Color& color : box.colors) {
    count += static_cast<double>(color.count);
    for (std::size_t c = 0; c < 3; ++c)
      box.mean[c] += static_cast<double>(color.count) * color.rgb[c];
  }
  for (double& mean : box.mean) mean /= count;
  for (std::size_t c = 0; c < 3; ++c) {
    double deviation2 = 0;
    for (const Box::Color& color : box.colors)
      deviation2 += static_cast<double>(color.count) * (color.rgb[c] - box.mean[c]) *
                    (color.rgb[c] - box.mean[c]);
    if (deviation2 > box.deviation2) {
      box.deviation2 = deviation2;
      box.axis = c;
    }
  }
  return box;
}

constexpr unsigned bin_bits = 6;

/// Colours that differ in their last two bits only are one from the start.
std::size_t bin_of(const uint8_t* rgb) {
  std::size_t bin = 0;
  for (std::size_t c = 0; c < 3; ++c) bin = bin << bin_bits | rgb[c] >> (8 - bin_bits);
  return bin;
}

/// The colours of the picture in at most `max_color_count` boxes: the one that differs most within
/// is split at its mean until there are so many, after "Variance-based color image quantization for
/// frame buffer display", by S. J. Wan, P. Prusinkiewicz and S. K. M. Wong, Color Research and
/// Application 15(1), 1990.
std::vector<Box> color_boxes(const Picture& picture) {
  struct Bin {
    std::size_t count = 0;
    std::array<std::size_t, 3> sum{};
  };
  std::vector<Bin> bins(std::size_t{1} << 3 * bin_bits);
  for (std::size_t i = 0; i < picture.rgb.size(); i += 3) {
    Bin& bin = bins[bin_of(&picture.rgb[i])];
    ++bin.count;
    for (std::size_t c = 0; c < 3; ++c) bin.sum[c] += picture.rgb[i + c];
  }
  std::vector<Box::Color> all;
  for (const Bin& bin : bins) {
    if (bin.count == 0) continue;
    Box::Color color{{}, bin.count};
    for (std::size_t c = 0; c < 3; ++c)
      color.rgb[c] = static_cast<uint8_t>((bin.sum[c] + bin.count / 2) / bin.count);
    all.push_back(color);
  }
  std::vector<Box> boxes{box_of(std::move(all))};
  while (boxes.size() < max_color_count) {
    const auto widest =
        std::max_element(boxes.begin(), boxes.end(),
                         [](const Box& a, const Box& b) { return a.deviation2 < b.deviation2; });
    std::vector<Box::Color> low;
    std::vector<Box::Color> high;
    for (const Box::Color& color : widest->colors)
      (color.rgb[widest->axis] <= widest->mean[widest->axis] ? low : high).push_back(color);
    // All are the same, but for what rounding leaves.
    if (low.empty() || high.empty()) break;
    *widest = box_of(std::move(low));
    boxes.push_back(box_of(std::move(high)));
  }
  return boxes;
}

std::optional<std::string> png_of(const Picture& picture) {
  const std::vector<Box> boxes = color_boxes(picture);
  std::vector<uint8_t> palette;
  // The mean of a bin lies in the bin.
  std::vector<uint8_t> index_of(std::size_t{1} << 3 * bin_bits);
  for (std::size_t k = 0; k < boxes.size(); ++k) {
    for (const double mean : boxes[k].mean)
      palette.push_back(static_cast<uint8_t>(std::lround(mean)));
    for (const Box::Color& color : boxes[k].colors)
      index_of[bin_of(color.rgb.data())] = static_cast<uint8_t>(k);
  }
  std::vector<uint8_t> indices;
  indices.reserve(picture.rgb.size() / 3);
  for (std::size_t i = 0; i < picture.rgb.size(); i += 3)
    indices.push_back(index_of[bin_of(&picture.rgb[i])]);

  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  image.width = picture.width;
  image.height = picture.height;
  image.format = PNG_FORMAT_RGB_COLORMAP;
  image.colormap_entries = static_cast<uint32_t>(boxes.size());
  png_alloc_size_t bytes = 0;
  if (png_image_write_to_memory(&image, nullptr, &bytes, 0, indices.data(), 0, palette.data()) == 0)
    return std::nullopt;
  std::string file(bytes, '\0');
  if (png_image_write_to_memory(&image, file.data(), &bytes, 0, indices.data(), 0,
                                palette.data()) == 0)
    return std::nullopt;
  file.resize(bytes);
  return file;
}

}  // namespace

std::string shrink_png(std::string file, uint32_t max_width) {
  std::optional<Picture> picture = read_png(file);
  if (!picture) return file;
  if (picture->width > max_width) picture = resized(*picture, max_width);
  std::optional<std::string> small = png_of(*picture);
  return small && small->size() < file.size() ? std::move(*small) : file;
}

}  // namespace energyprof::analysis
