// The kd-tree: structure, cost, and the closest hits that brute force finds.
#include "accel/kdtree.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <functional>
#include <limits>
#include <random>
#include <span>
#include <string>
#include <vector>

#include "accel/box.h"
#include "accel/gpu_triangles.h"
#include "accel/trace_cpu.h"
#include "accel/validate.h"
#include "core/gpu_layout.h"
#include "tests/accel/scenes.h"

namespace energyprof::accel {
namespace {

using testing::Contains;
using testing::Each;
using testing::HasSubstr;
using testing::IsEmpty;

KdTreeConfig without_touching() {
  KdTreeConfig config = tuned_kdtree();
  config.keep_touching = false;
  return config;
}

std::span<const gpu::KdNode> nodes_of(const AccelBlob& blob) {
  return {reinterpret_cast<const gpu::KdNode*>(blob.nodes.data()),
          blob.nodes.size() / sizeof(gpu::KdNode)};
}
bool is_leaf(const gpu::KdNode& node) { return (node.word & 3u) == gpu::kd_leaf; }
float plane_of(const gpu::KdNode& node) { return std::bit_cast<float>(node.plane_or_first); }

/// Both traversals against brute force.
void expect_same_hits(const Built& built, const Mesh& mesh, const gpu::FrameConstants& frame) {
  const std::vector<gpu::Triangle> triangles = gpu_triangles(mesh);
  const CpuFrame expected = trace_brute_force(triangles, frame);
  for (const char* algorithm : {"KD_TREE", "KD_STACK"}) {
    SCOPED_TRACE(algorithm);
    const CpuFrame found = trace_cpu(algorithm, {built.blob, triangles}, frame);
    EXPECT_EQ(test::different_pixels(expected.hits, found.hits), 0u);
    EXPECT_EQ(sum_hits(expected.hits).hit_checksum, sum_hits(found.hits).hit_checksum);
  }
}

/// All rays of the frame are the same: from `origin` along `direction`.
gpu::FrameConstants one_ray(glm::vec3 origin, glm::vec3 direction) {
  gpu::FrameConstants frame{};
  frame.origin_tmin = glm::vec4(origin, 0.0f);
  frame.right_tmax = glm::vec4(0.0f, 0.0f, 0.0f, 1e13f);
  frame.forward = glm::vec4(direction, 0.0f);
  frame.width = 1;
  frame.height = 1;
  frame.row_count = 1;
  return frame;
}

class KdTreeScenes : public testing::TestWithParam<test::NamedMesh> {
 protected:
  const Mesh& mesh() const { return GetParam().mesh; }
};

TEST_P(KdTreeScenes, GiveASoundTree) {
  for (const KdTreeConfig& config : {KdTreeConfig{}, tuned_kdtree(), without_touching()}) {
    SCOPED_TRACE(testing::Message() << "clip " << config.clip << " touch " << config.keep_touching);
    const Built built = build_kdtree(mesh(), config);
    EXPECT_THAT(validate(built.blob, mesh()), IsEmpty());
    EXPECT_EQ(built.blob.refs.empty(), mesh().triangles.empty());
    EXPECT_EQ(built.stats.ref_count, static_cast<int64_t>(built.blob.refs.size()));
    EXPECT_EQ(built.stats.node_count, static_cast<int64_t>(nodes_of(built.blob).size()));
    EXPECT_EQ(built.stats.blob_bytes, static_cast<int64_t>(built.blob.byte_count()));
    EXPECT_EQ(built.stats.leaf_count,
              std::ranges::count_if(nodes_of(built.blob), [](const gpu::KdNode& node) {
                return is_leaf(node) && node.word >> 2u > 0;
              }));
  }
}

TEST_P(KdTreeScenes, TraversalsFindWhatBruteForceFinds) {
  for (const KdTreeConfig& config : {KdTreeConfig{}, tuned_kdtree()}) {
    SCOPED_TRACE(config.clip ? "tuned" : "paper");
    const gpu::FrameConstants camera = test::camera_for(mesh(), 64, 48);
    expect_same_hits(build_kdtree(mesh(), config), mesh(), camera);
  }
}

TEST_P(KdTreeScenes, RaysAlongAxesFindWhatBruteForceFinds) {
  if (mesh().triangles.empty()) return;
  const Bounds box = bounds(mesh());
  const float reach = std::max(glm::length(box.max - box.min), 1e-12f);
  for (const KdTreeConfig& config : {KdTreeConfig{}, tuned_kdtree()}) {
    SCOPED_TRACE(config.clip ? "tuned" : "paper");
    const Built built = build_kdtree(mesh(), config);
    std::mt19937 random(31);
    for (int axis = 0; axis < 3; ++axis)
      for (const float sign : {-1.0f, 1.0f})
        for (int i = 0; i < 10; ++i) {
          // Through a corner of a triangle, hence along edges and through neighbours' corners too.
          glm::vec3 origin = mesh().positions[random() % mesh().positions.size()];
          glm::vec3 direction(0.0f);
          direction[axis] = sign;
          origin[axis] = sign > 0.0f ? box.min[axis] - reach : box.max[axis] + reach;
          SCOPED_TRACE(testing::Message() << "axis " << axis << " sign " << sign << " ray " << i);
          expect_same_hits(built, mesh(), one_ray(origin, direction));
        }
  }
}

TEST_P(KdTreeScenes, RaysThatStartInPlanesFindWhatBruteForceFinds) {
  for (const KdTreeConfig& config : {KdTreeConfig{}, tuned_kdtree()}) {
    SCOPED_TRACE(config.clip ? "tuned" : "paper");
    const Built built = build_kdtree(mesh(), config);
    std::mt19937 random(37);
    std::uniform_real_distribution<float> unit(0.0f, 1.0f);
    const glm::vec3 extent = built.blob.bounds_max - built.blob.bounds_min;
    int ray_count = 0;
    for (const gpu::KdNode& node : nodes_of(built.blob)) {
      if (is_leaf(node) || ray_count == 40) continue;
      const int axis = static_cast<int>(node.word & 3u);
      glm::vec3 origin =
          built.blob.bounds_min + extent * glm::vec3(unit(random), unit(random), unit(random));
      origin[axis] = plane_of(node);
      glm::vec3 direction = glm::vec3(unit(random), unit(random), unit(random)) - 0.5f;
      // Every other one stays in the plane.
      if (ray_count % 2 == 0) direction[axis] = ray_count % 4 == 0 ? 0.0f : -0.0f;
      SCOPED_TRACE(testing::Message() << "ray " << ray_count++);
      expect_same_hits(built, mesh(), one_ray(origin, direction));
    }
  }
}

TEST_P(KdTreeScenes, RaysAimedAtCornersFindWhatBruteForceFinds) {
  if (mesh().triangles.empty()) return;
  const gpu::FrameConstants camera = test::camera_for(mesh(), 1, 1);
  for (const KdTreeConfig& config : {KdTreeConfig{}, tuned_kdtree()}) {
    SCOPED_TRACE(config.clip ? "tuned" : "paper");
    const Built built = build_kdtree(mesh(), config);
    std::mt19937 random(41);
    for (int i = 0; i < 60; ++i) {
      const glm::vec3 corner = mesh().positions[random() % mesh().positions.size()];
      const glm::vec3 origin(camera.origin_tmin);
      SCOPED_TRACE(testing::Message() << "ray " << i);
      expect_same_hits(built, mesh(), one_ray(origin, corner - origin));
    }
  }
}

TEST_P(KdTreeScenes, GiveTheSameBytesWithOneAndTwoThreads) {
  for (const KdTreeConfig& config : {KdTreeConfig{}, tuned_kdtree()}) {
    const auto build_with = [&](size_t thread_count) {
      const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, thread_count);
      return build_kdtree(mesh(), config);
    };
    const Built one = build_with(1);
    const Built two = build_with(2);
    EXPECT_EQ(one.blob.nodes, two.blob.nodes);
    EXPECT_EQ(one.blob.refs, two.blob.refs);
    EXPECT_EQ(one.stats.sah_cost, two.stats.sah_cost);
  }
}

std::vector<test::NamedMesh> scenes() {
  std::vector<test::NamedMesh> all = test::ugly_scenes();
  Mesh line;  // all triangles in one line: bounds without area
  for (uint32_t i = 0; i < 20; ++i) {
    const auto x = static_cast<float>(i);
    line.positions.insert(line.positions.end(), {{x, 0, 0}, {x + 1, 0, 0}, {x + 3, 0, 0}});
    line.triangles.emplace_back(3 * i, 3 * i + 1, 3 * i + 2);
  }
  Mesh point;  // no extent at all
  point.positions.assign(3, glm::vec3(0.0f));
  point.triangles.assign(30, glm::uvec3(0, 1, 2));
  all.push_back({"line", line});
  all.push_back({"point", point});
  all.push_back({"steps", {}});
  for (uint32_t i = 0; i < 12; ++i) {  // flat triangles in planes that others begin at
    Mesh& steps = all.back().mesh;
    const auto z = static_cast<float>(i);
    steps.positions.insert(steps.positions.end(),
                           {{0, 0, z}, {1, 0, z}, {0, 1, z}, {0, 0, z}, {1, 0, z}, {1, 0, z + 1}});
    steps.triangles.emplace_back(6 * i, 6 * i + 1, 6 * i + 2);
    steps.triangles.emplace_back(6 * i + 3, 6 * i + 4, 6 * i + 5);
  }
  return all;
}

INSTANTIATE_TEST_SUITE_P(All, KdTreeScenes, testing::ValuesIn(scenes()), [](const auto& test) {
  std::string name = test.param.name;
  std::replace(name.begin(), name.end(), ' ', '_');
  return name;
});

TEST(KdTree, LargeMeshesAreBuiltAlikeByOneAndTwoThreads) {
  const Mesh mesh = test::triangle_soup(60000, 0.02f, 43);
  for (const KdTreeConfig& config : {KdTreeConfig{}, tuned_kdtree()}) {
    const auto build_with = [&](size_t thread_count) {
      const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, thread_count);
      return build_kdtree(mesh, config);
    };
    const Built one = build_with(1);
    const Built two = build_with(2);
    EXPECT_THAT(validate(one.blob, mesh), IsEmpty());
    EXPECT_TRUE(one.blob.nodes == two.blob.nodes);
    EXPECT_TRUE(one.blob.refs == two.blob.refs);
    EXPECT_EQ(one.stats.sah_cost, two.stats.sah_cost);
  }
}

// ------------------------------------------------------------------------------ cost

TEST(KdTree, SahCostOfTwoDistantTrianglesIsKnown) {
  // Two right triangles with unit legs in the planes z = 0 and z = 4. Half area of the root:
  // 1 + 4 + 4 = 9. With equal costs and no bonus the cheapest tree cuts off the space between them
  // (each plane costs 1 / 9 of a cell's area, and saves a triangle there).
  Mesh mesh;
  for (const float z : {0.0f, 4.0f}) {
    const auto base = static_cast<uint32_t>(mesh.positions.size());
    mesh.positions.insert(mesh.positions.end(), {{0, 0, z}, {1, 0, z}, {0, 1, z}});
    mesh.triangles.emplace_back(base, base + 1, base + 2);
  }
  KdTreeConfig config;
  config.intersect_cost = 10.0f;
  config.empty_bonus = 0.0f;
  config.max_leaf_size = 1;
  config.bad_refinement_count = 1;
  const Built built = build_kdtree(mesh, config);
  // The first plane just above z = 0 leaves a flat cell of half area 1 with a triangle and one of
  // half area 9 with the other: 1 + 10 (1 + 9) / 9. Leaves of one triangle are not split again.
  ASSERT_TRUE(built.stats.sah_cost);
  EXPECT_NEAR(*built.stats.sah_cost, 1.0 + 10.0 * (1.0 + 9.0) / 9.0, 1e-3);
  EXPECT_EQ(built.stats.node_count, 3);
  EXPECT_EQ(built.stats.leaf_count, 2);
  EXPECT_EQ(built.blob.max_depth, 1u);
  EXPECT_EQ(nodes_of(built.blob)[0].word & 3u, 2u);
}

TEST(KdTree, SahCostIsTheSumOverTheCells) {
  const Mesh mesh = test::triangle_soup(3000, 0.1f, 47);
  for (const KdTreeConfig& config : {KdTreeConfig{}, tuned_kdtree(), without_touching()}) {
    const Built built = build_kdtree(mesh, config);
    const auto nodes = nodes_of(built.blob);
    double sum = 0.0;
    const std::function<void(size_t, Box)> visit = [&](size_t index, const Box& cell) {
      const gpu::KdNode node = nodes[index];
      if (is_leaf(node)) {
        sum += double{cell.half_area()} * double{config.intersect_cost} * (node.word >> 2u);
        return;
      }
      sum += double{cell.half_area()} * double{config.traverse_cost};
      Box below = cell;
      Box above = cell;
      const auto axis = static_cast<int>(node.word & 3u);
      below.max[axis] = above.min[axis] = plane_of(node);
      visit(index + 1, below);
      visit(node.word >> 2u, above);
    };
    const Box root{built.blob.bounds_min, built.blob.bounds_max};
    visit(0, root);
    EXPECT_NEAR(*built.stats.sah_cost / (sum / double{root.half_area()}), 1.0, 1e-4);
  }
}

/// Cost of splitting the root at `plane`: every triangle counted, none sorted.
double root_cost(const Built& built, const std::vector<Box>& boxes, const KdTreeConfig& config,
                 int axis, float plane) {
  const Box root{built.blob.bounds_min, built.blob.bounds_max};
  Box below = root;
  Box above = root;
  below.max[axis] = above.min[axis] = plane;
  double below_count = 0;
  double above_count = 0;
  for (const Box& box : boxes) {
    below_count += box.min[axis] < plane ? 1 : 0;
    above_count += box.max[axis] > plane ? 1 : 0;
  }
  const double cost = double{config.traverse_cost} + double{config.intersect_cost} *
                                                         (below_count * double{below.half_area()} +
                                                          above_count * double{above.half_area()}) /
                                                         double{root.half_area()};
  return below_count == 0 || above_count == 0 ? cost * (1.0 - double{config.empty_bonus}) : cost;
}

TEST(KdTree, TheRootIsSplitWhereItIsCheapest) {
  std::mt19937 random(53);
  for (int round = 0; round < 120; ++round) {
    SCOPED_TRACE(testing::Message() << "round " << round);
    const size_t count = 9 + random() % (round % 4 == 0 ? 700 : 60);
    Mesh mesh =
        test::triangle_soup(count, round % 3 == 0 ? 0.5f : 0.05f, static_cast<uint32_t>(random()));
    if (round % 2 == 0)  // many bounds at the same place
      for (glm::vec3& p : mesh.positions) p = glm::round(p * 20.0f);
    if (round % 5 == 0)  // most triangles in one corner: bins of very different sizes
      for (glm::vec3& p : mesh.positions) p = p * p * p * p;
    KdTreeConfig config;
    config.clip = round % 7 < 4;
    config.empty_bonus = round % 4 == 1 ? 0.5f : 0.2f;
    const Built built = build_kdtree(mesh, config);
    const gpu::KdNode node = nodes_of(built.blob)[0];
    ASSERT_FALSE(is_leaf(node));
    const auto axis = static_cast<int>(node.word & 3u);
    const Box root{built.blob.bounds_min, built.blob.bounds_max};
    if (!config.clip) {
      EXPECT_EQ(axis, root.longest_axis());
    }

    const Bounds extents = bounds(mesh);
    const glm::vec3 extent = extents.max - extents.min;
    const float padding = std::max(box_padding({extents.min, extents.max}),
                                   0x1p-20f * std::max({extent.x, extent.y, extent.z}));
    std::vector<Box> boxes;
    for (size_t i = 0; i < mesh.triangles.size(); ++i)
      boxes.push_back(triangle_box(mesh, i, padding));
    double best = std::numeric_limits<double>::infinity();
    for (int other = 0; other < 3; ++other) {
      if (!config.clip && other != axis) continue;
      for (const Box& box : boxes)
        for (const float plane : {box.min[other], box.max[other]})
          if (plane > root.min[other] && plane < root.max[other])
            best = std::min(best, root_cost(built, boxes, config, other, plane));
    }
    EXPECT_NEAR(root_cost(built, boxes, config, axis, plane_of(node)) / best, 1.0, 1e-5);
  }
}

TEST(KdTree, ClippingCutsTheCost) {
  const Mesh mesh = test::triangle_soup(3000, 0.3f, 59);
  KdTreeConfig whole = tuned_kdtree();
  whole.clip = false;
  EXPECT_LT(*build_kdtree(mesh, tuned_kdtree()).stats.sah_cost,
            0.95 * *build_kdtree(mesh, whole).stats.sah_cost);
}

TEST(KdTree, WithoutTouchingTrianglesTreesAreSmaller) {
  const Mesh mesh = make_teapot(12);
  const Built all = build_kdtree(mesh, tuned_kdtree());
  const Built fewer = build_kdtree(mesh, without_touching());
  EXPECT_LT(2 * fewer.stats.ref_count, all.stats.ref_count);
  EXPECT_LT(*fewer.stats.sah_cost, *all.stats.sah_cost);
}

TEST(KdTree, TunedTreesAreCheaperThanThePapersAtTheSameCosts) {
  KdTreeConfig paper;
  paper.intersect_cost = 1.0f;
  EXPECT_LT(*build_kdtree(make_teapot(12), tuned_kdtree()).stats.sah_cost,
            *build_kdtree(make_teapot(12), paper).stats.sah_cost);
}

// ------------------------------------------------------------------------------ limits

TEST(KdTree, NoPathIsLongerThanTheLimit) {
  const Mesh mesh = test::triangle_soup(2000, 0.05f, 61);
  KdTreeConfig config = tuned_kdtree();
  for (const int limit : {1, 2, 7}) {
    config.max_depth = limit;
    const Built built = build_kdtree(mesh, config);
    EXPECT_EQ(built.stats.max_depth, limit);
    EXPECT_EQ(built.blob.max_depth, static_cast<uint32_t>(limit));
    EXPECT_THAT(validate(built.blob, mesh), IsEmpty());
  }
  config.max_depth = 120;
  config.empty_bonus = 1.0f;  // cutting off nothing costs nothing
  EXPECT_LE(build_kdtree(mesh, config).stats.max_depth, 120);
  config = {};
  EXPECT_LE(build_kdtree(mesh, config).stats.max_depth, 8 + 13);  // 8 + 1.3 * 10
}

TEST(KdTree, LeavesAreAsLargeAsAllowed) {
  const Mesh mesh = test::triangle_soup(9, 0.2f, 67);
  KdTreeConfig config;
  config.max_leaf_size = 9;
  const Built built = build_kdtree(mesh, config);
  EXPECT_EQ(built.stats.node_count, 1);
  EXPECT_EQ(built.blob.max_depth, 0u);
  EXPECT_THAT(built.blob.refs, testing::ElementsAre(0, 1, 2, 3, 4, 5, 6, 7, 8));
  config.max_leaf_size = 8;
  EXPECT_GT(build_kdtree(mesh, config).stats.node_count, 1);
}

TEST(KdTree, DuplicatesEndInOneLeaf) {
  Mesh mesh = test::triangle_soup(1, 1.0f, 71);
  mesh.triangles.assign(1000, mesh.triangles[0]);
  const Built built = build_kdtree(mesh, without_touching());
  EXPECT_THAT(validate(built.blob, mesh), IsEmpty());
  EXPECT_LT(built.stats.ref_count, 20'000);
}

TEST(KdTree, CoordinatesNearTheLargestFloatAreTaken) {
  for (const float scale : {1.6e38f, 3.1e38f, 1e-38f}) {
    const Mesh mesh = test::transformed(test::triangle_soup(100, 0.1f, 73), scale, glm::vec3(0.0f));
    for (const KdTreeConfig& config : {KdTreeConfig{}, tuned_kdtree()}) {
      const Built built = build_kdtree(mesh, config);
      EXPECT_THAT(validate(built.blob, mesh), IsEmpty());
    }
  }
}

TEST(KdTree, RefusesParametersOutsideTheirRanges) {
  const auto expect_refused = [](auto change) {
    KdTreeConfig config;
    change(config);
    EXPECT_THROW(build_kdtree(make_teapot(2), config), std::runtime_error);
  };
  expect_refused([](KdTreeConfig& c) { c.traverse_cost = 0.0f; });
  expect_refused([](KdTreeConfig& c) { c.intersect_cost = -1.0f; });
  expect_refused([](KdTreeConfig& c) { c.intersect_cost = std::nanf(""); });
  expect_refused([](KdTreeConfig& c) { c.empty_bonus = 1.5f; });
  expect_refused([](KdTreeConfig& c) { c.empty_bonus = -0.5f; });
  expect_refused([](KdTreeConfig& c) { c.max_leaf_size = 0; });
  expect_refused([](KdTreeConfig& c) { c.max_leaf_size = 65; });
  expect_refused([](KdTreeConfig& c) { c.bad_refinement_count = -1; });
  expect_refused([](KdTreeConfig& c) { c.max_depth = 121; });
}

// ------------------------------------------------------------------------------ validate()

class BrokenKdTree : public testing::Test {
 protected:
  gpu::KdNode& node(size_t index) {
    return reinterpret_cast<gpu::KdNode*>(blob_.nodes.data())[index];
  }
  size_t first_leaf() {
    size_t i = 0;
    while (!is_leaf(node(i)) || node(i).word >> 2u == 0) ++i;
    return i;
  }
  const Mesh mesh_ = make_teapot(2);
  AccelBlob blob_ = build_kdtree(mesh_, tuned_kdtree()).blob;
};

TEST_F(BrokenKdTree, EachDefectIsNamed) {
  ASSERT_THAT(validate(blob_, mesh_), IsEmpty());
  const AccelBlob sound = blob_;
  const auto expect = [&](const char* words) {
    EXPECT_THAT(validate(blob_, mesh_), Contains(HasSubstr(words)));
    blob_ = sound;
  };
  blob_.nodes.resize(blob_.nodes.size() - 1);
  expect("not a multiple of 8");
  blob_.nodes.clear();
  expect("0 nodes for");
  blob_.refs.clear();
  expect("0 refs for");
  blob_.nodes.resize(blob_.nodes.size() + 8);
  expect("cannot be reached from the root");
  blob_.bounds_max.x = 0.0f;
  expect("the mesh reaches out of the bounds on axis 0");
  blob_.bounds_min.y = std::nanf("");
  expect("bounds [nan");
  blob_.bounds_min.z = 1e9f;
  expect("bounds [1000000000");
  blob_.max_depth = 1;
  expect("max_depth is 1");
  node(0).word = (1u << 22u) | (node(0).word & 3u);
  expect("child 1048576 is not in");
  node(0).word = node(0).word & 3u;
  expect("child 0 is not in");
  node(0).word = (1u << 2u) | (node(0).word & 3u);
  expect("node 1 is reached more than once");
  node(0).plane_or_first = std::bit_cast<uint32_t>(1e9f);
  expect("is not inside its cell");
  node(0).plane_or_first = std::bit_cast<uint32_t>(std::nanf(""));
  expect("plane nan is not inside");
  node(first_leaf()).plane_or_first = 0xFFFFFFFFu;
  expect("refs [4294967295");
  node(first_leaf()).word += 4u;
  expect("the leaves list");
  blob_.refs.push_back(0);
  expect("the leaves list");
  blob_.refs[5] = 100'000;
  expect("ref 5: triangle 100000 of");
}

TEST_F(BrokenKdTree, ATriangleThatIsMissingIsNamed) {
  // The lists hold another triangle instead: only where triangles lie can tell.
  size_t found_count = 0;
  const AccelBlob sound = blob_;
  for (size_t i = 0; i < sound.refs.size(); i += 7) {
    const uint32_t triangle = sound.refs[i];
    std::ranges::replace(blob_.refs, triangle, triangle == 0 ? 1u : 0u);
    const std::vector<std::string> violations = validate(blob_, mesh_);
    EXPECT_THAT(violations, Each(HasSubstr("is not in leaf")));
    found_count += violations.size();
    EXPECT_THAT(violations, testing::Not(IsEmpty())) << "triangle " << triangle;
    blob_ = sound;
  }
  EXPECT_GT(found_count, 10u);
}

TEST_F(BrokenKdTree, EmptyMeshesHaveNoNodes) {
  EXPECT_THAT(validate(blob_, Mesh{}), Contains(HasSubstr("nodes for 0 triangles")));
  blob_.nodes.clear();
  EXPECT_THAT(validate(blob_, Mesh{}), Contains(HasSubstr("refs for 0 triangles")));
}

TEST_F(BrokenKdTree, GarbageIsReadWithoutLeavingTheBlob) {
  const AccelBlob sound = blob_;
  std::mt19937 random(79);
  size_t noticed_count = 0;
  constexpr size_t round_count = 400;
  for (size_t round = 0; round < round_count; ++round) {
    SCOPED_TRACE(testing::Message() << "round " << round);
    blob_ = sound;
    const size_t change_count = 1 + random() % (round % 8 == 0 ? 4096 : 4);
    for (size_t i = 0; i < change_count; ++i)
      blob_.nodes[random() % blob_.nodes.size()] ^=
          std::byte{static_cast<uint8_t>(1 + random() % 255)};
    if (round % 3 == 0) blob_.refs[random() % blob_.refs.size()] = static_cast<uint32_t>(random());
    noticed_count += validate(blob_, mesh_).empty() ? 0 : 1;
  }
  // What is left unnoticed are planes that moved a little.
  EXPECT_GT(noticed_count, round_count / 2);
}

}  // namespace
}  // namespace energyprof::accel
