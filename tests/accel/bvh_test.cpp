// The BVH: structure, cost, and the closest hits that brute force finds.
#include "accel/bvh.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <bit>

#include "accel/trace_cpu.h"
#include "accel/validate.h"
#include "core/gpu_layout.h"
#include "tests/accel/scenes.h"

namespace energyprof::accel {
namespace {

using testing::Contains;
using testing::HasSubstr;
using testing::IsEmpty;

class UglyScenes : public testing::TestWithParam<test::NamedMesh> {};

TEST_P(UglyScenes, GiveASoundTree) {
  const Mesh& mesh = GetParam().mesh;
  const Built built = build_bvh(mesh);
  EXPECT_THAT(validate(built.blob), IsEmpty());
  const auto triangle_count = static_cast<int64_t>(mesh.triangles.size());
  EXPECT_EQ(built.stats.leaf_count, triangle_count);
  EXPECT_EQ(built.stats.node_count, triangle_count == 0 ? 0 : 2 * triangle_count - 1);
  EXPECT_EQ(built.stats.blob_bytes, static_cast<int64_t>(built.blob.byte_count()));
}

TEST_P(UglyScenes, TraversalFindsWhatBruteForceFinds) {
  const Built built = build_bvh(GetParam().mesh);
  const gpu::FrameConstants camera = test::camera_for(GetParam().mesh, 64, 48);
  const CpuFrame expected = trace_cpu(built.blob, camera, CpuMethod::brute_force);
  const CpuFrame found = trace_cpu(built.blob, camera, CpuMethod::traverse);
  EXPECT_EQ(test::different_pixels(expected.hits, found.hits), 0u);
  EXPECT_EQ(sum_hits(expected.hits).hit_checksum, sum_hits(found.hits).hit_checksum);
  if (GetParam().name != "nothing") {
    EXPECT_GT(sum_hits(found.hits).hit_count, 0);
  }
}

INSTANTIATE_TEST_SUITE_P(Bvh, UglyScenes, testing::ValuesIn(test::ugly_scenes()),
                         [](const auto& test) {
                           std::string name = test.param.name;
                           std::replace(name.begin(), name.end(), ' ', '_');
                           return name;
                         });

TEST(Bvh, FramesAndSeedsDrawOtherRays) {
  const Built built = build_bvh(make_teapot());
  gpu::FrameConstants camera = test::camera_for(make_teapot(), 64, 48);
  const auto checksum = [&] {
    return sum_hits(trace_cpu(built.blob, camera, CpuMethod::traverse).hits).hit_checksum;
  };
  const std::string first = checksum();
  EXPECT_EQ(checksum(), first);
  camera.frame = 1;
  const std::string second = checksum();
  EXPECT_NE(second, first);
  camera.seed = 99;
  EXPECT_NE(checksum(), second);
}

TEST(Bvh, SahCostOfTwoTrianglesIsKnown) {
  // Two right triangles with unit legs in the planes z = 0 and z = 1: each leaf box is a unit
  // square (half area 1), the root a unit cube (half area 3). Cost: C_trav + C_isect (1 + 1) / 3.
  Mesh mesh;
  for (const float z : {0.0f, 1.0f}) {
    const auto base = static_cast<uint32_t>(mesh.positions.size());
    mesh.positions.insert(mesh.positions.end(), {{0, 0, z}, {1, 0, z}, {0, 1, z}});
    mesh.triangles.emplace_back(base, base + 1, base + 2);
  }
  const Built built = build_bvh(mesh);
  ASSERT_TRUE(built.stats.sah_cost);
  EXPECT_NEAR(*built.stats.sah_cost, 1.0 + 2.0 * 2.0 / 3.0, 1e-5);
  EXPECT_EQ(built.stats.max_depth, 1);
}

TEST(Bvh, SahCutsTheCostOfAMiddleSplit) {
  const Mesh mesh = test::triangle_soup(5000, 0.02f, 29);
  BvhConfig middle;
  middle.middle_split_count = 1 << 20;
  EXPECT_LT(*build_bvh(mesh).stats.sah_cost, *build_bvh(mesh, middle).stats.sah_cost);
}

TEST(Bvh, RefusesABucketCountThatItCannotUse) {
  BvhConfig config;
  config.bucket_count = 1;
  EXPECT_THROW(build_bvh(make_teapot(), config), std::runtime_error);
}

// ---------------------------------------------------------------------------- validate()

class Broken : public testing::Test {
 protected:
  Broken() : blob_(build_bvh(make_teapot(2)).blob) {}
  gpu::BvhNode& node(size_t index) {
    return reinterpret_cast<gpu::BvhNode*>(blob_.nodes.data())[index];
  }
  size_t first_leaf() {
    size_t i = 0;
    while (std::bit_cast<int32_t>(node(i).min_link.w) < 0) ++i;
    return i;
  }
  AccelBlob blob_;
};

TEST_F(Broken, EachDefectIsNamed) {
  ASSERT_THAT(validate(blob_), IsEmpty());
  const AccelBlob sound = blob_;
  const auto expect = [&](const char* words) {
    EXPECT_THAT(validate(blob_), Contains(HasSubstr(words)));
    blob_ = sound;
  };
  blob_.nodes.resize(blob_.nodes.size() - 1);
  expect("not a multiple of 32");
  blob_.triangles.resize(blob_.triangles.size() - 48);
  expect("nodes for");
  node(0).max_link.w = std::bit_cast<float>(int32_t{1 << 20});
  expect("child 1048576 is not in");
  node(0).max_link.w = std::bit_cast<float>(int32_t{0});
  expect("child 0 is not in");
  node(0).max_link.w = std::bit_cast<float>(int32_t{1});
  expect("node 1 is reached more than once");
  node(0).min_link.w = std::bit_cast<float>(int32_t{-5});
  expect("axis 4 is not 0, 1 or 2");
  node(1).max_link.x = 1e9f;
  expect("reaches out of its parent");
  node(0).min_link.x = std::nanf("");
  expect("box [nan");
  node(first_leaf()).min_link.w = std::bit_cast<float>(int32_t{100'000});
  expect("triangle 100000 of");
  node(first_leaf()).max_link.x = node(first_leaf()).min_link.x;
  expect("reaches out of its box");
  blob_.max_depth = 1;
  expect("max_depth is 1");
  blob_.bounds_max.x += 1.0f;
  expect("the root's box is not the blob's bounds");
}

TEST_F(Broken, LongListsAreCut) {
  for (size_t i = 0; i < blob_.nodes.size() / 32; ++i) node(i).min_link.x = std::nanf("");
  const auto violations = validate(blob_);
  EXPECT_EQ(violations.size(), 21u);
  EXPECT_THAT(violations.back(), HasSubstr("violations in all"));
}

}  // namespace
}  // namespace energyprof::accel
