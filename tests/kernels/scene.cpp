// Builds the scenes and traces them on the CPU.
#include "scene.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <numeric>
#include <random>
#include <span>

#include "core/trace_math.h"
#include "kernels/context.h"

namespace energyprof::kernels {
namespace {

using gpu::vec3;
using gpu::vec4;

gpu::Triangle to_gpu(const Corners& corners) {
  const vec3 e1 = corners.b - corners.a;
  const vec3 e2 = corners.c - corners.a;
  const vec3 normal = gpu::cross3(e1, e2);
  return {vec4(corners.a, normal.x), vec4(e1, normal.y), vec4(e2, normal.z)};
}

float as_float(int32_t bits) {
  float value;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}

struct Box {
  vec3 low{1e30f};
  vec3 high{-1e30f};

  void add(const vec3& point) {
    low = glm::min(low, point);
    high = glm::max(high, point);
  }
  void add(const Corners& corners) {
    add(corners.a);
    add(corners.b);
    add(corners.c);
  }
};

/// Writes nodes depth first.
class TreeWriter {
 public:
  explicit TreeWriter(const std::vector<Corners>& triangles) : triangles_(triangles) {}

  /// Writes the node over `ids`, which `split` cuts in two at an index along an axis.
  void write(std::span<uint32_t> ids, uint32_t depth,
             const std::function<std::pair<size_t, int>(std::span<uint32_t>)>& split) {
    Box box;
    for (const uint32_t id : ids) box.add(triangles_[id]);
    const size_t node = nodes_.size();
    nodes_.push_back({vec4(box.low, 0.0f), vec4(box.high, 0.0f)});
    if (ids.size() == 1) {
      nodes_[node].min_link.w = as_float(static_cast<int32_t>(ids[0]));
      nodes_[node].max_link.w = as_float(1);
      return;
    }
    deepest_ = std::max(deepest_, depth + 1);
    const auto [middle, axis] = split(ids);
    nodes_[node].min_link.w = as_float(-(axis + 1));
    write(ids.first(middle), depth + 1, split);
    nodes_[node].max_link.w = as_float(static_cast<int32_t>(nodes_.size()));
    write(ids.subspan(middle), depth + 1, split);
  }

  Scene scene() const {
    Scene scene;
    AccelBlob& blob = scene.blob;
    Box box;
    for (const Corners& corners : triangles_) {
      box.add(corners);
      scene.triangles.push_back(to_gpu(corners));
    }
    const auto nodes = std::as_bytes(std::span(nodes_));
    blob.nodes.assign(nodes.begin(), nodes.end());
    blob.bounds_min = box.low;
    blob.bounds_max = box.high;
    blob.max_depth = deepest_;
    return scene;
  }

 private:
  const std::vector<Corners>& triangles_;
  std::vector<gpu::BvhNode> nodes_;
  uint32_t deepest_ = 0;
};

std::vector<uint32_t> all_ids(const std::vector<Corners>& triangles) {
  std::vector<uint32_t> ids(triangles.size());
  std::iota(ids.begin(), ids.end(), 0u);
  return ids;
}

template <typename T>
std::span<const T> view(const std::vector<std::byte>& bytes) {
  return {reinterpret_cast<const T*>(bytes.data()), bytes.size() / sizeof(T)};
}

gpu::Hit test_triangle(gpu::Hit best, const gpu::Ray& ray, const gpu::Triangle& triangle,
                       uint32_t id) {
  return gpu::closer_hit(best, ray, vec3(triangle.v0_nx), vec3(triangle.e1_ny),
                         vec3(triangle.e2_nz), id);
}

/// Traces every pixel with `trace(ray, counts)`.
template <typename Trace>
ExpectedFrame trace_image(const Scene& scene, const gpu::FrameConstants& constants, Trace&& trace) {
  ExpectedFrame frame;
  gpu::uint sum_x = 0;
  gpu::uint sum_y = 0;
  for (uint32_t y = 0; y < constants.height; ++y) {
    for (uint32_t x = 0; x < constants.width; ++x) {
      const uint32_t pixel = y * constants.width + x;
      gpu::PixelCounts counts{};
      const gpu::Ray ray = gpu::primary_ray(constants, x, y);
      const gpu::Hit hit = trace(ray, counts);
      gpu::PixelHits seen{hit.prim_id, gpu::floatBitsToUint(hit.t), gpu::ray_absent, 0};
      frame.ray_count += 1;
      frame.hit_count += hit.prim_id != 0;
      if (hit.prim_id != 0 && constants.bounce_count == 1) {
        const gpu::Triangle& triangle = scene.triangles[hit.prim_id - 1];
        const vec3 normal(triangle.v0_nx.w, triangle.e1_ny.w, triangle.e2_nz.w);
        const gpu::Hit second =
            trace(gpu::bounce_ray(constants, ray, hit.t, normal, pixel), counts);
        seen.bounce_id = second.prim_id;
        seen.bounce_t = gpu::floatBitsToUint(second.t);
        frame.ray_count += 1;
        frame.hit_count += second.prim_id != 0;
      }
      const gpu::uvec2 terms = gpu::checksum_terms(pixel, seen);
      sum_x += terms.x;
      sum_y += terms.y;
      frame.hits.push_back(seen);
      frame.counts.push_back(counts);
    }
  }
  frame.checksum = fmt::format("{:08x}{:08x}", sum_x, sum_y);
  return frame;
}

}  // namespace

std::vector<Corners> random_triangles(uint32_t count, uint32_t seed) {
  std::mt19937 engine(seed);
  std::uniform_real_distribution<float> place(0.2f, 0.8f);
  std::uniform_real_distribution<float> reach(-0.2f, 0.2f);
  const auto corner = [&](const vec3& center) {
    const float x = reach(engine);
    const float y = reach(engine);
    const float z = reach(engine);
    return center + vec3(x, y, z);
  };
  std::vector<Corners> triangles(count);
  for (Corners& triangle : triangles) {
    const float x = place(engine);
    const float y = place(engine);
    const float z = place(engine);
    const vec3 center(x, y, z);
    triangle.a = corner(center);
    triangle.b = corner(center);
    triangle.c = corner(center);
  }
  return triangles;
}

Scene build_halves(const std::vector<Corners>& triangles) {
  TreeWriter writer(triangles);
  std::vector<uint32_t> ids = all_ids(triangles);
  if (ids.empty()) return writer.scene();
  writer.write(ids, 0, [&](std::span<uint32_t> part) {
    Box box;
    for (const uint32_t id : part) box.add(triangles[id].a);
    const vec3 size = box.high - box.low;
    int axis = size.x >= size.y ? 0 : 1;
    if (size.z > size[axis]) axis = 2;
    std::sort(part.begin(), part.end(),
              [&](uint32_t a, uint32_t b) { return triangles[a].a[axis] < triangles[b].a[axis]; });
    return std::pair(part.size() / 2, axis);
  });
  return writer.scene();
}

Scene build_chain(const std::vector<Corners>& triangles) {
  TreeWriter writer(triangles);
  std::vector<uint32_t> ids = all_ids(triangles);
  writer.write(ids, 0, [](std::span<uint32_t> part) { return std::pair(part.size() - 1, 0); });
  return writer.scene();
}

gpu::FrameConstants looking_at_cube(uint32_t width, uint32_t height) {
  gpu::FrameConstants constants{};
  constants.origin_tmin = vec4(0.3f, 0.6f, -2.0f, 1e-4f);
  constants.right_tmax = vec4(0.35f, 0.0f, 0.0f, 1e13f);
  constants.up = vec4(0.0f, 0.35f, 0.0f, 0.0f);
  constants.forward = vec4(0.08f, -0.04f, 1.0f, 0.0f);
  constants.width = width;
  constants.height = height;
  constants.seed = 7;
  constants.bounce_count = 1;
  return constants;
}

ExpectedFrame trace_brute_force(const Scene& scene, gpu::FrameConstants constants, uint32_t frame) {
  constants.frame = frame;
  const std::vector<gpu::Triangle>& triangles = scene.triangles;
  return trace_image(scene, constants, [&](const gpu::Ray& ray, gpu::PixelCounts&) {
    gpu::Hit best{ray.t_max, 0};
    for (uint32_t id = 0; id < triangles.size(); ++id) {
      best = test_triangle(best, ray, triangles[id], id);
    }
    return best;
  });
}

ExpectedFrame trace_tree(const Scene& scene, gpu::FrameConstants constants, uint32_t frame) {
  constants.frame = frame;
  const auto nodes = view<gpu::BvhNode>(scene.blob.nodes);
  const std::vector<gpu::Triangle>& triangles = scene.triangles;
  return trace_image(scene, constants, [&](const gpu::Ray& ray, gpu::PixelCounts& counts) {
    gpu::Hit best{ray.t_max, 0};
    const vec3 inv_d = gpu::inverse_direction(ray.direction);
    const auto is_hit = [&](uint32_t id) {
      ++counts.node_visits;
      ++counts.box_tests;
      const gpu::BvhNode& node = nodes[id];
      return gpu::enter_box(vec3(node.min_link), vec3(node.max_link), ray.origin, inv_d, ray.t_min,
                            best.t) >= 0.0f;
    };
    const std::function<void(uint32_t)> visit = [&](uint32_t id) {
      ++counts.loop_steps;
      const gpu::BvhNode& node = nodes[id];
      const int link = gpu::floatBitsToInt(node.min_link.w);
      if (link >= 0) {
        ++counts.prim_tests;
        best = test_triangle(best, ray, triangles[static_cast<uint32_t>(link)],
                             static_cast<uint32_t>(link));
        return;
      }
      const uint32_t left = id + 1;
      const uint32_t right = gpu::floatBitsToUint(node.max_link.w);
      const bool left_is_near = ray.direction[-link - 1] >= 0.0f;
      const uint32_t near_id = left_is_near ? left : right;
      const uint32_t far_id = left_is_near ? right : left;
      const bool near_is_hit = is_hit(near_id);
      const bool far_is_hit = is_hit(far_id);
      if (near_is_hit) visit(near_id);
      if (far_is_hit) visit(far_id);
    };
    if (nodes.empty()) return best;
    ++counts.loop_steps;
    if (is_hit(0)) visit(0);
    return best;
  });
}

ScopedEnvironment::ScopedEnvironment(std::string name, const std::string& value)
    : name_(std::move(name)) {
  if (const char* before = std::getenv(name_.c_str())) before_ = before;
  setenv(name_.c_str(), value.c_str(), 1);
}

ScopedEnvironment::~ScopedEnvironment() {
  if (before_) {
    setenv(name_.c_str(), before_->c_str(), 1);
  } else {
    unsetenv(name_.c_str());
  }
}

ScopedFault::ScopedFault(const std::string& faults)
    : path_("VK_ADD_LAYER_PATH", ENERGYPROF_FAULT_LAYER_DIR),
      layers_("VK_INSTANCE_LAYERS", "VK_LAYER_ENERGYPROF_fault"),
      fault_("EP_FAULT", faults) {}

std::string no_device_reason() {
  try {
    const DeviceList list = list_devices();
    return list.usable.empty() ? "no Vulkan device is usable" : "";
  } catch (const std::exception& error) {
    return error.what();
  }
}

ValidatedDevice::ValidatedDevice(DeviceRequest request) {
  request.validation = true;
  try {
    device_.emplace(request);
  } catch (const std::runtime_error& error) {
    if (std::string_view(error.what()).find("vulkan-validationlayers") == std::string_view::npos) {
      throw;
    }
    request.validation = false;
    device_.emplace(request);
  }
}

ValidatedDevice::~ValidatedDevice() {
  const std::shared_ptr<MessageLog> log = device_->context().instance->log();
  device_.reset();
  for (const std::string& message : log->messages()) ADD_FAILURE() << message;
}

}  // namespace energyprof::kernels
