#include "accel/trace_cpu.h"

#include <fmt/format.h>
#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <stdexcept>

#include "core/algorithms.h"

namespace energyprof::accel {
namespace {

using namespace gpu;

constexpr uint stack_size = 128;

/// One shader invocation on the CPU: what kernels/shaders/scene.glsl supplies there, and the
/// traversals. `recording`: reads are listed in `reads`.
template <bool recording>
class Thread {
 public:
  Thread(const CpuScene& scene, const FrameConstants& frame_constants)
      : constants(frame_constants),
        has_refs(!scene.blob.refs.empty()),
        nodes_(scene.blob.nodes.data()),
        refs_(scene.blob.refs.data()),
        triangles_(scene.triangles.data()) {}

#include "core/traversal/leaf.h"
// leaf.h first, kd.h before its users
#include "core/traversal/bvh_ftb_bf.h"
#include "core/traversal/bvh_ftb_df.h"
#include "core/traversal/bvh_stackless_df.h"
#include "core/traversal/grid.h"
#include "core/traversal/kd.h"
#include "core/traversal/kd_stack.h"
#include "core/traversal/kd_tree.h"

  PixelCounts work{};
  std::vector<MemoryRead> reads;

 private:
  void count_step() { ++work.loop_steps; }
  void count_node_visit() { ++work.node_visits; }
  void count_box_test() { ++work.box_tests; }

  template <class T>
  const T& load(MemoryRead::Buffer buffer, const void* begin, uint index) {
    if constexpr (recording)
      reads.push_back({buffer, sizeof(T), uint64_t{index} * sizeof(T), work.loop_steps});
    return static_cast<const T*>(begin)[index];
  }
  const BvhNode& load_bvh_node(uint i) {
    return load<BvhNode>(MemoryRead::Buffer::nodes, nodes_, i);
  }
  uvec2 load_bvh_links(uint i) {
    const auto& node = load<BvhNode>(MemoryRead::Buffer::nodes, nodes_, i);
    return {floatBitsToUint(node.min_link.w), floatBitsToUint(node.max_link.w)};
  }
  const KdNode& load_kd_node(uint i) { return load<KdNode>(MemoryRead::Buffer::nodes, nodes_, i); }
  const GridCell& load_grid_cell(uint i) {
    return load<GridCell>(MemoryRead::Buffer::nodes, nodes_, i);
  }
  uint load_ref(uint i) { return load<uint>(MemoryRead::Buffer::refs, refs_, i); }

  Hit test_triangle(const Hit& best, const Ray& ray, uint prim) {
    ++work.prim_tests;
    const auto& triangle = load<Triangle>(MemoryRead::Buffer::triangles, triangles_, prim);
    return closer_hit(best, ray, xyz(triangle.v0_nx), xyz(triangle.e1_ny), xyz(triangle.e2_nz),
                      prim);
  }

  const FrameConstants& constants;
  const bool has_refs;
  const std::byte* nodes_;
  const uint32_t* refs_;
  const Triangle* triangles_;
};

template <bool recording>
using Trace = Hit (Thread<recording>::*)(Ray);

template <bool recording>
Trace<recording> find_trace(std::string_view algorithm) {
#define EP_TRACE(name, file, kind, uses_stack, text) \
  if (algorithm == #name) return &Thread<recording>::trace_##file;
  EP_ALGORITHMS(EP_TRACE)
#undef EP_TRACE
  return nullptr;
}

/// Checks algorithm against structure and completes the constants.
void prepare(std::string_view algorithm, const CpuScene& scene, FrameConstants& constants) {
  const AlgorithmInfo* info = find_algorithm(algorithm);
  if (info == nullptr)
    throw std::runtime_error(
        fmt::format("cannot trace with '{}': there is no such algorithm.", algorithm));
  if (info->kind != scene.blob.kind)
    throw std::runtime_error(fmt::format(
        "cannot trace with '{}': the scene was built as another structure than it traverses.",
        algorithm));
  if (info->uses_stack && scene.blob.max_depth + 1 > stack_size)
    throw std::runtime_error(
        fmt::format("cannot trace with '{}': the tree needs a stack of {} entries, there are {}.",
                    algorithm, scene.blob.max_depth + 1, stack_size));
  set_structure(constants, scene.blob);
}

/// Traces one pixel; `trace(ray)` gives the closest hit.
template <class TraceRay>
PixelHits trace_pixel(const FrameConstants& constants, std::span<const Triangle> triangles,
                      uint32_t x, uint32_t y, TraceRay&& trace) {
  PixelHits hits{0, 0, ray_absent, 0};
  const Ray primary = primary_ray(constants, x, y);
  const Hit first = trace(primary);
  hits.primary_id = first.prim_id;
  hits.primary_t = floatBitsToUint(first.t);
  if (first.prim_id != 0 && constants.bounce_count > 0) {
    const Triangle& triangle = triangles[first.prim_id - 1];
    const glm::vec3 normal(triangle.v0_nx.w, triangle.e1_ny.w, triangle.e2_nz.w);
    const Hit second =
        trace(bounce_ray(constants, primary, first.t, normal, y * constants.width + x));
    hits.bounce_id = second.prim_id;
    hits.bounce_t = floatBitsToUint(second.t);
  }
  return hits;
}

/// Calls trace(x, y) for every pixel, rows in parallel.
template <class TracePixel>
void for_each_pixel(const FrameConstants& constants, TracePixel&& trace) {
  tbb::parallel_for(tbb::blocked_range<uint32_t>(0, constants.height), [&](const auto& rows) {
    for (uint32_t y = rows.begin(); y < rows.end(); ++y)
      for (uint32_t x = 0; x < constants.width; ++x) trace(x, y);
  });
}

}  // namespace

CpuFrame trace_cpu(std::string_view algorithm, const CpuScene& scene, FrameConstants constants) {
  prepare(algorithm, scene, constants);
  const Trace<false> trace = find_trace<false>(algorithm);
  CpuFrame frame;
  frame.hits.resize(size_t{constants.width} * constants.height);
  frame.counts.resize(frame.hits.size());
  for_each_pixel(constants, [&](uint32_t x, uint32_t y) {
    Thread<false> thread(scene, constants);
    const size_t pixel = size_t{y} * constants.width + x;
    frame.hits[pixel] = trace_pixel(constants, scene.triangles, x, y, [&](const Ray& ray) {
      return constants.node_count == 0 ? no_hit(ray) : (thread.*trace)(ray);
    });
    frame.counts[pixel] = thread.work;
  });
  return frame;
}

CpuFrame trace_brute_force(std::span<const Triangle> triangles, const FrameConstants& constants) {
  CpuFrame frame;
  frame.hits.resize(size_t{constants.width} * constants.height);
  frame.counts.resize(frame.hits.size());
  for_each_pixel(constants, [&](uint32_t x, uint32_t y) {
    const size_t pixel = size_t{y} * constants.width + x;
    frame.hits[pixel] = trace_pixel(constants, triangles, x, y, [&](const Ray& ray) {
      Hit best = no_hit(ray);
      for (uint prim = 0; prim < triangles.size(); ++prim)
        best = closer_hit(best, ray, xyz(triangles[prim].v0_nx), xyz(triangles[prim].e1_ny),
                          xyz(triangles[prim].e2_nz), prim);
      frame.counts[pixel].prim_tests += static_cast<uint>(triangles.size());
      return best;
    });
  });
  return frame;
}

PixelReads record_reads(std::string_view algorithm, const CpuScene& scene,
                        const FrameConstants& frame_constants, uint32_t x, uint32_t y) {
  FrameConstants constants = frame_constants;
  prepare(algorithm, scene, constants);
  const Trace<true> trace = find_trace<true>(algorithm);
  PixelReads reads;
  trace_pixel(constants, scene.triangles, x, y, [&](const Ray& ray) {
    Thread<true> thread(scene, constants);
    const Hit hit = constants.node_count == 0 ? no_hit(ray) : (thread.*trace)(ray);
    (reads.ray_count++ == 0 ? reads.primary : reads.bounce) = std::move(thread.reads);
    return hit;
  });
  return reads;
}

FrameSums sum_hits(const std::vector<PixelHits>& hits) {
  FrameSums sums;
  glm::uvec2 checksum(0);
  for (size_t pixel = 0; pixel < hits.size(); ++pixel) {
    const PixelHits& h = hits[pixel];
    const bool has_bounce = h.bounce_id != ray_absent;
    sums.ray_count += has_bounce ? 2 : 1;
    sums.hit_count += (h.primary_id != 0 ? 1 : 0) + (has_bounce && h.bounce_id != 0 ? 1 : 0);
    checksum += checksum_terms(static_cast<uint32_t>(pixel), h);
  }
  sums.hit_checksum = fmt::format("{:08x}{:08x}", checksum.x, checksum.y);
  return sums;
}

}  // namespace energyprof::accel
