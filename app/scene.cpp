#include "app/scene.h"

#include <cmath>
#include <numbers>

#include "accel/gpu_triangles.h"
#include "accel/models.h"

namespace energyprof::app {
namespace {

constexpr double vertical_field_of_view_rad = 45.0 * std::numbers::pi / 180.0;
constexpr float ray_t_max = 1e13f;

/// The power of two that brings the largest extent into [1, 2); 1 for a mesh without extent.
double power_of_two_scale(const accel::Mesh& mesh) {
  if (mesh.positions.empty()) return 1.0;
  const accel::Bounds box = accel::bounds(mesh);
  const glm::dvec3 size = glm::dvec3(box.max) - glm::dvec3(box.min);
  const double extent = std::max(size.x, std::max(size.y, size.z));
  return extent > 0.0 ? std::ldexp(1.0, -std::ilogb(extent)) : 1.0;
}

}  // namespace

Scene load_scene(const std::string& name, const std::function<void(std::string_view)>& progress) {
  accel::LoadedModel loaded = accel::load_model(name, progress);
  Scene scene;
  scene.model = loaded.name;
  scene.mesh = std::move(loaded.mesh);
  scene.ray_t_min = loaded.ray_t_min;
  for (const accel::View& view : loaded.views)
    scene.views.push_back({view.phi, view.theta, view.distance, view.target});
  scene.scale = power_of_two_scale(scene.mesh);
  for (glm::vec3& position : scene.mesh.positions)
    position = glm::vec3(glm::dvec3(position) * scene.scale);
  scene.triangles = accel::gpu_triangles(scene.mesh);
  return scene;
}

ViewConfig resolve_view(const Scene& scene, const ViewChoice& choice) {
  if (const int* index = std::get_if<int>(&choice))
    return scene.views.at(static_cast<size_t>(*index));
  return std::get<ViewConfig>(choice);
}

gpu::FrameConstants frame_constants(const Scene& scene, const ViewConfig& view, uint32_t width,
                                    uint32_t height, uint32_t bounces, uint32_t seed) {
  const glm::dvec3 offset =
      view.distance * glm::dvec3(std::sin(view.phi) * std::sin(view.theta), std::cos(view.phi),
                                 std::sin(view.phi) * std::cos(view.theta));
  const glm::dvec3 origin = (view.target + offset) * scene.scale;
  const glm::dvec3 forward = -glm::normalize(offset);
  // Straight up or down there is no horizontal direction left: any will do.
  const glm::dvec3 sideways = glm::cross(forward, glm::dvec3(0.0, 1.0, 0.0));
  const glm::dvec3 right =
      glm::length(sideways) > 1e-9 ? glm::normalize(sideways) : glm::dvec3(1.0, 0.0, 0.0);
  const glm::dvec3 up = glm::cross(right, forward);
  const double half_height = std::tan(0.5 * vertical_field_of_view_rad);
  const double half_width = half_height * width / height;

  gpu::FrameConstants c{};
  c.origin_tmin = glm::vec4(glm::vec3(origin), static_cast<float>(scene.ray_t_min * scene.scale));
  c.right_tmax = glm::vec4(glm::vec3(right * half_width), ray_t_max);
  c.up = glm::vec4(glm::vec3(up * half_height), 0.0f);
  c.forward = glm::vec4(glm::vec3(forward), 0.0f);
  c.width = width;
  c.height = height;
  c.seed = seed;
  c.bounce_count = bounces;
  c.row_count = height;
  return c;
}

}  // namespace energyprof::app
