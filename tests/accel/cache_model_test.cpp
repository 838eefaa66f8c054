// The cache model: closed-form patterns, and what must hold on traced frames.
#include "accel/cache_model.h"

#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>
#include <rapidcheck.h>
#include <rapidcheck/gtest.h>

#include <algorithm>
#include <array>
#include <limits>
#include <set>
#include <string_view>
#include <utility>
#include <vector>

#include "accel/bvh.h"
#include "accel/gpu_triangles.h"
#include "accel/grid.h"
#include "tests/accel/scenes.h"

namespace energyprof::accel {
namespace {

int64_t misses(CacheLevel& cache, const std::vector<uint32_t>& lines) {
  return std::ranges::count_if(lines, [&](uint32_t line) { return !cache.touch(line); });
}

TEST(CacheLevel, LinesOfASequenceMissOnceEach) {
  CacheLevel cache({4096, 4, 64});
  std::vector<uint32_t> lines;
  for (uint32_t line = 0; line < 64; ++line) lines.insert(lines.end(), 3, line);
  EXPECT_EQ(misses(cache, lines), 64);
  EXPECT_EQ(misses(cache, lines), 0);  // 4096 bytes are just these 64 lines
}

TEST(CacheLevel, OneLineMoreThanWaysInASetAlwaysMissesAndAsManyAsWaysHit) {
  // 16 sets: lines 16 apart share one. Least recently used is the worst choice for a cycle.
  for (const uint32_t ways : {1u, 2u, 4u, 12u}) {
    SCOPED_TRACE(ways);
    for (const uint32_t cycle : {ways, ways + 1}) {
      CacheLevel cache({uint64_t{16} * ways * 64, ways, 64});
      std::vector<uint32_t> lines;
      for (uint32_t i = 0; i < 10 * cycle; ++i) lines.push_back(5 + 16 * (i % cycle));
      EXPECT_EQ(misses(cache, lines), cycle == ways ? ways : 10 * cycle);
    }
  }
}

TEST(CacheLevel, SetsDoNotDisturbEachOther) {
  CacheLevel cache({2 * 64, 1, 64});  // two sets of one line: even and odd
  EXPECT_EQ(misses(cache, {0, 1, 0, 1, 2, 1, 2, 0, 1}), 4);
}

TEST(CacheLevel, TheLeastRecentlyUsedLineGoes) {
  CacheLevel cache({3 * 64, 3, 64});
  EXPECT_EQ(misses(cache, {1, 2, 3}), 3);
  EXPECT_EQ(misses(cache, {1, 4}), 1);  // 2 goes
  EXPECT_EQ(misses(cache, {1, 3, 4}), 0);
  EXPECT_EQ(misses(cache, {2}), 1);  // 1 goes
  EXPECT_EQ(misses(cache, {3, 4, 2}), 0);
  EXPECT_EQ(misses(cache, {1}), 1);
}

TEST(CacheLevel, SizesThatAreNotPowersOfTwoAreRoundedDownToSets) {
  CacheLevel cache({3 * 2 * 64 + 63, 2, 64});  // three sets: lines 3 apart share one
  EXPECT_EQ(misses(cache, {0, 3, 0, 3}), 2);
  EXPECT_EQ(misses(cache, {6, 0, 3, 6}), 4);
  EXPECT_EQ(misses(cache, {1, 2, 4, 5, 1, 2, 4, 5}), 4);
}

TEST(CacheLevel, RefusesGeometriesWithoutSets) {
  EXPECT_THROW(CacheLevel({0, 1, 64}), std::runtime_error);
  EXPECT_THROW(CacheLevel({4096, 0, 64}), std::runtime_error);
  EXPECT_THROW(CacheLevel({4096, 65, 64}), std::runtime_error);
  EXPECT_THROW(CacheLevel({4096, 4, 48}), std::runtime_error);
  EXPECT_THROW(CacheLevel({4096, 4, 0}), std::runtime_error);
  EXPECT_THROW(CacheLevel({uint64_t{1} << 60, 4, 64}), std::runtime_error);
}

// A fully associative cache holds what a smaller one holds: "Evaluation Techniques for Storage
// Hierarchies", R. L. Mattson, J. Gecsei, D. R. Slutz and I. L. Traiger, IBM Systems Journal 9(2),
// 1970.
RC_GTEST_PROP(CacheLevel, ALargerFullyAssociativeCacheHitsWheneverASmallerOneDoes, ()) {
  const auto small = *rc::gen::inRange<uint32_t>(1, 20);
  const auto large = *rc::gen::inRange<uint32_t>(small, 40);
  const auto lines = *rc::gen::container<std::vector<uint32_t>>(rc::gen::inRange<uint32_t>(0, 50));
  CacheLevel small_cache({uint64_t{small} * 64, small, 64});
  CacheLevel large_cache({uint64_t{large} * 64, large, 64});
  for (const uint32_t line : lines) {
    const bool hits_small = small_cache.touch(line);
    const bool hits_large = large_cache.touch(line);
    RC_ASSERT(!hits_small || hits_large);
  }
}

class CacheModel : public testing::Test {
 protected:
  CacheModelResult model(const CacheModelConfig& config) const {
    return model_cache("GRID", scene, camera, config);
  }

  Mesh mesh = make_teapot();
  std::vector<gpu::Triangle> triangles = gpu_triangles(mesh);
  AccelBlob blob = build_grid(mesh).blob;
  CpuScene scene{blob, triangles};
  gpu::FrameConstants camera = test::camera_for(mesh, 160, 120);
};

TEST_F(CacheModel, CountsTheFramesPixelsRaysAndReads) {
  const CacheModelResult result = model({});
  EXPECT_EQ(result.pixel_count, 160 * 120);
  const FrameSums sums = sum_hits(trace_cpu("GRID", scene, camera).hits);
  EXPECT_EQ(result.ray_count, sums.ray_count);
  int64_t read_count = 0;
  for (uint32_t y = 0; y < camera.height; ++y)
    for (uint32_t x = 0; x < camera.width; ++x) {
      const PixelReads reads = record_reads("GRID", scene, camera, x, y);
      read_count += static_cast<int64_t>(reads.primary.size() + reads.bounce.size());
    }
  EXPECT_EQ(result.read_count, read_count);
  EXPECT_LT(result.access_count, result.read_count);
  EXPECT_LT(result.l1_miss_count, result.access_count);
  EXPECT_LT(result.llc_miss_count, result.l1_miss_count);
  EXPECT_DOUBLE_EQ(result.l1_misses_per_ray, static_cast<double>(result.l1_miss_count) /
                                                 static_cast<double>(result.ray_count));
}

TEST_F(CacheModel, WhereEverythingFitsEachLineMissesOnce) {
  const CacheGeometry large{64 << 20, 16, 64};
  const CacheModelResult result = model({.l1 = large, .llc = large});
  EXPECT_EQ(64 * result.l1_miss_count, result.footprint_bytes);
  EXPECT_EQ(64 * result.llc_miss_count, result.footprint_bytes);
}

TEST_F(CacheModel, OneLaneAsksForWhatItsRaysRead) {
  // Nodes, refs and triangles begin at multiples of 4096; no coalescing but within a step.
  camera = test::camera_for(mesh, 24, 18);
  const auto aligned = [](size_t bytes) { return (bytes + 4095) / 4096 * 4096; };
  const size_t refs_begin = aligned(blob.nodes.size());
  const std::array<size_t, 3> begins{0, refs_begin, refs_begin + aligned(blob.refs.size() * 4)};
  std::set<uint64_t> all;
  size_t pixel_line_count = 0;
  int64_t access_count = 0;
  for (uint32_t y = 0; y < camera.height; ++y)
    for (uint32_t x = 0; x < camera.width; ++x) {
      std::set<uint64_t> of_pixel;
      const PixelReads reads = record_reads("GRID", scene, camera, x, y);
      for (const auto& ray : {reads.primary, reads.bounce}) {
        std::set<std::pair<uint32_t, uint64_t>> of_step;
        for (const MemoryRead& read : ray) {
          const uint64_t address = begins[static_cast<size_t>(read.buffer)] + read.offset;
          for (uint64_t line = address / 64; line <= (address + read.size - 1) / 64; ++line) {
            of_step.emplace(read.step, line);
            of_pixel.insert(line);
          }
        }
        access_count += static_cast<int64_t>(of_step.size());
      }
      all.insert(of_pixel.begin(), of_pixel.end());
      pixel_line_count += of_pixel.size();
    }
  const CacheModelResult result = model({.lanes = 1});
  EXPECT_EQ(result.access_count, access_count);
  EXPECT_EQ(result.footprint_bytes, static_cast<int64_t>(64 * all.size()));
  EXPECT_DOUBLE_EQ(result.bytes_per_pixel,
                   64.0 * static_cast<double>(pixel_line_count) / (24.0 * 18.0));
  // More lanes share more; what they touch stays the same.
  const CacheModelResult shared = model({.lanes = 16});
  EXPECT_LT(shared.access_count, result.access_count);
  EXPECT_EQ(shared.read_count, result.read_count);
  EXPECT_EQ(shared.footprint_bytes, result.footprint_bytes);
  EXPECT_EQ(shared.bytes_per_pixel, result.bytes_per_pixel);
}

TEST_F(CacheModel, RaysInLockstepAreOneAccess) {
  // All rays are the same: a subgroup of 8 asks for what a subgroup of 1 asks for.
  camera.width = 8;
  camera.height = 8;
  camera.right_tmax = glm::vec4(0, 0, 0, camera.right_tmax.w);
  camera.up = glm::vec4(0);
  camera.bounce_count = 0;
  const CacheModelResult one = model({.lanes = 1});
  const CacheModelResult eight = model({.lanes = 8});
  ASSERT_GT(one.access_count, 0);
  EXPECT_EQ(one.access_count, 8 * eight.access_count);
  EXPECT_EQ(one.l1_miss_count, eight.l1_miss_count);
}

TEST_F(CacheModel, ALargerFullyAssociativeL1NeverMissesMore) {
  int64_t before = std::numeric_limits<int64_t>::max();
  for (const uint32_t lines : {16u, 32u, 48u, 96u, 192u}) {
    const CacheModelResult result = model({.l1 = {uint64_t{lines} * 64, lines, 64}});
    EXPECT_LE(result.l1_miss_count, before);
    EXPECT_GE(64 * result.l1_miss_count, result.footprint_bytes);
    before = result.l1_miss_count;
  }
}

TEST_F(CacheModel, LongerLinesBehindL1AreFewer) {
  const CacheModelResult result = model({.llc = {64 << 20, 16, 128}});
  EXPECT_LT(128 * result.llc_miss_count, 2 * result.footprint_bytes);
  EXPECT_GE(128 * result.llc_miss_count, result.footprint_bytes);
}

TEST_F(CacheModel, ASampleIsCloseToTheWholeFrame) {
  camera = test::camera_for(mesh, 400, 300);
  const AccelBlob bvh = build_bvh(mesh).blob;
  const std::array<std::pair<std::string_view, const AccelBlob*>, 2> structures{
      {{"GRID", &blob}, {"BVH_FTB_DF", &bvh}}};
  for (const auto& [algorithm, structure] : structures) {
    SCOPED_TRACE(algorithm);
    const CpuScene traced{*structure, triangles};
    const CacheGeometry small_l1{8 << 10, 8, 64};
    const CacheModelResult whole =
        model_cache(algorithm, traced, camera, {.l1 = small_l1, .max_pixel_count = 400 * 300});
    const CacheModelResult sample =
        model_cache(algorithm, traced, camera, {.l1 = small_l1, .max_pixel_count = 40'000});
    EXPECT_EQ(whole.pixel_count, 400 * 300);
    EXPECT_LE(sample.pixel_count, 40'000);
    EXPECT_GE(sample.pixel_count, 25'000);  // a quarter of each run is not counted
    EXPECT_NEAR(sample.l1_misses_per_ray / whole.l1_misses_per_ray, 1.0, 0.1);
    EXPECT_NEAR(sample.bytes_per_pixel / whole.bytes_per_pixel, 1.0, 0.1);
  }
}

TEST_F(CacheModel, FramesThatDoNotFillTheirWorkgroupsAreCountedWhole) {
  camera = test::camera_for(mesh, 13, 11);
  for (const CacheModelConfig& config :
       {CacheModelConfig{}, CacheModelConfig{.group_x = 5, .group_y = 3, .lanes = 4},
        CacheModelConfig{.group_x = 64, .group_y = 1, .lanes = 64}}) {
    EXPECT_EQ(model(config).pixel_count, 13 * 11);
  }
  EXPECT_GT(model({.max_pixel_count = 1}).pixel_count, 0);
}

TEST_F(CacheModel, OneAndTwoThreadsGiveTheSame) {
  const auto with_threads = [&](size_t count) {
    const oneapi::tbb::global_control limit(oneapi::tbb::global_control::max_allowed_parallelism,
                                            count);
    return model({});
  };
  const CacheModelResult one = with_threads(1);
  const CacheModelResult two = with_threads(2);
  EXPECT_EQ(one.access_count, two.access_count);
  EXPECT_EQ(one.l1_miss_count, two.l1_miss_count);
  EXPECT_EQ(one.llc_miss_count, two.llc_miss_count);
  EXPECT_EQ(one.footprint_bytes, two.footprint_bytes);
}

TEST_F(CacheModel, NothingToHitIsNoMiss) {
  const AccelBlob empty = build_grid({}).blob;
  const CacheModelResult result = model_cache("GRID", {empty, {}}, camera);
  EXPECT_EQ(result.ray_count, 160 * 120);
  EXPECT_EQ(result.access_count, 0);
  EXPECT_EQ(result.l1_misses_per_ray, 0.0);
  EXPECT_EQ(result.footprint_bytes, 0);
}

TEST_F(CacheModel, RefusesWhatItCannotModel) {
  EXPECT_THROW(model({.group_x = 0}), std::runtime_error);
  EXPECT_THROW(model({.lanes = 0}), std::runtime_error);
  EXPECT_THROW(model({.l1 = {48 << 10, 12, 0}}), std::runtime_error);
  EXPECT_THROW(model({.l1 = {48 << 10, 12, 128}}), std::runtime_error);
  EXPECT_THROW(model({.llc = {0, 16, 64}}), std::runtime_error);
  EXPECT_THROW(model_cache("NO_SUCH", scene, camera), std::runtime_error);
  EXPECT_THROW(model_cache("BVH_FTB_DF", scene, camera), std::runtime_error);
}

}  // namespace
}  // namespace energyprof::accel
