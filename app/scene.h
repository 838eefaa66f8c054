/// A model made ready for tracing, and the cameras that look at it.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "accel/mesh.h"
#include "app/config.h"
#include "core/gpu_layout.h"

namespace energyprof::app {

/// A loaded model. Its mesh is scaled by a power of two to a largest extent in [1, 2): every
/// coordinate keeps its digits, and traversal works at one scale whatever the model's units.
struct Scene {
  std::string model;                     ///< as named in the config
  accel::Mesh mesh;                      ///< scaled
  std::vector<gpu::Triangle> triangles;  ///< of the mesh; all structures share them
  double scale = 1.0;                    ///< scaled coordinate / model coordinate
  double ray_t_min = 1e-4;               ///< in the model's units
  std::vector<ViewConfig> views;         ///< the model's own, in the model's units
  std::string failure;                   ///< not empty: why the model could not be had
};

/// Loads `name`, fetching it if need be; `progress` hears what takes time.
Scene load_scene(const std::string& name, const std::function<void(std::string_view)>& progress);

/// The view that `choice` means for this scene.
ViewConfig resolve_view(const Scene& scene, const ViewChoice& choice);

/// The constants of a frame seen from `view`: vertical field of view 45 degrees, +y up.
gpu::FrameConstants frame_constants(const Scene& scene, const ViewConfig& view, uint32_t width,
                                    uint32_t height, uint32_t bounces, uint32_t seed);

}  // namespace energyprof::app
