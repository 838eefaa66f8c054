// The BVHs: structure, cost, and the closest hits that brute force finds.
#include "accel/bvh.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <random>

#include "accel/gpu_triangles.h"
#include "accel/trace_cpu.h"
#include "accel/validate.h"
#include "core/algorithms.h"
#include "core/gpu_layout.h"
#include "tests/accel/scenes.h"

namespace energyprof::accel {
namespace {

using testing::Contains;
using testing::Each;
using testing::HasSubstr;
using testing::IsEmpty;

constexpr AccelKind layouts[] = {AccelKind::bvh_depth_first, AccelKind::bvh_breadth_first,
                                 AccelKind::bvh_miss_links};

struct NamedConfig {
  std::string name;
  BvhConfig config;
};

BvhConfig swept_bvh() {
  BvhConfig config = tuned_bvh();
  config.method = BvhConfig::Method::sweep;
  return config;
}

/// One of each way through the builders.
std::vector<NamedConfig> configs() {
  BvhConfig large_leaves = tuned_bvh();
  large_leaves.max_leaf_size = 16;
  BvhConfig leaves_on_one_axis;
  leaves_on_one_axis.max_leaf_size = 3;
  BvhConfig single_all_axes = tuned_bvh();
  single_all_axes.max_leaf_size = 1;
  BvhConfig swept_on_one_axis;
  swept_on_one_axis.method = BvhConfig::Method::sweep;
  return {{"paper", {}},
          {"tuned", tuned_bvh()},
          {"large leaves", large_leaves},
          {"leaves on one axis", leaves_on_one_axis},
          {"single triangles, all axes", single_all_axes},
          {"swept", swept_bvh()},
          {"swept on one axis", swept_on_one_axis}};
}

const gpu::BvhNode* nodes_of(const AccelBlob& blob) {
  return reinterpret_cast<const gpu::BvhNode*>(blob.nodes.data());
}
size_t node_count_of(const AccelBlob& blob) { return blob.nodes.size() / sizeof(gpu::BvhNode); }
int32_t word_of(const gpu::BvhNode& node) { return std::bit_cast<int32_t>(node.min_link.w); }
uint32_t link_of(const gpu::BvhNode& node) { return std::bit_cast<uint32_t>(node.max_link.w); }

/// A node without its link, which differs from layout to layout.
struct PlainNode {
  glm::vec3 min;
  glm::vec3 max;
  int axis;                         // -1 of a leaf
  std::vector<uint32_t> triangles;  // of a leaf
  bool operator==(const PlainNode&) const = default;
};

/// A tree's nodes depth first, whatever its layout.
std::vector<PlainNode> plain_nodes(const AccelBlob& blob) {
  std::vector<PlainNode> plain;
  if (blob.nodes.empty()) return plain;
  const gpu::BvhNode* nodes = nodes_of(blob);
  std::vector<uint32_t> open{0};
  while (!open.empty()) {
    const uint32_t i = open.back();
    open.pop_back();
    const gpu::BvhNode& node = nodes[i];
    plain.push_back({glm::vec3(node.min_link), glm::vec3(node.max_link), -1, {}});
    if (const int32_t word = word_of(node); word >= 0) {
      for (uint32_t k = 0; k < link_of(node); ++k) {
        const auto entry = static_cast<uint32_t>(word) + k;
        plain.back().triangles.push_back(blob.refs.empty() ? entry : blob.refs[entry]);
      }
      continue;
    }
    plain.back().axis = -word_of(node) - 1;
    if (blob.kind == AccelKind::bvh_breadth_first) {
      open.insert(open.end(), {link_of(node) + 1, link_of(node)});
    } else if (blob.kind == AccelKind::bvh_depth_first) {
      open.insert(open.end(), {link_of(node), i + 1});
    } else {
      const gpu::BvhNode& left = nodes[i + 1];
      open.insert(open.end(), {word_of(left) >= 0 ? i + 2 : link_of(left), i + 1});
    }
  }
  return plain;
}

/// The algorithm that traverses a layout.
std::string_view algorithm_for(AccelKind layout) {
  for (const AlgorithmInfo& algorithm : algorithm_list)
    if (algorithm.kind == layout) return algorithm.name;
  return {};
}

// ---------------------------------------------------------------------------- every scene

class UglyScenes : public testing::TestWithParam<test::NamedMesh> {};

TEST_P(UglyScenes, GiveSoundTrees) {
  const Mesh& mesh = GetParam().mesh;
  const auto triangle_count = static_cast<int64_t>(mesh.triangles.size());
  for (const auto& [name, config] : configs()) {
    SCOPED_TRACE(name);
    std::vector<PlainNode> expected;
    for (const AccelKind layout : layouts) {
      SCOPED_TRACE(algorithm_for(layout));
      const Built built = build_bvh(mesh, config, layout);
      EXPECT_EQ(built.blob.kind, layout);
      EXPECT_THAT(validate(built.blob, mesh), IsEmpty());
      EXPECT_LE(built.blob.max_depth, max_bvh_depth);
      EXPECT_EQ(built.stats.max_depth, built.blob.max_depth);
      EXPECT_EQ(built.stats.node_count, static_cast<int64_t>(node_count_of(built.blob)));
      EXPECT_EQ(built.stats.ref_count, triangle_count);
      EXPECT_EQ(built.stats.blob_bytes, static_cast<int64_t>(built.blob.byte_count()));

      const std::vector<PlainNode> tree = plain_nodes(built.blob);
      int64_t leaf_count = 0;
      for (const PlainNode& node : tree) {
        leaf_count += node.axis < 0 ? 1 : 0;
        EXPECT_LE(node.triangles.size(), static_cast<size_t>(config.max_leaf_size));
      }
      EXPECT_EQ(built.stats.leaf_count, leaf_count);
      if (config.max_leaf_size == 1) {
        EXPECT_EQ(leaf_count, triangle_count);
        EXPECT_THAT(built.blob.refs, IsEmpty());
      }
      if (layout == layouts[0]) expected = tree;
      EXPECT_TRUE(tree == expected) << "the tree depends on the layout";
    }
  }
}

TEST_P(UglyScenes, TraversalFindsWhatBruteForceFinds) {
  const Mesh& mesh = GetParam().mesh;
  const std::vector<gpu::Triangle> triangles = gpu_triangles(mesh);
  const gpu::FrameConstants camera = test::camera_for(mesh, 64, 48);
  const CpuFrame expected = trace_brute_force(triangles, camera);
  if (GetParam().name != "nothing") {
    EXPECT_GT(sum_hits(expected.hits).hit_count, 0);
  }
  for (const auto& [name, config] : {configs()[0], configs()[1], configs()[5]}) {
    SCOPED_TRACE(name);
    for (const AccelKind layout : layouts) {
      SCOPED_TRACE(algorithm_for(layout));
      const Built built = build_bvh(mesh, config, layout);
      const CpuFrame found = trace_cpu(algorithm_for(layout), {built.blob, triangles}, camera);
      EXPECT_EQ(test::different_pixels(expected.hits, found.hits), 0u);
      EXPECT_EQ(sum_hits(expected.hits).hit_checksum, sum_hits(found.hits).hit_checksum);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Bvh, UglyScenes, testing::ValuesIn(test::ugly_scenes()),
                         [](const auto& test) {
                           std::string name = test.param.name;
                           std::replace(name.begin(), name.end(), ' ', '_');
                           return name;
                         });

TEST(Bvh, FramesAndSeedsDrawOtherRays) {
  const Mesh mesh = make_teapot();
  const Built built = build_bvh(mesh);
  const std::vector<gpu::Triangle> triangles = gpu_triangles(mesh);
  gpu::FrameConstants camera = test::camera_for(mesh, 64, 48);
  const auto checksum = [&] {
    return sum_hits(trace_cpu("BVH_FTB_DF", {built.blob, triangles}, camera).hits).hit_checksum;
  };
  const std::string first = checksum();
  EXPECT_EQ(checksum(), first);
  camera.frame = 1;
  const std::string second = checksum();
  EXPECT_NE(second, first);
  camera.seed = 99;
  EXPECT_NE(checksum(), second);
}

// ---------------------------------------------------------------------------- cost

/// Right triangles with unit legs in the planes z = 0, z = gap, ...
Mesh stacked_triangles(size_t count, float gap) {
  Mesh mesh;
  for (size_t i = 0; i < count; ++i) {
    const float z = gap * static_cast<float>(i);
    const auto base = static_cast<uint32_t>(mesh.positions.size());
    mesh.positions.insert(mesh.positions.end(), {{0, 0, z}, {1, 0, z}, {0, 1, z}});
    mesh.triangles.emplace_back(base, base + 1, base + 2);
  }
  return mesh;
}

TEST(Bvh, SahCostOfTwoTrianglesIsKnown) {
  // Two triangles a unit apart: each leaf box is a unit square (half area 1), the root a unit cube
  // (half area 3). Cost: C_trav + C_isect (1 + 1) / 3.
  const Built built = build_bvh(stacked_triangles(2, 1.0f));
  ASSERT_TRUE(built.stats.sah_cost);
  EXPECT_NEAR(*built.stats.sah_cost, 1.0 + 2.0 * 2.0 / 3.0, 1e-5);
  EXPECT_EQ(built.stats.max_depth, 1);
}

TEST(Bvh, ALeafIsMadeExactlyWhereItIsNotDearer) {
  // Two triangles `gap` apart: the root's half area is A = 1 + 2 gap. Apart they cost
  // C_trav A + 2 C_isect, in a leaf 2 C_isect A. With both constants 1 a leaf pays off for A <= 2,
  // gap <= 1/2.
  BvhConfig one_axis;
  one_axis.max_leaf_size = 2;
  one_axis.intersect_cost = 1.0f;
  for (const BvhConfig& config : {tuned_bvh(), swept_bvh(), one_axis}) {
    EXPECT_EQ(build_bvh(stacked_triangles(2, 0.49f), config).stats.leaf_count, 1);
    EXPECT_EQ(build_bvh(stacked_triangles(2, 0.51f), config).stats.leaf_count, 2);
    EXPECT_NEAR(*build_bvh(stacked_triangles(2, 0.25f), config).stats.sah_cost, 2.0, 1e-5);
  }
}

TEST(Bvh, NoSplitOfFourTrianglesBeatsTheSweep) {
  // Triangles in the planes z = 0, 1, 5, 6: two and two is the cheapest split by far, since the gap
  // in the middle is the largest. Every split of four along z, one triangle a leaf:
  // two and two, half areas 1 + 2 * 1 each, then leaves of 1: sum of inner areas 13 + 3 + 3.
  Mesh mesh = stacked_triangles(4, 1.0f);
  for (size_t i = 6; i < 12; ++i) mesh.positions[i].z += 3.0f;
  for (BvhConfig config : {tuned_bvh(), swept_bvh()}) {
    config.max_leaf_size = 1;
    const Built built = build_bvh(mesh, config);
    EXPECT_EQ(built.stats.max_depth, 2);
    EXPECT_NEAR(*built.stats.sah_cost, (13.0 + 3.0 + 3.0 + 4.0) / 13.0, 1e-5);
  }
}

TEST(Bvh, SahCutsTheCostOfAMiddleSplit) {
  const Mesh mesh = test::triangle_soup(5000, 0.02f, 29);
  BvhConfig middle;
  middle.middle_split_count = 1 << 20;
  BvhConfig swept_middle = middle;
  swept_middle.method = BvhConfig::Method::sweep;
  EXPECT_LT(*build_bvh(mesh).stats.sah_cost, 0.95 * *build_bvh(mesh, middle).stats.sah_cost);
  EXPECT_DOUBLE_EQ(*build_bvh(mesh, middle).stats.sah_cost,
                   *build_bvh(mesh, swept_middle).stats.sah_cost);
}

TEST(Bvh, MoreWorkGivesBetterTrees) {
  BvhConfig paper;
  paper.intersect_cost = 1.0f;
  paper.max_leaf_size = 4;
  BvhConfig paper_all_axes = paper;
  paper_all_axes.all_axes = true;
  for (uint32_t seed = 1; seed <= 12; ++seed) {
    SCOPED_TRACE(seed);
    const Mesh mesh = test::triangle_soup(500 * seed, seed % 2 == 0 ? 0.02f : 0.2f, seed);
    const auto cost = [&](const BvhConfig& config) {
      return *build_bvh(mesh, config).stats.sah_cost;
    };
    EXPECT_LT(cost(paper_all_axes), cost(paper));
    EXPECT_LE(cost(swept_bvh()), cost(tuned_bvh()));
    EXPECT_LT(cost(tuned_bvh()), cost(paper));
  }
}

// ---------------------------------------------------------------------------- depth

TEST(Bvh, EqualTrianglesMakeABalancedTree) {
  Mesh mesh = test::triangle_soup(1, 1.0f, 5);
  mesh.triangles.resize(10'000, mesh.triangles[0]);
  for (const auto& [name, config] : configs()) {
    SCOPED_TRACE(name);
    const Built built = build_bvh(mesh, config);
    EXPECT_LE(built.blob.max_depth, 14u);  // ceil(log2(10,000))
    EXPECT_THAT(validate(built.blob, mesh), IsEmpty());
  }
}

TEST(Bvh, WithoutAreasTheTreeIsBalanced) {
  // Areas of 1e-50 are 0 in float: no split is cheaper than another.
  const Mesh mesh = test::transformed(test::triangle_soup(5000, 0.1f, 31), 1e-25f, glm::vec3(0.0f));
  for (const auto& [name, config] : configs()) {
    SCOPED_TRACE(name);
    const Built built = build_bvh(mesh, config);
    EXPECT_FALSE(built.stats.sah_cost);
    EXPECT_LE(built.blob.max_depth, 13u);
    EXPECT_THAT(validate(built.blob, mesh), IsEmpty());
  }
}

TEST(Bvh, NoPathOutgrowsTheKernelsStack) {
  // Along each axis triangles at 1, 1/2, 1/4, ..., and ever smaller: with two buckets each split
  // cuts off only the outermost ones, along one axis after the other.
  Mesh mesh;
  for (uint32_t i = 0; i < 9000; ++i) {
    const float place = std::exp2(-static_cast<float>(i / 3 % 60));
    glm::vec3 corner(0.0f);
    corner[static_cast<int>(i % 3)] = place;
    const glm::vec3 small(0.1f * place);
    mesh.positions.insert(mesh.positions.end(),
                          {corner, corner + small, corner + small * glm::vec3(1, -1, 1)});
    mesh.triangles.emplace_back(3 * i, 3 * i + 1, 3 * i + 2);
  }
  uint32_t deepest = 0;
  std::vector<NamedConfig> all = configs();
  all.push_back({"two buckets", {}});
  all.back().config.bucket_count = 2;
  for (const auto& [name, config] : all) {
    SCOPED_TRACE(name);
    const Built built = build_bvh(mesh, config);
    EXPECT_LE(built.blob.max_depth, max_bvh_depth);
    EXPECT_THAT(validate(built.blob, mesh), IsEmpty());
    deepest = std::max(deepest, built.blob.max_depth);
  }
  EXPECT_GT(deepest, 60u) << "the mesh is not as bad as it should be";
}

// ---------------------------------------------------------------------------- threads

TEST(Bvh, ThreadsDoNotChangeABit) {
  // Large enough for passes that are shared among threads.
  const Mesh mesh = test::triangle_soup(150'000, 0.01f, 37);
  for (const BvhConfig& config : {BvhConfig{}, tuned_bvh(), swept_bvh()})
    for (const AccelKind layout : layouts) {
      if (config.method == BvhConfig::Method::sweep && layout != layouts[1]) continue;
      const auto build = [&](size_t thread_count) {
        const oneapi::tbb::global_control threads(
            oneapi::tbb::global_control::max_allowed_parallelism, thread_count);
        return build_bvh(mesh, config, layout);
      };
      const Built one = build(1);
      const Built four = build(4);
      EXPECT_TRUE(one.blob.nodes == four.blob.nodes);
      EXPECT_TRUE(one.blob.refs == four.blob.refs);
      EXPECT_EQ(one.stats.sah_cost, four.stats.sah_cost);
      EXPECT_THAT(validate(four.blob, mesh), IsEmpty());
    }
}

// ---------------------------------------------------------------------------- refusals

TEST(Bvh, RefusesParametersItCannotUse) {
  const Mesh mesh = make_teapot(2);
  const auto message = [&](auto change) -> std::string {
    BvhConfig config;
    change(config);
    try {
      build_bvh(mesh, config);
    } catch (const std::runtime_error& error) {
      return error.what();
    }
    return "nothing was thrown";
  };
  EXPECT_EQ(message([](BvhConfig& c) { c.bucket_count = 1; }),
            "cannot build a BVH with bucket_count 1: expected 2 to 64.");
  EXPECT_THAT(message([](BvhConfig& c) { c.bucket_count = 65; }), HasSubstr("bucket_count 65"));
  EXPECT_THAT(message([](BvhConfig& c) { c.max_leaf_size = 0; }), HasSubstr("max_leaf_size 0"));
  EXPECT_THAT(message([](BvhConfig& c) { c.max_leaf_size = 17; }), HasSubstr("expected 1 to 16"));
  EXPECT_THAT(message([](BvhConfig& c) { c.traverse_cost = -1.0f; }),
              HasSubstr("traverse_cost -1"));
  EXPECT_THAT(message([](BvhConfig& c) { c.intersect_cost = std::nanf(""); }),
              HasSubstr("intersect_cost nan"));
  EXPECT_THAT(message([](BvhConfig& c) { c.middle_split_count = -1; }),
              HasSubstr("middle_split_count -1"));
  EXPECT_THROW(build_bvh(mesh, {}, AccelKind::grid), std::runtime_error);
}

TEST(Bvh, RefusesAMeshWhoseAreaIsMoreThanAFloat) {
  for (const float scale : {1e25f, 3e38f}) {
    const Mesh mesh = test::transformed(make_teapot(2), scale / 4.0f, glm::vec3(0.0f));
    EXPECT_THROW(build_bvh(mesh), std::runtime_error);
  }
}

// ---------------------------------------------------------------------------- validate()

class BrokenBvh : public testing::TestWithParam<AccelKind> {
 protected:
  gpu::BvhNode& node(size_t index) {
    return reinterpret_cast<gpu::BvhNode*>(blob_.nodes.data())[index];
  }
  void set_word(size_t index, int32_t word) { node(index).min_link.w = std::bit_cast<float>(word); }
  void set_link(size_t index, uint32_t link) {
    node(index).max_link.w = std::bit_cast<float>(link);
  }
  /// The first node at or behind `index` that is a leaf, or is not.
  size_t find(bool leaf, size_t index = 0) {
    while ((word_of(node(index)) >= 0) != leaf) ++index;
    return index;
  }
  /// Compares with what validate() says, and repairs.
  void expect(const char* words) {
    EXPECT_THAT(validate(blob_, mesh_), Contains(HasSubstr(words)));
    blob_ = sound_;
    mesh_ = make_teapot(2);
  }
  void start_with(const AccelBlob& blob) {
    sound_ = blob;
    blob_ = blob;
    ASSERT_THAT(validate(blob_, mesh_), IsEmpty());
  }
  /// Defects that every layout and every leaf may have.
  void check_common_defects() {
    const auto node_count = static_cast<uint32_t>(node_count_of(blob_));
    blob_.nodes.resize(blob_.nodes.size() - 1);
    expect("not a multiple of 32");
    blob_.nodes.resize(blob_.nodes.size() - 32);
    expect("nodes for");
    blob_.nodes.clear();
    expect("0 nodes for");
    set_word(0, -5);
    expect("node 0: axis 4 is not 0, 1 or 2");
    set_word(0, std::numeric_limits<int32_t>::min());
    expect("is not 0, 1 or 2");
    node(1).max_link.x = 1e9f;
    expect("node 1 reaches out of its parent 0 on axis 0");
    node(0).min_link.x = std::nanf("");
    expect("node 0: box [nan");
    node(0).max_link.z = std::numeric_limits<float>::infinity();
    expect("inf] on axis 2");
    std::swap(node(0).min_link.y, node(0).max_link.y);
    expect("] on axis 1");
    node(find(true)).max_link.x = node(find(true)).min_link.x;
    expect("reaches out of its box on axis 0");
    set_word(1, word_of(node(find(true))));
    set_link(1, link_of(node(find(true))));
    expect("cannot be reached from the root");
    blob_.max_depth += 1;
    expect("the longest path has");
    blob_.bounds_max.x += 1.0f;
    expect("the root's box is not the blob's bounds");
    mesh_.positions[mesh_.triangles[0].x] += 100.0f;
    expect("reaches out of its box");
    mesh_.triangles.push_back(mesh_.triangles[0]);
    expect(blob_.refs.empty() ? "nodes for" : "refs for");

    // Links.
    if (GetParam() == AccelKind::bvh_miss_links) {
      const size_t left = find(false, 1);
      set_link(left, node_count + 7);
      expect("is not in (");
      set_link(0, node_count - 1);
      expect("node 0: a miss goes on at");
      set_link(find(false, 1), link_of(node(find(false, 1))) - 1);
      expect("but its subtree ends at");
    } else {
      for (const uint32_t link : {node_count, 0u, std::numeric_limits<uint32_t>::max()}) {
        set_link(0, link);
        expect("is not in (0, ");
      }
      const size_t inner = find(false, 1);
      set_link(inner, static_cast<uint32_t>(inner));
      expect("is not in (");
    }
  }

  Mesh mesh_ = make_teapot(2);
  AccelBlob sound_;
  AccelBlob blob_;
};

TEST_P(BrokenBvh, EachDefectIsNamed) {
  start_with(build_bvh(mesh_, {}, GetParam()).blob);
  check_common_defects();
  set_word(find(true), 100'000);
  expect("triangle 100000 of");
  set_link(find(true), 2);
  expect("2 triangles, but there are no refs");
  const size_t leaf = find(true);
  set_word(leaf, word_of(node(find(true, leaf + 1))));
  expect("is in more than one leaf");
  set_word(leaf, word_of(node(find(true, leaf + 1))));
  expect("is in no leaf");
}

TEST_P(BrokenBvh, EachDefectOfLeavesWithListsIsNamed) {
  BvhConfig config = tuned_bvh();
  config.max_leaf_size = 8;
  config.traverse_cost = 4.0f;  // so that there are leaves of several
  start_with(build_bvh(mesh_, config, GetParam()).blob);
  check_common_defects();
  ASSERT_GT(mesh_.triangles.size(), (node_count_of(blob_) + 1) / 2);
  blob_.refs.pop_back();
  expect("refs for");
  blob_.refs[0] = 100'000;
  expect("triangle 100000 of");
  blob_.refs[0] = blob_.refs[1];
  expect("is in more than one leaf");
  blob_.refs[0] = blob_.refs[1];
  expect("is in no leaf");
  set_link(find(true), 0);
  expect("no triangles");
  set_link(find(true), std::numeric_limits<uint32_t>::max());
  expect("refs [");
  set_word(find(true), 1 << 30);
  expect("refs [");
  for (size_t i = 0; i < node_count_of(blob_); ++i) {
    for (int axis = 0; axis < 3; ++axis) {
      node(i).min_link[axis] = blob_.bounds_min[axis];
      node(i).max_link[axis] = blob_.bounds_max[axis];
    }
    if (word_of(node(i)) < 0) continue;
    set_word(i, 0);
    set_link(i, static_cast<uint32_t>(blob_.refs.size()));
  }
  expect("the leaves up to here list");
}

TEST_P(BrokenBvh, LongListsAreCut) {
  start_with(build_bvh(mesh_, {}, GetParam()).blob);
  for (size_t i = 0; i < node_count_of(blob_); ++i) node(i).min_link.x = std::nanf("");
  const auto violations = validate(blob_, mesh_);
  EXPECT_EQ(violations.size(), 21u);
  EXPECT_THAT(violations.back(), HasSubstr("violations in all"));
}

TEST_P(BrokenBvh, GarbageIsReadWithinBounds) {
  // Says something, and neither crashes nor runs for ever; the sanitizers look for the rest.
  for (uint32_t seed = 1; seed <= 200; ++seed) {
    SCOPED_TRACE(seed);
    std::mt19937 random(seed);
    start_with(build_bvh(mesh_, seed % 2 == 0 ? BvhConfig{} : tuned_bvh(), GetParam()).blob);
    if (seed % 4 < 2) {
      for (std::byte& byte : blob_.nodes) byte = static_cast<std::byte>(random());
    } else {  // sound but for some words, so that the damage lies deeper
      for (int i = 0; i < 5; ++i) {
        const size_t index = random() % node_count_of(blob_);
        const auto value = static_cast<uint32_t>(random() % (2 * node_count_of(blob_)));
        if (random() % 2 == 0) {
          set_link(index, value ^ 1u);
        } else {
          set_word(index, static_cast<int32_t>(value) - 5);
        }
      }
    }
    if (blob_.nodes == sound_.nodes) continue;
    // Another split axis is no defect.
    EXPECT_THAT(validate(blob_, mesh_), testing::Not(IsEmpty()));
  }
}

TEST_P(BrokenBvh, AnEmptyMeshHasNoNodes) {
  mesh_ = {};
  blob_ = build_bvh(mesh_, {}, GetParam()).blob;
  EXPECT_THAT(validate(blob_, mesh_), IsEmpty());
  blob_.nodes.resize(32);
  EXPECT_THAT(validate(blob_, mesh_), Contains(HasSubstr("1 nodes for 0 triangles; expected 0")));
}

INSTANTIATE_TEST_SUITE_P(Bvh, BrokenBvh, testing::ValuesIn(layouts),
                         [](const auto& test) { return std::string(algorithm_for(test.param)); });

TEST(BrokenBvhOrder, BreadthFirstPairsMustBeInOrder) {
  const Mesh mesh = make_teapot(2);
  AccelBlob blob = build_bvh(mesh, {}, AccelKind::bvh_breadth_first).blob;
  auto* nodes = reinterpret_cast<gpu::BvhNode*>(blob.nodes.data());
  // The same tree with two pairs of leaves in each other's place.
  std::vector<size_t> parents;
  for (size_t i = 0; i < node_count_of(blob); ++i)
    if (word_of(nodes[i]) < 0 && word_of(nodes[link_of(nodes[i])]) >= 0 &&
        word_of(nodes[link_of(nodes[i]) + 1]) >= 0)
      parents.push_back(i);
  ASSERT_GE(parents.size(), 2u);
  gpu::BvhNode& a = nodes[parents.front()];
  gpu::BvhNode& b = nodes[parents[1]];
  for (uint32_t k = 0; k < 2; ++k) std::swap(nodes[link_of(a) + k], nodes[link_of(b) + k]);
  std::swap(a.max_link.w, b.max_link.w);
  EXPECT_THAT(validate(blob, mesh), Each(HasSubstr("in breadth-first order they are at")));
  EXPECT_EQ(validate(blob, mesh).size(), 2u);
}

}  // namespace
}  // namespace energyprof::accel
