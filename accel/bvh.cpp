#include "accel/bvh.h"

#include <fmt/format.h>
#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>
#include <oneapi/tbb/parallel_reduce.h>

#include <cmath>
#include <stdexcept>

#include "accel/box.h"
#include "accel/bvh_tree.h"
#include "accel/huge_pages.h"
#include "core/clock.h"

namespace energyprof::accel {
namespace {

using bvh::Box4;
using bvh::Float4;
using bvh::Ref;

constexpr size_t max_bvh_triangle_count = size_t{1} << 30;  // node indices stay below 2^31

template <class Number>
void check(const char* what, Number value, Number low, Number high) {
  if (!(value >= low && value <= high))
    throw std::runtime_error(
        fmt::format("cannot build a BVH with {} {}: expected {} to {}.", what, value, low, high));
}

void check(const BvhConfig& config) {
  check("bucket_count", config.bucket_count, 2, bvh::max_bucket_count);
  check("max_leaf_size", config.max_leaf_size, 1, 16);
  check("traverse_cost", config.traverse_cost, 0.0f, 1e6f);
  check("intersect_cost", config.intersect_cost, 0.0f, 1e6f);
  check("middle_split_count", config.middle_split_count, 0, 1 << 30);
}

struct Bounds4 {
  Box4 box;
  Box4 centres;
};

/// Fills `refs` and returns what they span.
Bounds4 make_refs(const Mesh& mesh, std::span<Ref> refs) {
  const Bounds corners = bounds(mesh);
  const float padding = box_padding({corners.min, corners.max});
  const Float4 margin{padding, padding, padding, 0.0f};
  return tbb::parallel_reduce(
      tbb::blocked_range<size_t>(0, refs.size(), 16384), Bounds4(),
      [&](const auto& range, Bounds4 sum) {
        for (size_t i = range.begin(); i < range.end(); ++i) {
          Box4 box;
          for (int k = 0; k < 3; ++k) {
            const glm::vec3& p = mesh.positions[mesh.triangles[i][k]];
            box.grow(Float4{p.x, p.y, p.z, 0.0f});
          }
          box.min -= margin;
          box.max += margin;
          refs[i] = Ref(box, static_cast<uint32_t>(i));
          sum.box.grow(box);
          sum.centres.grow(refs[i].centre());
        }
        return sum;
      },
      [](Bounds4 a, const Bounds4& b) {
        a.box.grow(b.box);
        a.centres.grow(b.centres);
        return a;
      });
}

glm::vec3 to_vec3(Float4 v) { return {v[0], v[1], v[2]}; }

}  // namespace

BvhConfig tuned_bvh() {
  BvhConfig config;
  config.bucket_count = 32;
  config.all_axes = true;
  config.max_leaf_size = 4;
  config.intersect_cost = 1.0f;
  config.middle_split_count = 0;
  return config;
}

Built build_bvh(const Mesh& mesh, const BvhConfig& config, AccelKind layout) {
  const size_t triangle_count = mesh.triangles.size();
  if (triangle_count > max_bvh_triangle_count)
    throw std::runtime_error(
        fmt::format("cannot build a BVH: the mesh has {} triangles, the limit is {}.",
                    triangle_count, max_bvh_triangle_count));
  check(config);
  if (layout != AccelKind::bvh_depth_first && layout != AccelKind::bvh_breadth_first &&
      layout != AccelKind::bvh_miss_links)
    throw std::runtime_error("cannot build a BVH in the layout of another structure.");
  const int64_t begin_ns = now_ns();
  Built built;
  built.blob.kind = layout;
  if (triangle_count > 0) {
    RawArray<Ref> refs = make_raw_array<Ref>(triangle_count);
    bvh::Context context;
    context.config = config;
    context.link_is_end = layout == AccelKind::bvh_miss_links;
    context.refs = {refs.get(), triangle_count};
    const auto [box, centres] = make_refs(mesh, context.refs);
    context.box = box;
    context.centres = centres;
    if (!std::isfinite(box.half_area()))
      throw std::runtime_error(fmt::format(
          "cannot build a BVH: the mesh is {:g} x {:g} x {:g} large, the area of that is "
          "more than a float can hold.",
          box.max[0] - box.min[0], box.max[1] - box.min[1], box.max[2] - box.min[2]));
    if (config.max_leaf_size > 1) {
      built.blob.refs.resize(triangle_count);
      context.leaf_ids = built.blob.refs.data();
    }

    // Without gaps and in the same order, slots are nodes.
    const size_t slot_count = 2 * triangle_count - 1;
    const bool slots_are_nodes =
        config.max_leaf_size == 1 && layout != AccelKind::bvh_breadth_first;
    RawArray<gpu::BvhNode> slots;
    if (slots_are_nodes) {
      built.blob.nodes = bvh::make_node_bytes(slot_count);
      context.slots = reinterpret_cast<gpu::BvhNode*>(built.blob.nodes.data());
    } else {
      slots = make_raw_array<gpu::BvhNode>(slot_count);
      context.slots = slots.get();
    }

    const bvh::Grown tree = config.method == BvhConfig::Method::sweep ? bvh::grow_swept(context)
                                                                      : bvh::grow_binned(context);
    refs.reset();
    if (!slots_are_nodes) built.blob.nodes = bvh::lay_out(layout, context, tree);

    built.blob.bounds_min = to_vec3(box.min);
    built.blob.bounds_max = to_vec3(box.max);
    built.blob.max_depth = tree.deepest;
    built.stats.node_count = static_cast<int64_t>(tree.node_count);
    built.stats.leaf_count = built.stats.node_count / 2 + 1;
    built.stats.ref_count = static_cast<int64_t>(triangle_count);
    built.stats.max_depth = tree.deepest;
    if (const double area = box.half_area(); area > 0.0)
      built.stats.sah_cost =
          (config.traverse_cost * tree.inner_area + config.intersect_cost * tree.leaf_area) / area;
  }
  built.stats.blob_bytes = static_cast<int64_t>(built.blob.byte_count());
  built.stats.build_ns = now_ns() - begin_ns;
  return built;
}

}  // namespace energyprof::accel
