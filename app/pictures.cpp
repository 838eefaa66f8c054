#include "app/pictures.h"

#include <fmt/format.h>

#include <array>
#include <cctype>
#include <cmath>

#include "app/heat_map.h"
#include "app/montage.h"
#include "app/png.h"
#include "core/trace_math.h"

namespace energyprof::app {
namespace {

constexpr uint32_t max_tile_width = 640;
constexpr const char* reference_label = "REFERENCE";
constexpr const char* stackless = "BVH_STACKLESS_DF";
/// The tiles of the study's figure 6; KD_STACK is ours.
constexpr std::array<const char*, 7> tile_order{reference_label, "BVH_FTB_BF", "BVH_FTB_DF", "GRID",
                                                "KD_TREE",       "KD_STACK",   stackless};

/// Letters, digits, '.', '-' and '_' of `text`; the rest becomes '_'.
std::string file_name_part(std::string_view text) {
  std::string name;
  for (const char c : text)
    name += std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '.' || c == '-' ? c : '_';
  return name;
}

std::string view_name(const std::string& model, int64_t view) {
  return fmt::format("{}_view{}", file_name_part(model), view);
}

int bar_end(const std::string& model) { return static_cast<int>(heat_full_scale(model)); }

}  // namespace

ReferenceImage::ReferenceImage(uint32_t width, uint32_t height)
    : width_(width), height_(height), light_(size_t{width} * height, 0.0f) {}

void ReferenceImage::add(std::span<const gpu::PixelHits> hits) {
  for (size_t i = 0; i < light_.size(); ++i) {
    float light = 1.0f;
    if (hits[i].primary_id != 0) {
      light = 0.5f;
      if (hits[i].bounce_id != 0 && hits[i].bounce_id != gpu::ray_absent) light = 0.25f;
    }
    light_[i] += light;
  }
  ++frame_count_;
}

Image ReferenceImage::image() const {
  Image image(width_, height_);
  for (size_t i = 0; i < light_.size(); ++i) {
    const float value = light_[i] / static_cast<float>(frame_count_);
    std::fill_n(image.rgb.begin() + static_cast<ptrdiff_t>(3 * i), 3,
                static_cast<uint8_t>(std::lround(255.0f * value)));
  }
  return image;
}

void Pictures::write(const std::string& name, const Image& image) const {
  write_png(dir_ / name, image.width, image.height, image.rgb);
}

bool Pictures::has_reference(const std::string& model, int64_t view) const {
  return references_.contains({model, view});
}

void Pictures::add_reference(const std::string& model, int64_t view, const Image& image) {
  references_.insert({model, view});
  tiles_[{model, view}][reference_label] = shrink(image, max_tile_width);
  write(view_name(model, view) + "_reference.png", image);
}

void Pictures::add_heat_map(const std::string& model, int64_t view, const std::string& algorithm,
                            const Image& image) {
  Image tile = shrink(image, max_tile_width);
  if (algorithm == stackless) stackless_[{model, view}] = tile;
  tiles_[{model, view}][algorithm] = std::move(tile);
  write(fmt::format("{}_{}_heat.png", view_name(model, view), algorithm), image);
}

void Pictures::finish_view(const std::string& model, int64_t view) {
  auto held = tiles_.extract({model, view});
  if (held.empty()) return;
  std::map<std::string, Image>& images = held.mapped();
  std::vector<Tile> tiles;
  for (const char* label : tile_order)
    if (const auto found = images.find(label); found != images.end())
      tiles.push_back({label, std::move(found->second)});
  if (tiles.size() < 2) return;
  write(view_name(model, view) + "_montage.png", montage(tiles, 2, bar_end(model)));
}

void Pictures::finish() {
  std::map<std::string, std::vector<Tile>> models;
  for (auto& [place, image] : stackless_)
    models[place.first].push_back({fmt::format("VIEW {}", place.second), std::move(image)});
  stackless_.clear();
  for (const auto& [model, tiles] : models)
    write(fmt::format("{}_{}_views.png", file_name_part(model), stackless),
          montage(tiles, static_cast<uint32_t>(tiles.size()), bar_end(model)));
}

}  // namespace energyprof::app
