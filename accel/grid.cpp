// Uniform grids by a counting sort in two steps: to buckets of neighbouring cells, then to cells.
#include "accel/grid.h"

#include <fmt/format.h>
#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>
#include <oneapi/tbb/parallel_reduce.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cmath>
#include <cstring>
#include <memory>
#include <span>
#include <stdexcept>

#include "accel/box.h"
#include "accel/bytes.h"
#include "core/clock.h"
#include "core/gpu_layout.h"

namespace energyprof::accel {
namespace {

constexpr size_t max_grid_triangle_count = size_t{1} << 30;
constexpr size_t max_ref_count = size_t{1} << 30;
constexpr double max_axis_cell_count = 4096.0;
constexpr double max_cell_count = 0x1p28;
/// Thinner than this share of the largest extent is flat.
constexpr double flat_ratio = 0x1p-16;

// A bucket's cells stay in a core's cache while they are filled; a bucket more costs a stream to
// write to.
constexpr int min_bucket_bits = 13;
constexpr int max_bucket_count_bits = 10;
constexpr size_t min_chunk_size = 4096;  // triangles; for one thread at a time
constexpr size_t max_chunk_count = 64;
constexpr size_t small_range_count = 8;  // cells of a range of at most two on each axis

/// Cells along x, y and z: N_i = ceil(B_i cbrt(lambda n / V)) over the axes that are not flat (of
/// two: square root, area), within the limits.
glm::uvec3 choose_size(const Box& bounds, size_t triangle_count, float lambda) {
  const glm::dvec3 extent = glm::dvec3(bounds.max) - glm::dvec3(bounds.min);
  const double largest = std::max({extent.x, extent.y, extent.z});
  std::array<bool, 3> is_flat{};
  int dimensions = 0;
  double volume = 1.0;  // in units of the largest extent
  for (int axis = 0; axis < 3; ++axis) {
    is_flat[static_cast<size_t>(axis)] = !(extent[axis] > flat_ratio * largest);
    if (is_flat[static_cast<size_t>(axis)]) continue;
    ++dimensions;
    volume *= extent[axis] / largest;
  }
  if (dimensions == 0) return glm::uvec3(1);
  const double cells_per_volume = double{lambda} * static_cast<double>(triangle_count) / volume;
  double cells_per_largest = dimensions == 3   ? std::cbrt(cells_per_volume)
                             : dimensions == 2 ? std::sqrt(cells_per_volume)
                                               : cells_per_volume;
  constexpr double exactly = 1.0 - 1e-12;  // where 3 comes out as 3 and a rounding error, it is 3
  while (true) {
    glm::dvec3 size(1.0);
    for (int axis = 0; axis < 3; ++axis)
      if (!is_flat[static_cast<size_t>(axis)])
        size[axis] = std::clamp(std::ceil(exactly * extent[axis] / largest * cells_per_largest),
                                1.0, max_axis_cell_count);
    if (size.x * size.y * size.z <= max_cell_count) return glm::uvec3(size);
    cells_per_largest *= 0.99;
  }
}

/// Bounds, cells and planes, the latter as core/traversal/grid.h computes them.
struct Lattice {
  Box bounds;
  glm::uvec3 size{1};
  float padding = 0.0f;    // a triangle this close to a plane is in the cells on both sides
  glm::vec3 extent{0.0f};  // of a cell
  glm::vec3 cells_per_unit{0.0f};

  [[nodiscard]] size_t cell_count() const { return size_t{size.x} * size.y * size.z; }
};

Lattice make_lattice(const Mesh& mesh, const GridConfig& config) {
  const Box bounds = tbb::parallel_reduce(
      tbb::blocked_range<size_t>(0, mesh.positions.size(), 16384), Box(),
      [&](const auto& range, Box box) {
        for (size_t i = range.begin(); i < range.end(); ++i) box.grow(mesh.positions[i]);
        return box;
      },
      [](Box a, const Box& b) {
        a.grow(b);
        return a;
      });
  const glm::vec3 extent = bounds.max - bounds.min;
  Lattice lattice;
  lattice.size = choose_size(bounds, mesh.triangles.size(), config.lambda);
  // The traversal's rounding moves planes by some units in the last place of the extent. The last
  // term is for a scene that is a point at the origin.
  lattice.padding = std::max(
      {box_padding(bounds), 0x1p-20f * std::max({extent.x, extent.y, extent.z}), 0x1p-100f});
  lattice.bounds = {bounds.min - lattice.padding, bounds.max + lattice.padding};
  lattice.extent = (lattice.bounds.max - lattice.bounds.min) / glm::vec3(lattice.size);
  lattice.cells_per_unit = glm::vec3(lattice.size) / (lattice.bounds.max - lattice.bounds.min);
  return lattice;
}

// Four lanes, of which x, y and z are used: half of list_cells()'s time went into scalars.
using Float4 = float __attribute__((vector_size(16)));
using Int4 = int32_t __attribute__((vector_size(16)));

Float4 to_float4(const glm::vec3& v) { return Float4{v.x, v.y, v.z, 0.0f}; }
Float4 smaller(Float4 a, Float4 b) { return a < b ? a : b; }
Float4 larger(Float4 a, Float4 b) { return a > b ? a : b; }

/// Cells [first, last] on each axis.
struct CellRange {
  Int4 first;
  Int4 last;

  [[nodiscard]] size_t count() const {
    const Int4 n = last - first + 1;
    return static_cast<size_t>(n[0]) * static_cast<size_t>(n[1]) * static_cast<size_t>(n[2]);
  }
  /// True if no axis has more than two cells.
  [[nodiscard]] bool is_small() const {
    const Int4 n = last - first;
    return (n[0] | n[1] | n[2]) <= 1;
  }
  /// True if the cells lie in one row, along any axis.
  [[nodiscard]] bool is_row() const {
    const Int4 n = last - first;
    return int{n[0] == 0} + int{n[1] == 0} + int{n[2] == 0} >= 2;
  }
};

/// Gives the range of cells that the padded box of a triangle meets.
class BoxOverlap {
 public:
  explicit BoxOverlap(const Lattice& lattice)
      : low_(to_float4(lattice.bounds.min + lattice.padding)),
        high_(to_float4(lattice.bounds.min - lattice.padding)),
        cells_per_unit_(to_float4(lattice.cells_per_unit)),
        last_(to_float4(glm::vec3(lattice.size - 1u))) {}

  [[nodiscard]] CellRange operator()(const glm::vec3& a, const glm::vec3& b,
                                     const glm::vec3& c) const {
    const Float4 p = to_float4(a);
    const Float4 q = to_float4(b);
    const Float4 r = to_float4(c);
    return {cells_at(smaller(smaller(p, q), r) - low_), cells_at(larger(larger(p, q), r) - high_)};
  }

 private:
  [[nodiscard]] Int4 cells_at(Float4 offset) const {
    // What is not a number becomes 0. At most 4095, and truncation is floor.
    return __builtin_convertvector(smaller(larger(offset * cells_per_unit_, Float4{}), last_),
                                   Int4);
  }

  Float4 low_;  // what is taken off the triangle's low end, off its high one
  Float4 high_;
  Float4 cells_per_unit_;
  Float4 last_;
};

/// Tells which cells a triangle meets: the separating-axis test of "Fast 3D Triangle-Box Overlap
/// Testing", T. Akenine-Moeller, JGT 6(1), 2001, as a test against the triangle's plane and its
/// three projections, set up once for all cells: "Fast Parallel Surface and Solid Voxelization on
/// GPUs", M. Schwarz and H.-P. Seidel, ACM TOG 29(6), 2010.
///
/// Cells are taken twice the padding larger, which is more than the rounding here: what it rejects
/// is farther than the padding from the cell. The triangle's box must be tested before.
class ExactOverlap {
 public:
  ExactOverlap(const Lattice& lattice, const glm::vec3& a, const glm::vec3& b, const glm::vec3& c)
      : extent_(lattice.extent), cell_(lattice.extent + 4.0f * lattice.padding) {
    const glm::vec3 low = lattice.bounds.min - 2.0f * lattice.padding;
    corners_ = {a - low, b - low, c - low};
    edges_ = {b - a, c - b, a - c};
  }

  /// Calls take(x, y, z) for the cells of `range` that the triangle meets.
  template <class Take>
  void for_each(const CellRange& range, Take&& take) const {
    for (int axis = 0; axis < 3; ++axis)
      if (range.first[axis] == range.last[axis]) return for_each_in_layer(range, axis, take);
    for_each_in_block(range, take);
  }

 private:
  /// The triangle seen along an axis: its three edges, and a fourth lane that rejects nothing. A
  /// cell whose low corner is at (p, q) can meet it if u p + v q is in [least, most]. Both sides
  /// are tested: on which one of a needle's edge its corner is may be a matter of rounding.
  struct Projection {
    Float4 u;
    Float4 v;
    Float4 least;
    Float4 most;

    [[nodiscard]] bool meets(float p, float q) const {
      using Bits = int64_t __attribute__((vector_size(16)));
      const Float4 place = u * p + v * q;
      const auto outside = reinterpret_cast<Bits>((place < least) | (place > most));
      return (outside[0] | outside[1]) == 0;
    }
  };

  /// On the plane of `axis` and the next one.
  [[nodiscard]] Projection project(int axis) const {
    const int next = (axis + 1) % 3;
    const auto& [a, b, c] = corners_;
    const auto& [ab, bc, ca] = edges_;
    // Of each edge: its normal, and where edge and opposite corner are along it.
    const Float4 u{-ab[next], -bc[next], -ca[next], 0.0f};
    const Float4 v{ab[axis], bc[axis], ca[axis], 0.0f};
    const Float4 edge =
        u * Float4{a[axis], b[axis], c[axis], 0.0f} + v * Float4{a[next], b[next], c[next], 0.0f};
    const Float4 corner =
        u * Float4{c[axis], a[axis], b[axis], 0.0f} + v * Float4{c[next], a[next], b[next], 0.0f};
    const Float4 cell_u = u * cell_[axis];
    const Float4 cell_v = v * cell_[next];
    return {u, v, smaller(edge, corner) - larger(cell_u, Float4{}) - larger(cell_v, Float4{}),
            larger(edge, corner) - smaller(cell_u, Float4{}) - smaller(cell_v, Float4{})};
  }

  /// Cells one deep along `flat`: as the triangle does not leave the layer, seeing it along that
  /// axis is enough.
  template <class Take>
  void for_each_in_layer(const CellRange& range, int flat, Take&& take) const {
    const int p = (flat + 1) % 3;
    const int q = (flat + 2) % 3;
    const Projection projection = project(p);
    std::array<int, 3> cell{range.first[0], range.first[1], range.first[2]};
    int& at_p = cell[static_cast<size_t>(p)];
    int& at_q = cell[static_cast<size_t>(q)];
    for (at_q = range.first[q]; at_q <= range.last[q]; ++at_q)
      for (at_p = range.first[p]; at_p <= range.last[p]; ++at_p)
        if (projection.meets(static_cast<float>(at_p) * extent_[p],
                             static_cast<float>(at_q) * extent_[q]))
          take(cell[0], cell[1], cell[2]);
  }

  template <class Take>
  void for_each_in_block(const CellRange& range, Take&& take) const {
    const Projection xy = project(0);
    const Projection yz = project(1);
    const Projection zx = project(2);
    const glm::vec3 normal = plane_normal();
    const float reach = 0.5f * glm::dot(glm::abs(normal), cell_);
    const float middle = glm::dot(normal, corners_[0] - 0.5f * cell_);
    for (int z = range.first[2]; z <= range.last[2]; ++z)
      for (int y = range.first[1]; y <= range.last[1]; ++y) {
        const float py = static_cast<float>(y) * extent_.y;
        const float pz = static_cast<float>(z) * extent_.z;
        if (!yz.meets(py, pz)) continue;
        for (int x = range.first[0]; x <= range.last[0]; ++x) {
          const float px = static_cast<float>(x) * extent_.x;
          const float distance = glm::dot(normal, glm::vec3(px, py, pz)) - middle;
          if (std::abs(distance) <= reach && xy.meets(px, py) && zx.meets(pz, px)) take(x, y, z);
        }
      }
  }

  /// In double, and from the two shorter edges: of a needle, floats would tell nothing.
  [[nodiscard]] glm::vec3 plane_normal() const {
    const auto& [a, b, c] = corners_;
    const glm::dvec3 ab = glm::dvec3(b) - glm::dvec3(a);
    const glm::dvec3 bc = glm::dvec3(c) - glm::dvec3(b);
    const glm::dvec3 ca = glm::dvec3(a) - glm::dvec3(c);
    const double ab2 = glm::dot(ab, ab);
    const double bc2 = glm::dot(bc, bc);
    const double ca2 = glm::dot(ca, ca);
    if (ab2 > bc2 && ab2 > ca2) return glm::vec3(glm::cross(bc, ca));
    return glm::vec3(bc2 > ca2 ? glm::cross(ca, ab) : glm::cross(ab, bc));
  }

  glm::vec3 extent_;                  // of a cell
  glm::vec3 cell_;                    // extent of a padded cell
  std::array<glm::vec3, 3> corners_;  // from the low corner of the first padded cell
  std::array<glm::vec3, 3> edges_;
};

/// A triangle in a cell.
struct CellRef {
  uint32_t cell;
  uint32_t triangle;
};

/// Storage that is not filled with zeros first, on large pages where possible.
template <class T>
std::unique_ptr<T[]> allocate(size_t count) {
  auto storage = std::make_unique_for_overwrite<T[]>(count);
  prefer_large_pages(storage.get(), count * sizeof(T));
  return storage;
}

/// Resizes an empty vector, on large pages where possible.
template <class T>
void resize(std::vector<T>& vector, size_t count) {
  vector.reserve(count);
  prefer_large_pages(vector.data(), count * sizeof(T));
  vector.resize(count);
}

/// What a chunk of the triangles lists, triangle by triangle.
struct Chunk {
  std::unique_ptr<CellRef[]> refs;
  size_t ref_count = 0;
  std::vector<uint32_t> bucket_counts;  // refs in each bucket; later: where the next one goes
};

class Builder {
 public:
  Builder(const Mesh& mesh, const GridConfig& config)
      : mesh_(mesh), config_(config), lattice_(make_lattice(mesh, config)) {
    bucket_bits_ =
        std::max(min_bucket_bits, static_cast<int>(std::bit_width(lattice_.cell_count() - 1)) -
                                      max_bucket_count_bits);
    bucket_count_ = ((lattice_.cell_count() - 1) >> bucket_bits_) + 1;
  }

  Built build() {
    Built built;
    AccelBlob& blob = built.blob;
    blob.bounds_min = lattice_.bounds.min;
    blob.bounds_max = lattice_.bounds.max;
    blob.grid_size = lattice_.size;

    list_cells();
    sort_into_buckets();
    resize(blob.nodes, lattice_.cell_count() * sizeof(gpu::GridCell));
    resize(blob.refs, bucket_begins_.back());
    const std::span cells(reinterpret_cast<gpu::GridCell*>(blob.nodes.data()),
                          lattice_.cell_count());
    std::atomic<int64_t> occupied_count = 0;
    tbb::parallel_for(size_t{0}, bucket_count_, [&](size_t bucket) {
      const size_t first = bucket << bucket_bits_;
      const size_t count = std::min(size_t{1} << bucket_bits_, cells.size() - first);
      occupied_count += fill_cells(bucket, cells.subspan(first, count), blob.refs);
    });

    built.stats.node_count = static_cast<int64_t>(cells.size());
    built.stats.leaf_count = occupied_count;
    built.stats.ref_count = static_cast<int64_t>(blob.refs.size());
    return built;
  }

 private:
  /// Lists the cells of every triangle, in chunks.
  void list_cells() {
    const size_t triangle_count = mesh_.triangles.size();
    const size_t chunk_size = std::max(min_chunk_size, triangle_count / max_chunk_count + 1);
    chunks_.resize((triangle_count + chunk_size - 1) / chunk_size);
    std::atomic<size_t> total = 0;
    tbb::parallel_for(size_t{0}, chunks_.size(), [&](size_t i) {
      const size_t first = i * chunk_size;
      list_cells(chunks_[i], first, std::min(first + chunk_size, triangle_count), total);
    });
  }

  /// Lists the cells of triangles [first, last). `total` roughly sums the refs of all chunks, so
  /// that too many are refused before they fill the memory.
  void list_cells(Chunk& chunk, size_t first, size_t last, std::atomic<size_t>& total) {
    const BoxOverlap box_overlap(lattice_);
    const glm::uvec3* const triangles = mesh_.triangles.data();
    const glm::vec3* const positions = mesh_.positions.data();
    size_t capacity = 0;
    size_t reported = 0;  // of chunk.ref_count, in `total`
    for (size_t i = first; i < last; ++i) {
      const glm::uvec3& corners = triangles[i];
      const glm::vec3& a = positions[corners.x];
      const glm::vec3& b = positions[corners.y];
      const glm::vec3& c = positions[corners.z];
      const CellRange range = box_overlap(a, b, c);
      const size_t most = std::max(range.count(), small_range_count);
      if (chunk.ref_count + most > capacity) {
        total += chunk.ref_count - reported;
        reported = chunk.ref_count;
        if (total > max_ref_count) fail_for_refs();
        capacity = std::max({3 * (last - first), 2 * capacity, chunk.ref_count + most});
        grow(chunk, capacity);
      }
      CellRef* out = chunk.refs.get() + chunk.ref_count;
      const auto triangle = static_cast<uint32_t>(i);
      const auto take = [&](int x, int y, int z) { *out++ = {cell_index(x, y, z), triangle}; };
      if (config_.exact_overlap && !range.is_row()) {
        ExactOverlap(lattice_, a, b, c).for_each(range, take);
      } else if (range.is_small()) {
        out = list_small(range, triangle, out);
      } else {
        for (int z = range.first[2]; z <= range.last[2]; ++z)
          for (int y = range.first[1]; y <= range.last[1]; ++y)
            for (int x = range.first[0]; x <= range.last[0]; ++x) take(x, y, z);
      }
      chunk.ref_count = static_cast<size_t>(out - chunk.refs.get());
    }
    chunk.bucket_counts.resize(bucket_count_);
    for (size_t k = 0; k < chunk.ref_count; ++k)
      ++chunk.bucket_counts[chunk.refs[k].cell >> bucket_bits_];
  }

  [[nodiscard]] uint32_t cell_index(int x, int y, int z) const {
    return static_cast<uint32_t>(x) +
           lattice_.size.x *
               (static_cast<uint32_t>(y) + lattice_.size.y * static_cast<uint32_t>(z));
  }

  /// Writes the 1, 2, 4 or 8 cells of a small range, always to all 8 places: branches here would be
  /// guessed wrong. Returns the end of those that count.
  CellRef* list_small(const CellRange& range, uint32_t triangle, CellRef* out) const {
    const Int4 n = range.last - range.first;
    const uint32_t low = cell_index(range.first[0], range.first[1], range.first[2]);
    const uint32_t row = lattice_.size.x;
    const uint32_t layer = lattice_.size.x * lattice_.size.y;
    // Steps to the next cell along the first, the second and the third axis with two cells.
    const uint32_t y_or_z = n[1] != 0 ? row : layer;
    const uint32_t step = n[0] != 0 ? 1 : y_or_z;
    const uint32_t second_step = n[0] != 0 ? y_or_z : layer;
    for (uint32_t k = 0; k < 2; ++k) {
      const uint32_t cell = low + k * layer;
      out[4 * k] = {cell, triangle};
      out[4 * k + 1] = {cell + step, triangle};
      out[4 * k + 2] = {cell + second_step, triangle};
      out[4 * k + 3] = {cell + step + second_step, triangle};
    }
    return out + (ptrdiff_t{1} << (n[0] + n[1] + n[2]));
  }

  static void grow(Chunk& chunk, size_t capacity) {
    auto larger = allocate<CellRef>(capacity);
    if (chunk.ref_count > 0)
      std::memcpy(larger.get(), chunk.refs.get(), chunk.ref_count * sizeof(CellRef));
    chunk.refs = std::move(larger);
  }

  [[noreturn]] static void fail_for_refs() {
    throw std::runtime_error(
        fmt::format("cannot build a grid: its cells list triangles more than {} times. Choose a "
                    "smaller lambda.",
                    max_ref_count));
  }

  /// Brings the refs into the order of their buckets, those of a bucket by rising triangle.
  void sort_into_buckets() {
    bucket_begins_.resize(bucket_count_ + 1);
    size_t sum = 0;
    for (size_t bucket = 0; bucket < bucket_count_; ++bucket) {
      bucket_begins_[bucket] = sum;
      for (Chunk& chunk : chunks_) {
        const size_t count = chunk.bucket_counts[bucket];
        chunk.bucket_counts[bucket] = static_cast<uint32_t>(sum);
        sum += count;
        if (sum > max_ref_count) fail_for_refs();
      }
    }
    bucket_begins_[bucket_count_] = sum;
    sorted_ = allocate<CellRef>(sum);
    tbb::parallel_for(size_t{0}, chunks_.size(), [&](size_t i) {
      Chunk& chunk = chunks_[i];
      uint32_t* const next = chunk.bucket_counts.data();
      for (size_t k = 0; k < chunk.ref_count; ++k) {
        const CellRef ref = chunk.refs[k];
        sorted_[next[ref.cell >> bucket_bits_]++] = ref;
      }
      chunk = {};
    });
  }

  /// Counting sort of one bucket into its cells. Returns how many of them list a triangle.
  int64_t fill_cells(size_t bucket, std::span<gpu::GridCell> cells,
                     std::span<uint32_t> refs) const {
    const std::span sorted(sorted_.get() + bucket_begins_[bucket],
                           sorted_.get() + bucket_begins_[bucket + 1]);
    const uint32_t mask = (uint32_t{1} << bucket_bits_) - 1;
    for (const CellRef& ref : sorted) ++cells[ref.cell & mask].count;
    auto end = static_cast<uint32_t>(bucket_begins_[bucket]);
    int64_t occupied_count = 0;
    for (gpu::GridCell& cell : cells) {
      end += cell.count;
      cell.first = end;
      occupied_count += cell.count != 0 ? 1 : 0;
    }
    for (size_t k = sorted.size(); k-- > 0;)  // brings `first` to where the list begins
      refs[--cells[sorted[k].cell & mask].first] = sorted[k].triangle;
    return occupied_count;
  }

  const Mesh& mesh_;
  const GridConfig& config_;
  const Lattice lattice_;
  int bucket_bits_ = 0;
  size_t bucket_count_ = 0;
  std::vector<Chunk> chunks_;
  std::vector<size_t> bucket_begins_;  // in sorted_; one more than there are buckets
  std::unique_ptr<CellRef[]> sorted_;
};

}  // namespace

GridConfig tuned_grid() {
  GridConfig config;
  config.exact_overlap = true;
  return config;
}

Built build_grid(const Mesh& mesh, const GridConfig& config) {
  const size_t triangle_count = mesh.triangles.size();
  if (triangle_count > max_grid_triangle_count)
    throw std::runtime_error(
        fmt::format("cannot build a grid: the mesh has {} triangles, the limit is {}.",
                    triangle_count, max_grid_triangle_count));
  if (!(config.lambda > 0.0f && config.lambda <= 64.0f))
    throw std::runtime_error(fmt::format(
        "cannot build a grid with lambda {}: expected more than 0, up to 64.", config.lambda));
  const int64_t begin_ns = now_ns();
  Built built;
  if (triangle_count > 0) built = Builder(mesh, config).build();
  built.blob.kind = AccelKind::grid;
  built.stats.blob_bytes = static_cast<int64_t>(built.blob.byte_count());
  built.stats.build_ns = now_ns() - begin_ns;
  return built;
}

}  // namespace energyprof::accel
