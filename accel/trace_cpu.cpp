#include "accel/trace_cpu.h"

#include <fmt/format.h>
#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <span>

namespace energyprof::accel {
namespace {

using gpu::BvhNode;
using gpu::FrameConstants;
using gpu::Hit;
using gpu::PixelCounts;
using gpu::PixelHits;
using gpu::Ray;
using gpu::Triangle;

struct Scene {
  explicit Scene(const AccelBlob& blob)
      : nodes(reinterpret_cast<const BvhNode*>(blob.nodes.data()),
              blob.nodes.size() / sizeof(BvhNode)),
        triangles(reinterpret_cast<const Triangle*>(blob.triangles.data()),
                  blob.triangles.size() / sizeof(Triangle)),
        stack_size(blob.max_depth + 1) {}

  std::span<const BvhNode> nodes;
  std::span<const Triangle> triangles;
  size_t stack_size;
};

Hit test_triangle(const Scene& scene, Hit best, const Ray& ray, uint32_t prim) {
  const Triangle& triangle = scene.triangles[prim];
  return gpu::closer_hit(best, ray, glm::vec3(triangle.v0_nx), glm::vec3(triangle.e1_ny),
                         glm::vec3(triangle.e2_nz), prim);
}

Hit trace_brute_force(const Scene& scene, const Ray& ray, PixelCounts& counts) {
  Hit best{ray.t_max, 0};
  for (uint32_t prim = 0; prim < scene.triangles.size(); ++prim)
    best = test_triangle(scene, best, ray, prim);
  counts.prim_tests += static_cast<uint32_t>(scene.triangles.size());
  return best;
}

/// The twin of kernels/shaders/bvh_ftb_df.comp: same order, same counts.
Hit trace_bvh(const Scene& scene, const Ray& ray, std::vector<uint32_t>& stack,
              PixelCounts& counts) {
  Hit best{ray.t_max, 0};
  if (scene.nodes.empty()) return best;
  const glm::vec3 inv_d = gpu::inverse_direction(ray.direction);
  stack.clear();
  stack.push_back(0);
  while (!stack.empty()) {
    const uint32_t index = stack.back();
    stack.pop_back();
    const BvhNode& node = scene.nodes[index];
    ++counts.loop_steps;
    ++counts.node_visits;
    ++counts.box_tests;
    if (gpu::enter_box(glm::vec3(node.min_link), glm::vec3(node.max_link), ray.origin, inv_d,
                       ray.t_min, best.t) < 0.0f)
      continue;
    const int word = gpu::floatBitsToInt(node.min_link.w);
    if (word >= 0) {
      ++counts.prim_tests;
      best = test_triangle(scene, best, ray, static_cast<uint32_t>(word));
      continue;
    }
    const auto left = index + 1;
    const auto right = static_cast<uint32_t>(gpu::floatBitsToInt(node.max_link.w));
    const bool left_first = ray.direction[-(word + 1)] >= 0.0f;
    stack.push_back(left_first ? right : left);
    stack.push_back(left_first ? left : right);
  }
  return best;
}

}  // namespace

CpuFrame trace_cpu(const AccelBlob& blob, const FrameConstants& constants, CpuMethod method) {
  const Scene scene(blob);
  CpuFrame frame;
  frame.hits.resize(size_t{constants.width} * constants.height);
  frame.counts.resize(frame.hits.size());
  tbb::parallel_for(tbb::blocked_range<uint32_t>(0, constants.height), [&](const auto& rows) {
    std::vector<uint32_t> stack;
    stack.reserve(scene.stack_size);
    const auto trace = [&](const Ray& ray, PixelCounts& counts) {
      return method == CpuMethod::brute_force ? trace_brute_force(scene, ray, counts)
                                              : trace_bvh(scene, ray, stack, counts);
    };
    for (uint32_t y = rows.begin(); y < rows.end(); ++y)
      for (uint32_t x = 0; x < constants.width; ++x) {
        const uint32_t pixel = y * constants.width + x;
        PixelCounts counts{};
        PixelHits hits{};
        const Ray primary = gpu::primary_ray(constants, x, y);
        const Hit first = trace(primary, counts);
        hits.primary_id = first.prim_id;
        hits.primary_t = gpu::floatBitsToUint(first.t);
        hits.bounce_id = gpu::ray_absent;
        if (first.prim_id != 0 && constants.bounce_count > 0) {
          const Triangle& triangle = scene.triangles[first.prim_id - 1];
          const glm::vec3 normal(triangle.v0_nx.w, triangle.e1_ny.w, triangle.e2_nz.w);
          const Hit second =
              trace(gpu::bounce_ray(constants, primary, first.t, normal, pixel), counts);
          hits.bounce_id = second.prim_id;
          hits.bounce_t = gpu::floatBitsToUint(second.t);
        }
        frame.hits[pixel] = hits;
        frame.counts[pixel] = counts;
      }
  });
  return frame;
}

FrameSums sum_hits(const std::vector<PixelHits>& hits) {
  FrameSums sums;
  glm::uvec2 checksum(0);
  for (size_t pixel = 0; pixel < hits.size(); ++pixel) {
    const PixelHits& h = hits[pixel];
    const bool has_bounce = h.bounce_id != gpu::ray_absent;
    sums.ray_count += has_bounce ? 2 : 1;
    sums.hit_count += (h.primary_id != 0 ? 1 : 0) + (has_bounce && h.bounce_id != 0 ? 1 : 0);
    checksum += gpu::checksum_terms(static_cast<uint32_t>(pixel), h);
  }
  sums.hit_checksum = fmt::format("{:08x}{:08x}", checksum.x, checksum.y);
  return sums;
}

}  // namespace energyprof::accel
