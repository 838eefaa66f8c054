// The grid: resolution, lists, and the closest hits that brute force finds.
#include "accel/grid.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include <array>
#include <cmath>
#include <limits>
#include <random>
#include <span>

#include "accel/gpu_triangles.h"
#include "accel/trace_cpu.h"
#include "accel/validate.h"
#include "core/gpu_layout.h"
#include "tests/accel/scenes.h"

namespace energyprof::accel {
namespace {

using testing::Contains;
using testing::HasSubstr;
using testing::IsEmpty;

GridConfig with_lambda(float lambda) {
  GridConfig config;
  config.lambda = lambda;
  return config;
}

std::span<const gpu::GridCell> cells_of(const AccelBlob& blob) {
  return {reinterpret_cast<const gpu::GridCell*>(blob.nodes.data()),
          blob.nodes.size() / sizeof(gpu::GridCell)};
}

gpu::GridCell& cell_of(AccelBlob& blob, size_t cell) {
  return reinterpret_cast<gpu::GridCell*>(blob.nodes.data())[cell];
}

/// The grid finds in every pixel what brute force finds.
void expect_same_hits(const Built& built, const Mesh& mesh, const gpu::FrameConstants& camera) {
  const std::vector<gpu::Triangle> triangles = gpu_triangles(mesh);
  const CpuFrame expected = trace_brute_force(triangles, camera);
  const CpuFrame found = trace_cpu("GRID", {built.blob, triangles}, camera);
  EXPECT_EQ(test::different_pixels(expected.hits, found.hits), 0u);
  EXPECT_EQ(sum_hits(expected.hits).hit_checksum, sum_hits(found.hits).hit_checksum);
}

class GridScenes : public testing::TestWithParam<test::NamedMesh> {};

TEST_P(GridScenes, GiveASoundGrid) {
  const Mesh& mesh = GetParam().mesh;
  for (const GridConfig& config : {GridConfig{}, tuned_grid(), with_lambda(0.1f)}) {
    const Built built = build_grid(mesh, config);
    EXPECT_THAT(validate(built.blob, mesh), IsEmpty());
    EXPECT_EQ(built.blob.refs.empty(), mesh.triangles.empty());
    EXPECT_EQ(built.stats.node_count, static_cast<int64_t>(cells_of(built.blob).size()));
    EXPECT_EQ(built.stats.ref_count, static_cast<int64_t>(built.blob.refs.size()));
    EXPECT_EQ(
        built.stats.leaf_count,
        std::ranges::count_if(cells_of(built.blob), [](const auto& c) { return c.count > 0; }));
    EXPECT_EQ(built.stats.blob_bytes, static_cast<int64_t>(built.blob.byte_count()));
    EXPECT_FALSE(built.stats.sah_cost);
  }
}

TEST_P(GridScenes, TraversalFindsWhatBruteForceFinds) {
  const Mesh& mesh = GetParam().mesh;
  const gpu::FrameConstants camera = test::camera_for(mesh, 64, 48);
  for (const GridConfig& config : {GridConfig{}, tuned_grid(), with_lambda(64.0f)})
    expect_same_hits(build_grid(mesh, config), mesh, camera);
}

TEST_P(GridScenes, RaysAlongAxesAndInPlanesBetweenCellsFindWhatBruteForceFinds) {
  const Mesh& mesh = GetParam().mesh;
  const std::vector<gpu::Triangle> triangles = gpu_triangles(mesh);
  std::mt19937 random(31);
  for (const GridConfig& config : {with_lambda(0.5f), tuned_grid()}) {
    const Built built = build_grid(mesh, config);
    const glm::vec3 low = built.blob.bounds_min;
    const glm::vec3 extent = (built.blob.bounds_max - low) / glm::vec3(built.blob.grid_size);
    gpu::FrameConstants camera = test::camera_for(mesh, 1, 1);
    camera.right_tmax = glm::vec4(0.0f, 0.0f, 0.0f, camera.right_tmax.w);
    camera.up = glm::vec4(0.0f);
    size_t difference_count = 0;
    int64_t hit_count = 0;
    for (int i = 0; i < 300; ++i) {
      // Each coordinate of the origin: a plane, or the middle of a cell, or just outside.
      glm::vec3 origin;
      for (int axis = 0; axis < 3; ++axis) {
        const auto plane = static_cast<float>(random() % (built.blob.grid_size[axis] + 1));
        const std::array places{plane, plane + 0.5f, -0.5f,
                                static_cast<float>(built.blob.grid_size[axis]) + 0.5f};
        origin[axis] = low[axis] + places[random() % 4] * extent[axis];
      }
      glm::vec3 forward(0.0f);
      forward[static_cast<int>(random() % 3)] = (random() & 1) != 0 ? 1.0f : -1.0f;
      if (i % 3 == 0)  // on a diagonal through edges of cells
        forward[static_cast<int>(random() % 3)] += (random() & 1) != 0 ? 1.0f : -1.0f;
      if (forward == glm::vec3(0.0f)) continue;
      camera.origin_tmin = glm::vec4(origin, 0.0f);
      camera.forward = glm::vec4(forward, 0.0f);
      camera.frame = static_cast<uint32_t>(i);
      const CpuFrame expected = trace_brute_force(triangles, camera);
      const CpuFrame found = trace_cpu("GRID", {built.blob, triangles}, camera);
      difference_count += test::different_pixels(expected.hits, found.hits);
      hit_count += sum_hits(expected.hits).hit_count;
    }
    EXPECT_EQ(difference_count, 0u);
    if (mesh.triangles.size() >= 300) {
      EXPECT_GT(hit_count, 0);
    }
  }
}

TEST_P(GridScenes, RaysFromInsideFindWhatBruteForceFinds) {
  const Mesh& mesh = GetParam().mesh;
  gpu::FrameConstants camera = test::camera_for(mesh, 32, 24);
  const Bounds box = bounds(mesh);
  camera.origin_tmin = glm::vec4(glm::mix(box.min, box.max, glm::vec3(0.5f, 0.4f, 0.55f)), 0.0f);
  for (uint32_t frame = 0; frame < 3; ++frame) {
    SCOPED_TRACE(frame);
    camera.frame = frame;
    camera.forward = glm::vec4(glm::normalize(glm::vec3(frame, 1, -1)), 0.0f);
    expect_same_hits(build_grid(mesh), mesh, camera);
    expect_same_hits(build_grid(mesh, tuned_grid()), mesh, camera);
  }
}

TEST_P(GridScenes, OneAndTwoThreadsGiveTheSameBytes) {
  for (const GridConfig& config : {GridConfig{}, tuned_grid()}) {
    const auto build = [&](size_t thread_count) {
      const oneapi::tbb::global_control limit(oneapi::tbb::global_control::max_allowed_parallelism,
                                              thread_count);
      return build_grid(GetParam().mesh, config).blob;
    };
    const AccelBlob one = build(1);
    const AccelBlob two = build(2);
    EXPECT_EQ(one.nodes, two.nodes);
    EXPECT_EQ(one.refs, two.refs);
    EXPECT_EQ(one.grid_size, two.grid_size);
  }
}

INSTANTIATE_TEST_SUITE_P(Grid, GridScenes, testing::ValuesIn(test::ugly_scenes()),
                         [](const auto& test) {
                           std::string name = test.param.name;
                           std::replace(name.begin(), name.end(), ' ', '_');
                           return name;
                         });

/// `count` triangles, all the same, whose bounds are [0, extent].
Mesh filling(const glm::vec3& extent, size_t count) {
  Mesh mesh;
  mesh.positions = {glm::vec3(0.0f), extent, {extent.x, 0.0f, 0.0f}};
  mesh.triangles.assign(count, {0, 1, 2});
  return mesh;
}

TEST(Grid, ResolutionFollowsTheFormula) {
  // ceil(B_i cbrt(lambda n / V)): 27 cells in a unit cube are 3 x 3 x 3, and 30 are 3.1 cubed.
  EXPECT_EQ(build_grid(filling({1, 1, 1}, 9)).blob.grid_size, glm::uvec3(3));
  EXPECT_EQ(build_grid(filling({1, 1, 1}, 10)).blob.grid_size, glm::uvec3(4));
  EXPECT_EQ(build_grid(filling({4, 2, 1}, 72)).blob.grid_size, glm::uvec3(12, 6, 3));
  EXPECT_EQ(build_grid(filling({1, 1, 1}, 1), with_lambda(64)).blob.grid_size, glm::uvec3(4));
  EXPECT_EQ(build_grid(filling({1, 1, 1}, 1), with_lambda(0.01f)).blob.grid_size, glm::uvec3(1));
}

TEST(Grid, FlatAxesHaveOneCellAndTheFormulaOfFewerDimensions) {
  // sqrt(3 * 24 / (4 * 2)) = 3 cells per unit; 2 * 5 cells along a line; a point.
  EXPECT_EQ(build_grid(filling({4, 2, 0}, 24)).blob.grid_size, glm::uvec3(12, 6, 1));
  EXPECT_EQ(build_grid(filling({4, 0, 2}, 24)).blob.grid_size, glm::uvec3(12, 1, 6));
  EXPECT_EQ(build_grid(filling({0, 7, 0}, 5), with_lambda(2)).blob.grid_size, glm::uvec3(1, 10, 1));
  EXPECT_EQ(build_grid(filling({0, 0, 0}, 5)).blob.grid_size, glm::uvec3(1));
}

TEST(Grid, NoAxisHasMoreThan4096Cells) {
  const Mesh mesh = filling({1, 0, 0}, 100);
  const Built built = build_grid(mesh, with_lambda(64));
  EXPECT_EQ(built.blob.grid_size, glm::uvec3(4096, 1, 1));
  EXPECT_THAT(validate(built.blob, mesh), IsEmpty());
}

TEST(Grid, RefusesLambdasOutOfRange) {
  for (const float lambda : {0.0f, -1.0f, 64.001f, std::numeric_limits<float>::infinity(),
                             std::numeric_limits<float>::quiet_NaN()}) {
    SCOPED_TRACE(lambda);
    EXPECT_THROW(build_grid(make_teapot(), with_lambda(lambda)), std::runtime_error);
  }
}

TEST(Grid, TrianglesInAPlaneBetweenCellsAreInTheCellsOnBothSides) {
  for (const GridConfig& config : {GridConfig{}, tuned_grid()}) {
    // The first triangle holds the bounds; the others move into planes that the first build tells.
    Mesh mesh = test::triangle_soup(600, 0.2f, 53);
    mesh.triangles.insert(mesh.triangles.begin(), glm::uvec3(1800, 1801, 1802));
    mesh.positions.insert(mesh.positions.end(), {glm::vec3(-0.3f), glm::vec3(1.7f), {1.7f, 0, 0}});
    const AccelBlob before = build_grid(mesh, config).blob;
    const glm::vec3 extent = (before.bounds_max - before.bounds_min) / glm::vec3(before.grid_size);
    const auto plane_of = [&](uint32_t i) {
      return 1 + i / 3 % (before.grid_size[static_cast<int>(i % 3)] - 1);
    };
    for (uint32_t i = 0; i < 600; ++i) {
      const int axis = static_cast<int>(i % 3);
      float place = before.bounds_min[axis] + static_cast<float>(plane_of(i)) * extent[axis];
      if (i % 2 == 0) place = std::nextafter(place, i % 4 == 0 ? 2.0f : -2.0f);
      for (uint32_t corner = 0; corner < 3; ++corner) mesh.positions[3 * i + corner][axis] = place;
    }
    const Built built = build_grid(mesh, config);
    ASSERT_EQ(built.blob.grid_size, before.grid_size);
    ASSERT_EQ(built.blob.bounds_max, before.bounds_max);
    std::vector<std::array<bool, 2>> sides(mesh.triangles.size());
    size_t cell = 0;
    for (uint32_t z = 0; z < before.grid_size.z; ++z)
      for (uint32_t y = 0; y < before.grid_size.y; ++y)
        for (uint32_t x = 0; x < before.grid_size.x; ++x, ++cell) {
          const auto [count, first] = cells_of(built.blob)[cell];
          for (const uint32_t i : std::span(built.blob.refs).subspan(first, count)) {
            if (i == 0) continue;
            const uint32_t place = glm::uvec3(x, y, z)[static_cast<int>((i - 1) % 3)];
            sides[i][place == plane_of(i - 1) ? 1 : 0] = true;
          }
        }
    for (size_t i = 1; i < sides.size(); ++i) EXPECT_TRUE(sides[i][0] && sides[i][1]) << i;
    expect_same_hits(built, mesh, test::camera_for(mesh, 64, 48));
  }
}

/// True if the triangle has a point in the box: clips it to the box's six half spaces, in double.
bool meets(std::vector<glm::dvec3> polygon, const glm::dvec3& low, const glm::dvec3& high) {
  for (int plane = 0; plane < 6; ++plane) {
    const int axis = plane / 2;
    const double sign = plane % 2 == 0 ? 1.0 : -1.0;
    const double offset = plane % 2 == 0 ? low[axis] : -high[axis];
    std::vector<glm::dvec3> clipped;
    for (size_t i = 0; i < polygon.size(); ++i) {
      const glm::dvec3 p = polygon[i];
      const glm::dvec3 q = polygon[(i + 1) % polygon.size()];
      const double at_p = sign * p[axis] - offset;
      const double at_q = sign * q[axis] - offset;
      if (at_p >= 0.0) clipped.push_back(p);
      if ((at_p < 0.0) != (at_q < 0.0)) clipped.push_back(p + (q - p) * (at_p / (at_p - at_q)));
    }
    polygon = std::move(clipped);
  }
  return !polygon.empty();
}

/// Triangles across the unit cube: half of them with two corners, half with three corners on a
/// line, so close together that rounding decides on the normal.
Mesh needles(size_t count, uint32_t seed) {
  Mesh mesh = test::triangle_soup(count, 1.5f, seed);
  std::mt19937 random(seed);
  for (size_t i = 0; i < count; ++i) {
    glm::vec3* const corners = &mesh.positions[3 * i];
    std::swap(corners[0], corners[random() % 3]);
    const float width = std::ldexp(1.0f, -static_cast<int>(random() % 40));
    const float along = i % 2 == 0 ? 0.0f : 0.4f;
    corners[1] = glm::mix(corners[0], corners[2], along) + width * (corners[1] - corners[0]);
    std::swap(corners[random() % 3], corners[random() % 3]);
  }
  return mesh;
}

TEST(Grid, ExactOverlapListsATriangleWhereItIsAndNowhereElse) {
  for (const Mesh& mesh :
       {test::triangle_soup(60, 1.0f, 41), test::triangle_soup(200, 0.2f, 43),
        test::transformed(test::triangle_soup(60, 1.0f, 47), 1.0f, glm::vec3(300.0f, -2.0f, 0.5f)),
        needles(200, 59)}) {
    const AccelBlob blob = build_grid(mesh, {.lambda = 8.0f, .exact_overlap = true}).blob;
    const glm::dvec3 low(blob.bounds_min);
    const glm::dvec3 high(blob.bounds_max);
    const glm::dvec3 extent = (high - low) / glm::dvec3(blob.grid_size);
    // Listed within 2^-21 of the scene's reach, not listed beyond 2^-17.
    const double reach =
        std::max({glm::length(high - low), std::abs(low.x), std::abs(high.x), std::abs(high.y)});
    size_t cell = 0;
    for (uint32_t z = 0; z < blob.grid_size.z; ++z)
      for (uint32_t y = 0; y < blob.grid_size.y; ++y)
        for (uint32_t x = 0; x < blob.grid_size.x; ++x, ++cell) {
          const glm::dvec3 corner = low + glm::dvec3(x, y, z) * extent;
          const auto list =
              std::span(blob.refs).subspan(cells_of(blob)[cell].first, cells_of(blob)[cell].count);
          for (uint32_t i = 0; i < mesh.triangles.size(); ++i) {
            const glm::uvec3 t = mesh.triangles[i];
            const std::vector<glm::dvec3> polygon{mesh.positions[t.x], mesh.positions[t.y],
                                                  mesh.positions[t.z]};
            const double margin = reach * (std::ranges::binary_search(list, i) ? 0x1p-17 : 0x1p-23);
            EXPECT_EQ(meets(polygon, corner - margin, corner + extent + margin),
                      std::ranges::binary_search(list, i))
                << "triangle " << i << ", cell " << x << ' ' << y << ' ' << z;
          }
        }
  }
}

TEST(Grid, ExactOverlapNeedsFewerReferences) {
  const Mesh mesh = test::triangle_soup(300, 1.0f, 13);
  const int64_t by_box = build_grid(mesh).stats.ref_count;
  const int64_t exact = build_grid(mesh, tuned_grid()).stats.ref_count;
  EXPECT_LT(exact, by_box / 2);
}

class GridDefects : public testing::Test {
 protected:
  [[nodiscard]] auto violations() const { return validate(blob, mesh); }

  Mesh mesh = make_teapot();
  AccelBlob blob = build_grid(mesh).blob;
  size_t occupied = static_cast<size_t>(
      std::ranges::find_if(cells_of(blob), [](const auto& c) { return c.count >= 2; }) -
      cells_of(blob).begin());
};

TEST_F(GridDefects, WrongSizes) {
  blob.grid_size.y += 1;
  EXPECT_THAT(violations(), Contains(HasSubstr("expected")));
  blob.grid_size = glm::uvec3(0, 1, 1);
  EXPECT_THAT(violations(), Contains(HasSubstr("0 cells on axis 0")));
  blob.grid_size = glm::uvec3(0xffffffffu);
  EXPECT_THAT(violations(), Contains(HasSubstr("4294967295 cells on axis 2")));
  blob.grid_size = glm::uvec3(1u << 24, 1u << 24, 1u << 24);
  EXPECT_THAT(violations(), Contains(HasSubstr("expected 16777216")));
}

TEST_F(GridDefects, MissingNodes) {
  blob.nodes.resize(blob.nodes.size() - sizeof(gpu::GridCell));
  EXPECT_THAT(violations(), Contains(HasSubstr("expected")));
  blob.nodes.clear();
  EXPECT_THAT(violations(), Contains(HasSubstr("0 cells; expected")));
}

TEST_F(GridDefects, PartOfANode) {
  blob.nodes.pop_back();
  EXPECT_THAT(violations(), Contains(HasSubstr("not a multiple of 8")));
}

TEST_F(GridDefects, BadBounds) {
  const glm::vec3 high = blob.bounds_max;
  blob.bounds_max.x = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THAT(violations(), Contains(HasSubstr("on axis 0")));
  blob.bounds_max.x = blob.bounds_min.x;
  EXPECT_THAT(violations(), Contains(HasSubstr("on axis 0")));
  blob.bounds_max = high;
  blob.bounds_max.y = 0.5f * (blob.bounds_min.y + high.y);
  EXPECT_THAT(violations(), Contains(HasSubstr("out of the bounds on axis 1")));
}

TEST_F(GridDefects, ListOutOfRange) {
  cell_of(blob, occupied).count = 0xfffffff0u;
  EXPECT_THAT(violations(), Contains(HasSubstr("its list ends at")));
}

TEST_F(GridDefects, GapBetweenLists) {
  cell_of(blob, occupied).first += 1;
  EXPECT_THAT(violations(), Contains(HasSubstr("its list begins at")));
}

TEST_F(GridDefects, ReferencesThatNoCellHas) {
  blob.refs.push_back(0);
  EXPECT_THAT(violations(), Contains(HasSubstr("the lists end at")));
}

TEST_F(GridDefects, NoReferences) {
  blob.refs.clear();
  EXPECT_THAT(violations(), Contains(HasSubstr("no references for 2256 triangles")));
}

TEST_F(GridDefects, UnknownTriangle) {
  blob.refs.back() = static_cast<uint32_t>(mesh.triangles.size());
  EXPECT_THAT(violations(), Contains(HasSubstr("triangle 2256 of 2256")));
}

TEST_F(GridDefects, TriangleTwiceInACell) {
  const uint32_t first = cell_of(blob, occupied).first;
  blob.refs[first + 1] = blob.refs[first];
  EXPECT_THAT(violations(), Contains(HasSubstr("expected rising ids")));
}

TEST_F(GridDefects, TriangleMissingInTheCellOfItsCorner) {
  Mesh moved = mesh;
  std::swap(moved.triangles[0], moved.triangles[1000]);
  EXPECT_THAT(validate(blob, moved), Contains(HasSubstr("triangle 0 is not in cell")));
}

TEST_F(GridDefects, TriangleMissingInTheCellOfItsCentre) {
  // A large triangle's centre is in another cell than its corners.
  mesh = filling({1, 1, 1}, 9);
  mesh.positions = {{0, 0, 0}, {1, 0, 0.1f}, {0, 1, 1}};
  blob = build_grid(mesh).blob;
  ASSERT_EQ(blob.grid_size, glm::uvec3(3));
  const size_t centre = 1 + 3 * (1 + 3 * 1);
  const auto [count, first] = cell_of(blob, centre);
  ASSERT_EQ(count, 9u);
  blob.refs.erase(blob.refs.begin() + first);  // triangle 0
  cell_of(blob, centre).count -= 1;
  for (size_t i = centre + 1; i < 27; ++i) cell_of(blob, i).first -= 1;
  EXPECT_THAT(violations(), Contains(HasSubstr("triangle 0 is not in cell 13 of its centre")));
}

TEST_F(GridDefects, ReferencesWithoutTriangles) {
  AccelBlob empty = build_grid({}).blob;
  EXPECT_THAT(validate(empty, {}), IsEmpty());
  empty.refs.push_back(0);
  EXPECT_THAT(validate(empty, {}), Contains(HasSubstr("1 references for no triangles")));
}

}  // namespace
}  // namespace energyprof::accel
