/// The pictures of a run: reference images, heat maps, and montages of them.
#pragma once

#include <filesystem>
#include <map>
#include <set>
#include <span>
#include <string>
#include <utility>

#include "app/image.h"
#include "core/gpu_layout.h"

namespace energyprof::app {

/// Averages frames into a picture: a miss is white, each hit halves the light.
class ReferenceImage {
 public:
  ReferenceImage(uint32_t width, uint32_t height);

  void add(std::span<const gpu::PixelHits> hits);
  [[nodiscard]] Image image() const;

 private:
  uint32_t width_;
  uint32_t height_;
  std::vector<float> light_;  // sums over frames
  int frame_count_ = 0;
};

/// Writes PNG files into a folder; for the montages it keeps the pictures, shrunk, until
/// finish_view() and finish(). Every call throws std::runtime_error naming the file if it cannot be
/// written.
class Pictures {
 public:
  explicit Pictures(std::filesystem::path dir) : dir_(std::move(dir)) {}

  /// {model}_view{v}_reference.png
  void add_reference(const std::string& model, int64_t view, const Image& image);
  [[nodiscard]] bool has_reference(const std::string& model, int64_t view) const;
  /// {model}_view{v}_{ALGORITHM}_heat.png
  void add_heat_map(const std::string& model, int64_t view, const std::string& algorithm,
                    const Image& image);

  /// {model}_view{v}_montage.png: the reference and all heat maps so far, in the order of the
  /// study's figure 6. Nothing for fewer than two pictures.
  void finish_view(const std::string& model, int64_t view);
  /// {model}_BVH_STACKLESS_DF_views.png for each model: its views side by side, as in the study's
  /// figure 5.
  void finish();

 private:
  using Place = std::pair<std::string, int64_t>;  // model and view

  void write(const std::string& name, const Image& image) const;

  std::filesystem::path dir_;
  std::map<Place, std::map<std::string, Image>> tiles_;  // by label; emptied by finish_view()
  std::map<Place, Image> stackless_;
  std::set<Place> references_;
};

}  // namespace energyprof::app
