#include "accel/kdtree.h"

#include <fmt/format.h>
#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/enumerable_thread_specific.h>
#include <oneapi/tbb/parallel_for.h>
#include <oneapi/tbb/parallel_invoke.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

#include "accel/bytes.h"
#include "accel/kdtree_clip.h"
#include "accel/kdtree_split.h"
#include "core/clock.h"
#include "core/gpu_layout.h"

namespace energyprof::accel {
namespace {

constexpr size_t max_count = size_t{1} << 30;  ///< of triangles, refs, nodes: 30 bits name them
constexpr int max_tree_depth = 120;
constexpr size_t serial_count = 16384;  ///< subtrees of fewer triangles are built by one thread

/// What every thread may read during a build.
struct Problem {
  const Mesh& mesh;
  KdTreeConfig config;  ///< max_depth resolved
  KdCosts costs;
  float margin;   ///< what lies this close to a cell may be met in it
  float padding;  ///< of the triangles' boxes: the margin, or 0 to let go of what only touches
};

/// A cell and how it was reached.
struct Cell {
  Box box;
  int depth = 0;            ///< inner nodes above it
  int bad_split_count = 0;  ///< of these, splits dearer than their leaf
};

/// Sums over a subtree.
struct Totals {
  double inner_area = 0.0;
  double leaf_area = 0.0;  ///< times triangles
  int64_t leaf_count = 0;  ///< empty ones not counted
  int depth = 0;           ///< of the deepest leaf, from the root

  void add(const Totals& other) {
    inner_area += other.inner_area;
    leaf_area += other.leaf_area;
    leaf_count += other.leaf_count;
    depth = std::max(depth, other.depth);
  }
};

/// Nodes and refs of a subtree, numbered from 0.
struct Chunk {
  std::vector<gpu::KdNode> nodes;
  std::vector<uint32_t> refs;
  Totals totals;
};

/// Memory that is never filled with zeros first, in large pages where the system has them.
template <class T>
std::unique_ptr<T[]> uninitialized(size_t count) {
  auto storage = std::make_unique_for_overwrite<T[]>(count);
  prefer_large_pages(storage.get(), count * sizeof(T));
  return storage;
}

/// Throws std::runtime_error for more than links and leaves can name.
void check_counts(size_t node_count, size_t ref_count) {
  if (node_count > max_count || ref_count > max_count)
    throw std::runtime_error(
        fmt::format("cannot build a kd-tree: it would have {} or more nodes and {} references to "
                    "triangles, the limit is {}. Try a lower max_depth.",
                    node_count, ref_count, max_count));
}

double half_area(const Box& box) {
  const glm::dvec3 d = glm::dvec3(box.max) - glm::dvec3(box.min);
  return d.x * d.y + d.y * d.z + d.z * d.x;
}

gpu::KdNode inner_node(const KdSplit& split, size_t above) {
  return {std::bit_cast<uint32_t>(split.plane),
          static_cast<uint32_t>(above << 2u) | static_cast<uint32_t>(split.axis)};
}

Cell child_cell(const Cell& cell, const KdSplit& split, bool above) {
  Cell child = cell;
  (above ? child.box.min : child.box.max)[split.axis] = split.plane;
  ++child.depth;
  return child;
}

/// Splits cells and sorts triangles into them. One for each thread.
class Splitter {
 public:
  explicit Splitter(const Problem& problem) : problem_(problem), finder_(problem.costs) {}

  /// How to split the cell, or nothing if it becomes a leaf. Counts a bad split in `cell`.
  std::optional<KdSplit> choose(std::span<const KdRef> refs, Cell& cell) {
    const KdTreeConfig& config = problem_.config;
    const size_t count = refs.size();
    if (count <= static_cast<size_t>(config.max_leaf_size) || cell.depth >= config.max_depth)
      return {};
    const double leaf_cost = problem_.costs.intersect * static_cast<double>(count);
    KdSplit best;
    // When the next bad split ends the path, only cheaper ones are of interest.
    if (cell.bad_split_count + 1 >= config.bad_refinement_count) best.cost = leaf_cost;
    const int longest = cell.box.longest_axis();
    for (int i = 0; i < 3; ++i) {
      best = finder_.cheaper_split(refs, cell.box, (longest + i) % 3, best);
      if (!config.clip && best.axis >= 0) break;
    }
    if (best.axis < 0) return {};
    if (best.cost >= leaf_cost) {
      if (++cell.bad_split_count >= config.bad_refinement_count) return {};
      if (best.cost > 4.0 * leaf_cost && count < 16) return {};
    }
    return best;
  }

  struct Counts {
    size_t below = 0;
    size_t above = 0;
  };
  /// Writes the triangles of `refs` that reach below the plane to `below`, those that reach above
  /// to `above`, in their order. `above` may be the beginning of `refs`.
  Counts partition(std::span<const KdRef> refs, const Cell& cell, const KdSplit& split,
                   KdRef* below, KdRef* above) {
    Counts counts;
    for (const KdRef& stored : refs) {
      const KdRef ref = stored;
      const bool is_above = ref.max[split.axis] > split.plane;
      // What lies in the plane, and what is not a number, goes below: nothing is lost.
      const bool is_below = ref.min[split.axis] < split.plane || !is_above;
      if (is_above && is_below && problem_.config.clip) {
        clip_to_both(ref, cell, split, below, above, counts);
        continue;
      }
      below[counts.below] = ref;
      counts.below += is_below ? 1 : 0;
      above[counts.above] = ref;
      counts.above += is_above ? 1 : 0;
    }
    return counts;
  }

 private:
  /// Both children get the part of the triangle that lies in them, or within the margin of them.
  void clip_to_both(const KdRef& ref, const Cell& cell, const KdSplit& split, KdRef* below,
                    KdRef* above, Counts& counts) {
    const glm::uvec3 corners = problem_.mesh.triangles[ref.prim];
    const auto& positions = problem_.mesh.positions;
    const double margin = problem_.margin;
    ClippedTriangle low({positions[corners.x], positions[corners.y], positions[corners.z]},
                        cell.box, margin);
    ClippedTriangle high = low;
    low.keep_below(split.axis, double{split.plane} + margin);
    high.keep_above(split.axis, double{split.plane} - margin);
    const auto put = [&](const ClippedTriangle& part, const Box& box, KdRef& to, size_t& count) {
      if (part.empty()) return;
      const Box bounds = part.bounds(problem_.padding);
      to = {glm::max(bounds.min, box.min), ref.prim, glm::min(bounds.max, box.max), 0};
      ++count;
    };
    put(low, child_cell(cell, split, false).box, below[counts.below], counts.below);
    put(high, child_cell(cell, split, true).box, above[counts.above], counts.above);
  }

  const Problem& problem_;
  KdSplitFinder finder_;
};

/// Builds whole subtrees on one thread. The lists of triangles lie on a stack of its own.
class SubtreeBuilder {
 public:
  explicit SubtreeBuilder(const Problem& problem) : splitter_(problem) {}

  Chunk build(std::span<const KdRef> refs, const Cell& cell) {
    chunk_ = {};
    reserve(refs.size());
    std::copy(refs.begin(), refs.end(), stack_.get());
    build_node(0, refs.size(), cell);
    return std::move(chunk_);
  }
  Splitter& splitter() { return splitter_; }

 private:
  /// Builds the node of the triangles [first, first + count), which are on top of the stack.
  void build_node(size_t first, size_t count, Cell cell) {
    const std::span<const KdRef> refs(stack_.get() + first, count);
    const std::optional<KdSplit> split = splitter_.choose(refs, cell);
    if (!split) return make_leaf(refs, cell);
    chunk_.totals.inner_area += half_area(cell.box);
    const size_t node = chunk_.nodes.size();
    chunk_.nodes.emplace_back();
    const size_t end = first + count;
    reserve(end + count);
    // What is above takes the place of the list, what is below goes on top and is built first.
    const Splitter::Counts counts = splitter_.partition({stack_.get() + first, count}, cell, *split,
                                                        stack_.get() + end, stack_.get() + first);
    build_node(end, counts.below, child_cell(cell, *split, false));
    chunk_.nodes[node] = inner_node(*split, chunk_.nodes.size());
    build_node(first, counts.above, child_cell(cell, *split, true));
  }

  void make_leaf(std::span<const KdRef> refs, const Cell& cell) {
    chunk_.nodes.push_back({static_cast<uint32_t>(chunk_.refs.size()),
                            static_cast<uint32_t>(refs.size() << 2u) | gpu::kd_leaf});
    for (const KdRef& ref : refs) chunk_.refs.push_back(ref.prim);
    chunk_.totals.add({0.0, half_area(cell.box) * static_cast<double>(refs.size()),
                       refs.empty() ? 0 : 1, cell.depth});
    check_counts(chunk_.nodes.size(), chunk_.refs.size());
  }

  void reserve(size_t count) {
    if (count <= capacity_) return;
    const size_t capacity = std::max(count, 2 * capacity_);
    auto larger = uninitialized<KdRef>(capacity);
    std::copy_n(stack_.get(), capacity_, larger.get());
    stack_ = std::move(larger);
    capacity_ = capacity;
  }

  Splitter splitter_;
  std::unique_ptr<KdRef[]> stack_;
  size_t capacity_ = 0;
  Chunk chunk_;
};

/// The top of the tree, whose subtrees are chunks.
struct Part {
  Chunk chunk;  ///< of a subtree; unused above them
  KdSplit split;
  std::unique_ptr<Part> below;
  std::unique_ptr<Part> above;
};

class TreeBuilder {
 public:
  explicit TreeBuilder(const Problem& problem)
      : workers_([&problem] { return SubtreeBuilder(problem); }) {}

  std::unique_ptr<Part> build(std::unique_ptr<KdRef[]> storage, size_t count, Cell cell) {
    auto part = std::make_unique<Part>();
    const std::span<const KdRef> refs(storage.get(), count);
    std::optional<KdSplit> split;
    if (count > serial_count) split = workers_.local().splitter().choose(refs, cell);
    if (!split) {
      // A leaf here would be one there as well.
      part->chunk = workers_.local().build(refs, cell);
      return part;
    }
    auto below = uninitialized<KdRef>(count);
    auto above = uninitialized<KdRef>(count);
    const Splitter::Counts counts =
        workers_.local().splitter().partition(refs, cell, *split, below.get(), above.get());
    storage.reset();
    part->split = *split;
    part->chunk.totals.inner_area = half_area(cell.box);
    tbb::parallel_invoke(
        [&] {
          part->below = build(std::move(below), counts.below, child_cell(cell, *split, false));
        },
        [&] {
          part->above = build(std::move(above), counts.above, child_cell(cell, *split, true));
        });
    return part;
  }

 private:
  tbb::enumerable_thread_specific<SubtreeBuilder> workers_;
};

/// Where a chunk goes in the whole tree.
struct Placed {
  const Chunk* chunk;
  size_t first_node;
  size_t first_ref;
};

/// Lists the chunks in depth-first order, and the nodes above them with where they go.
class Layout {
 public:
  explicit Layout(const Part& root) { place(root); }

  /// Writes nodes and refs. Throws std::runtime_error if there are too many to name.
  void write(AccelBlob& blob) const {
    check_counts(node_count_, ref_count_);
    blob.nodes.resize(node_count_ * sizeof(gpu::KdNode));
    blob.refs.resize(ref_count_);
    auto* nodes = reinterpret_cast<gpu::KdNode*>(blob.nodes.data());
    for (const auto& [index, node] : top_nodes_) nodes[index] = node;
    tbb::parallel_for(size_t{0}, chunks_.size(), [&](size_t i) {
      const Placed& placed = chunks_[i];
      gpu::KdNode* to = nodes + placed.first_node;
      for (gpu::KdNode node : placed.chunk->nodes) {
        if ((node.word & 3u) == gpu::kd_leaf)
          node.plane_or_first += static_cast<uint32_t>(placed.first_ref);
        else
          node.word += static_cast<uint32_t>(placed.first_node) << 2u;
        *to++ = node;
      }
      std::copy(placed.chunk->refs.begin(), placed.chunk->refs.end(),
                blob.refs.begin() + static_cast<ptrdiff_t>(placed.first_ref));
    });
  }
  [[nodiscard]] const Totals& totals() const { return totals_; }

 private:
  void place(const Part& part) {
    totals_.add(part.chunk.totals);
    if (part.below == nullptr) {
      chunks_.push_back({&part.chunk, node_count_, ref_count_});
      node_count_ += part.chunk.nodes.size();
      ref_count_ += part.chunk.refs.size();
      return;
    }
    const size_t node = node_count_++;
    place(*part.below);
    top_nodes_.emplace_back(node, inner_node(part.split, node_count_));
    place(*part.above);
  }

  std::vector<Placed> chunks_;
  std::vector<std::pair<size_t, gpu::KdNode>> top_nodes_;
  size_t node_count_ = 0;
  size_t ref_count_ = 0;
  Totals totals_;
};

/// Throws std::runtime_error for parameters outside their ranges.
void check(const KdTreeConfig& config) {
  const auto require = [](bool holds, std::string_view name, auto value,
                          std::string_view expected) {
    if (!holds)
      throw std::runtime_error(
          fmt::format("cannot build a kd-tree with {} = {}: expected {}.", name, value, expected));
  };
  const auto is_cost = [](float cost) { return cost > 0.0f && std::isfinite(cost); };
  require(is_cost(config.traverse_cost), "traverse_cost", config.traverse_cost, "more than 0");
  require(is_cost(config.intersect_cost), "intersect_cost", config.intersect_cost, "more than 0");
  require(config.empty_bonus >= 0.0f && config.empty_bonus <= 1.0f, "empty_bonus",
          config.empty_bonus, "0 to 1");
  require(config.max_leaf_size >= 1 && config.max_leaf_size <= 64, "max_leaf_size",
          config.max_leaf_size, "1 to 64");
  require(config.bad_refinement_count >= 0, "bad_refinement_count", config.bad_refinement_count,
          "0 or more");
  require(config.max_depth >= 0 && config.max_depth <= max_tree_depth, "max_depth",
          config.max_depth, "0 to 120");
}

/// "Physically Based Rendering", M. Pharr, W. Jakob and G. Humphreys, 3rd edition, 2016: 4.4.1.
int default_depth(size_t triangle_count) {
  const int log2 = static_cast<int>(std::bit_width(triangle_count)) - 1;
  return static_cast<int>(std::lround(8.0 + 1.3 * log2));
}

/// How close to a cell a triangle must come to be listed there. More than box_padding(): where a
/// ray crosses two planes at nearly the same distance, rounding may make a restarted traversal skip
/// the cell between them, so what lies that close to a plane must be on both sides of it.
float kd_margin(const Box& bounds) {
  const glm::vec3 extent = bounds.max - bounds.min;
  const float largest = std::max(extent.x, std::max(extent.y, extent.z));
  return std::max(box_padding(bounds), 0x1p-20f * largest);
}

/// Infinity is not a place for a plane.
Box finite(const Box& box) {
  const glm::vec3 limit(std::numeric_limits<float>::max());
  return {glm::max(box.min, -limit), glm::min(box.max, limit)};
}

void build_tree(const Mesh& mesh, const KdTreeConfig& config, Built& built) {
  const size_t triangle_count = mesh.triangles.size();
  const Bounds extents = bounds(mesh);
  const float margin = kd_margin({extents.min, extents.max});
  Problem problem{mesh,
                  config,
                  {config.traverse_cost, config.intersect_cost, config.empty_bonus},
                  margin,
                  config.keep_touching ? margin : 0.0f};
  if (config.max_depth == 0) problem.config.max_depth = default_depth(triangle_count);
  auto refs = uninitialized<KdRef>(triangle_count);
  tbb::parallel_for(tbb::blocked_range<size_t>(0, triangle_count, 16384), [&](const auto& range) {
    for (size_t i = range.begin(); i < range.end(); ++i) {
      const Box box = finite(triangle_box(mesh, i, problem.padding));
      refs[i] = {box.min, static_cast<uint32_t>(i), box.max, 0};
    }
  });
  const Cell root{finite({extents.min - margin, extents.max + margin})};
  built.blob.bounds_min = root.box.min;
  built.blob.bounds_max = root.box.max;

  const std::unique_ptr<Part> top =
      TreeBuilder(problem).build(std::move(refs), triangle_count, root);
  const Layout layout(*top);
  layout.write(built.blob);
  const Totals& totals = layout.totals();
  built.blob.max_depth = static_cast<uint32_t>(totals.depth);
  built.stats.node_count = static_cast<int64_t>(built.blob.nodes.size() / sizeof(gpu::KdNode));
  built.stats.leaf_count = totals.leaf_count;
  built.stats.ref_count = static_cast<int64_t>(built.blob.refs.size());
  built.stats.max_depth = totals.depth;
  if (const double area = half_area(root.box); area > 0.0)
    built.stats.sah_cost =
        (problem.costs.traverse * totals.inner_area + problem.costs.intersect * totals.leaf_area) /
        area;
}

}  // namespace

KdTreeConfig tuned_kdtree() {
  KdTreeConfig config;
  config.intersect_cost = 1.0f;
  config.empty_bonus = 0.2f;
  config.max_leaf_size = 4;
  config.bad_refinement_count = 1;
  config.clip = true;
  return config;
}

Built build_kdtree(const Mesh& mesh, const KdTreeConfig& config) {
  check(config);
  if (mesh.triangles.size() > max_count)
    throw std::runtime_error(
        fmt::format("cannot build a kd-tree: the mesh has {} triangles, the limit is {}.",
                    mesh.triangles.size(), max_count));
  const int64_t begin_ns = now_ns();
  Built built;
  built.blob.kind = AccelKind::kd_tree;
  if (!mesh.triangles.empty()) build_tree(mesh, config, built);
  built.stats.blob_bytes = static_cast<int64_t>(built.blob.byte_count());
  built.stats.build_ns = now_ns() - begin_ns;
  return built;
}

}  // namespace energyprof::accel
