// Frames traced on the device against the same frames traced on the CPU.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cstdlib>

#include "core/clock.h"
#include "core/trace_math.h"
#include "kernels/kernel_list.h"
#include "kernels/runner.h"
#include "scene.h"

namespace energyprof::kernels {
namespace {

using testing::HasSubstr;

/// Ids must agree exactly on a CPU device, where both sides round alike; a GPU may divide less
/// exactly and see another triangle in one pixel of ten thousand.
void expect_same_hits(const DeviceInfo& info, const std::vector<gpu::PixelHits>& hits,
                      const ExpectedFrame& expected) {
  ASSERT_EQ(hits.size(), expected.hits.size());
  size_t different = 0;
  for (size_t i = 0; i < hits.size(); ++i) {
    different += hits[i].primary_id != expected.hits[i].primary_id ||
                 hits[i].bounce_id != expected.hits[i].bounce_id;
  }
  EXPECT_LE(different, info.type == "cpu" ? 0 : hits.size() / 10'000 + 1);
}

class Trace : public testing::Test {
 protected:
  void SetUp() override {
    if (const std::string reason = no_device_reason(); !reason.empty()) GTEST_SKIP() << reason;
    device_.emplace();
  }

  Device& device() { return **device_; }
  [[nodiscard]] bool is_cpu() { return device().info().type == "cpu"; }

  /// Traces one frame and checks everything about it.
  void check_frame(const Scene& scene, const gpu::FrameConstants& constants, uint32_t frame) {
    TraceProgram program(
        device(), {.blob = scene.blob, .triangles = scene.triangles, .constants = constants});
    const int64_t before_ns = now_ns();
    const FrameRecord record = program.run_frame(frame, Phase::timed);
    const int64_t after_ns = now_ns();
    const ExpectedFrame expected = trace_brute_force(scene, constants, frame);
    expect_same_hits(device().info(), program.read_hits(), expected);
    if (is_cpu()) {
      EXPECT_EQ(record.hit_checksum, expected.checksum);
      EXPECT_EQ(record.ray_count, expected.ray_count);
      EXPECT_EQ(record.hit_count, expected.hit_count);
    }
    EXPECT_EQ(record.frame, frame);
    EXPECT_EQ(record.phase, Phase::timed);
    EXPECT_FALSE(record.node_visit_count.has_value());
    ASSERT_TRUE(record.clock_error_ns.has_value());
    EXPECT_LE(before_ns, record.submit_ns);
    EXPECT_LE(record.submit_ns, record.begin_ns + *record.clock_error_ns);
    EXPECT_LT(record.begin_ns, record.end_ns);
    EXPECT_LE(record.end_ns - *record.clock_error_ns, after_ns);
  }

  template <typename Call>
  std::string error_of(Call&& call) {
    try {
      call();
    } catch (const std::runtime_error& error) {
      return error.what();
    }
    return "no error";
  }

  std::optional<ValidatedDevice> device_;
};

TEST_F(Trace, RunsWithTheSubgroupsThatWereAskedFor) {
  const char* width = std::getenv("LP_NATIVE_VECTOR_WIDTH");
  if (width == nullptr || !is_cpu()) GTEST_SKIP() << "LP_NATIVE_VECTOR_WIDTH asks for none";
  EXPECT_EQ(device().info().subgroup_size, std::stoul(width) / 32);
}

TEST_F(Trace, OneTriangleIsHitWhereItIs) {
  // It covers the lower left half of the image: x and y from -1 to 1, one unit away.
  const Scene scene = build_halves({{{-1, -1, 1}, {1, -1, 1}, {-1, 1, 1}}});
  gpu::FrameConstants constants = looking_at_cube(16, 16);
  constants.origin_tmin = gpu::vec4(0, 0, 0, 1e-4f);
  constants.right_tmax = gpu::vec4(1, 0, 0, 1e13f);
  constants.up = gpu::vec4(0, 1, 0, 0);
  constants.forward = gpu::vec4(0, 0, 1, 0);
  TraceProgram program(device(),
                       {.blob = scene.blob, .triangles = scene.triangles, .constants = constants});
  program.run_frame(0, Phase::timed);
  const auto hits = program.read_hits();
  for (uint32_t y = 0; y < 16; ++y) {
    for (uint32_t x = 0; x < 16; ++x) {
      if (x == y) continue;  // the edge runs through these pixels
      const gpu::PixelHits& seen = hits[y * 16 + x];
      EXPECT_EQ(seen.primary_id, x < y ? 1u : 0u) << x << "," << y;
      EXPECT_EQ(seen.bounce_id, x < y ? 0u : gpu::ray_absent) << x << "," << y;
    }
  }
  check_frame(scene, constants, 3);
}

TEST_F(Trace, RandomScenesAgreeWithBruteForce) {
  struct Case {
    uint32_t triangles, width, height, bounces;
  };
  uint32_t seed = 0;
  for (const Case& c : std::vector<Case>{{2, 8, 8, 1},
                                         {3, 1, 1, 1},
                                         {50, 67, 35, 1},
                                         {300, 33, 70, 1},
                                         {300, 40, 40, 0},
                                         {2000, 65, 9, 1},
                                         {40, 1, 129, 1},
                                         {40, 129, 1, 1}}) {
    SCOPED_TRACE(testing::Message() << "seed " << ++seed << ", " << c.triangles << " triangles, "
                                    << c.width << " x " << c.height);
    gpu::FrameConstants constants = looking_at_cube(c.width, c.height);
    constants.bounce_count = c.bounces;
    check_frame(build_halves(random_triangles(c.triangles, seed)), constants, seed);
  }
}

TEST_F(Trace, OfCoincidingTrianglesTheFirstIsHit) {
  std::vector<Corners> triangles = random_triangles(40, 11);
  const std::vector<Corners> copy = triangles;
  triangles.insert(triangles.begin(), copy.rbegin(), copy.rend());
  check_frame(build_halves(triangles), looking_at_cube(48, 48), 0);
}

TEST_F(Trace, AnEmptySceneIsNeverHit) {
  const Scene scene = build_halves({});
  check_frame(scene, looking_at_cube(20, 10), 0);
  TraceProgram program(
      device(),
      {.blob = scene.blob, .triangles = scene.triangles, .constants = looking_at_cube(20, 10)});
  const FrameRecord record = program.run_frame(0, Phase::counted);
  EXPECT_EQ(record.ray_count, 200);
  EXPECT_EQ(record.hit_count, 0);
  EXPECT_EQ(record.node_visit_count, 0);
}

TEST_F(Trace, FramesDifferAndRepeat) {
  const Scene scene = build_halves(random_triangles(200, 5));
  TraceProgram program(
      device(),
      {.blob = scene.blob, .triangles = scene.triangles, .constants = looking_at_cube(64, 64)});
  const std::string first = program.run_frame(0, Phase::warmup).hit_checksum;
  EXPECT_EQ(first.size(), 16u);
  EXPECT_NE(program.run_frame(1, Phase::timed).hit_checksum, first);
  EXPECT_EQ(program.run_frame(0, Phase::timed).hit_checksum, first);
  EXPECT_EQ(program.run_frame(0, Phase::counted).hit_checksum, first);
}

TEST_F(Trace, TilesGiveTheSameFrame) {
  const Scene scene = build_halves(random_triangles(200, 6));
  const gpu::FrameConstants constants = looking_at_cube(50, 61);
  const std::string expected = TraceProgram(device(), {.blob = scene.blob,
                                                       .triangles = scene.triangles,
                                                       .constants = constants,
                                                       .config = {.rows_per_dispatch = 61}})
                                   .run_frame(4, Phase::timed)
                                   .hit_checksum;
  // Fewer rows than a workgroup has are not possible.
  for (const auto& [rows, tiles] : std::vector<std::pair<uint32_t, int64_t>>{
           {1, 8}, {8, 8}, {13, 5}, {32, 2}, {60, 2}, {1000, 1}}) {
    SCOPED_TRACE(rows);
    TraceProgram program(device(), {.blob = scene.blob,
                                    .triangles = scene.triangles,
                                    .constants = constants,
                                    .config = {.rows_per_dispatch = rows}});
    for (int repeat = 0; repeat < 2; ++repeat) {
      const FrameRecord record = program.run_frame(4, Phase::timed);
      EXPECT_EQ(record.hit_checksum, expected);
      EXPECT_EQ(record.dispatch_count, tiles);
      EXPECT_LT(record.begin_ns, record.end_ns);
    }
  }
}

TEST_F(Trace, WorkgroupsOfAnyShapeGiveTheSameFrame) {
  const Scene scene = build_halves(random_triangles(200, 8));
  const gpu::FrameConstants constants = looking_at_cube(50, 61);
  const std::string expected =
      TraceProgram(device(),
                   {.blob = scene.blob, .triangles = scene.triangles, .constants = constants})
          .run_frame(0, Phase::timed)
          .hit_checksum;
  for (const auto& [x, y] : std::vector<std::pair<uint32_t, uint32_t>>{
           {16, 4}, {64, 1}, {1, 64}, {4, 4}, {1, 1}, {7, 9}}) {
    SCOPED_TRACE(testing::Message() << x << " x " << y);
    TraceProgram program(device(), {.blob = scene.blob,
                                    .triangles = scene.triangles,
                                    .constants = constants,
                                    .config = {.local_x = x, .local_y = y}});
    EXPECT_EQ(program.run_frame(0, Phase::timed).hit_checksum, expected);
  }
}

TEST_F(Trace, CountsAreThoseOfTheTraversal) {
  const Scene scene = build_halves(random_triangles(500, 9));
  const gpu::FrameConstants constants = looking_at_cube(60, 44);
  TraceProgram program(device(),
                       {.blob = scene.blob, .triangles = scene.triangles, .constants = constants});
  EXPECT_TRUE(program.read_hits().empty());
  program.run_frame(2, Phase::timed);
  EXPECT_TRUE(program.read_counts().empty());
  EXPECT_FALSE(program.work().has_value());

  const FrameRecord record = program.run_frame(2, Phase::counted);
  const FrameRecord again = program.run_frame(2, Phase::counted);
  EXPECT_EQ(record.node_visit_count, again.node_visit_count);
  EXPECT_EQ(record.box_test_count, again.box_test_count);
  EXPECT_EQ(record.prim_test_count, again.prim_test_count);

  const auto counts = program.read_counts();
  const ExpectedFrame expected = trace_tree(scene, constants, 2);
  ASSERT_EQ(counts.size(), expected.counts.size());
  int64_t node_visits = 0;
  int64_t box_tests = 0;
  int64_t prim_tests = 0;
  int64_t loop_steps = 0;
  size_t different = 0;
  for (size_t i = 0; i < counts.size(); ++i) {
    node_visits += counts[i].node_visits;
    box_tests += counts[i].box_tests;
    prim_tests += counts[i].prim_tests;
    loop_steps += counts[i].loop_steps;
    different += counts[i].node_visits != expected.counts[i].node_visits ||
                 counts[i].box_tests != expected.counts[i].box_tests ||
                 counts[i].prim_tests != expected.counts[i].prim_tests ||
                 counts[i].loop_steps != expected.counts[i].loop_steps;
  }
  EXPECT_LE(different, is_cpu() ? 0 : counts.size() / 100);
  EXPECT_EQ(record.node_visit_count, node_visits);
  EXPECT_EQ(record.box_test_count, box_tests);
  EXPECT_EQ(record.prim_test_count, prim_tests);
  EXPECT_EQ(record.loop_step_count, loop_steps);
  ASSERT_TRUE(program.work().has_value());
  EXPECT_EQ(program.work()->loop_steps, loop_steps);
  if (is_cpu()) {
    // There, a subgroup is as many consecutive threads of a workgroup.
    std::vector<gpu::PixelLanes> lanes(counts.size());
    for (uint32_t y = 0; y < constants.height; ++y)
      for (uint32_t x = 0; x < constants.width; ++x) {
        lanes[y * constants.width + x].subgroup =
            (y % 8 * 8 + x % 8) / device().info().subgroup_size;
      }
    const int64_t most_steps =
        sum_work(counts, lanes, {constants.width, constants.height, 8, 8, 44}).max_subgroup_steps;
    EXPECT_EQ(program.work()->max_subgroup_steps, most_steps);
  }
  EXPECT_GT(*record.simd_efficiency, 1.0 / device().info().subgroup_size);
  EXPECT_LT(*record.simd_efficiency, 1.0);
  EXPECT_GE(node_visits, *record.ray_count);
}

TEST_F(Trace, ADeepTreeHasAllTheStackItNeeds) {
  // 127 inner nodes in a row, each with its far child on the stack: the deepest there may be.
  const Scene scene = build_chain(random_triangles(max_stack_size, 10));
  ASSERT_EQ(scene.blob.max_depth + 1, max_stack_size);
  check_frame(scene, looking_at_cube(40, 40), 0);
}

TEST_F(Trace, ATreeTooDeepIsRefusedWithBothNumbers) {
  const Scene scene = build_chain(random_triangles(150, 10));
  const std::string error = error_of([&] {
    TraceProgram(
        device(),
        {.blob = scene.blob, .triangles = scene.triangles, .constants = looking_at_cube(8, 8)});
  });
  EXPECT_THAT(error, HasSubstr("needs a stack of 150 entries"));
  EXPECT_THAT(error, HasSubstr("at most 128"));
}

TEST_F(Trace, AnImageTooLargeIsRefusedWithBothNumbers) {
  const Scene scene = build_halves(random_triangles(4, 1));
  const uint64_t limit = device().info().max_storage_buffer_bytes;
  const auto height = static_cast<uint32_t>(limit / (8192 * sizeof(gpu::PixelHits)) + 1);
  const std::string error = error_of([&] {
    TraceProgram(device(), {.blob = scene.blob,
                            .triangles = scene.triangles,
                            .constants = looking_at_cube(8192, height)});
  });
  EXPECT_THAT(error, HasSubstr("no Vulkan device fits: '" + device().info().name +
                               "': maxStorageBufferRange is "));
  EXPECT_THAT(error, HasSubstr("the hit buffer needs "));
}

TEST_F(Trace, AnImageWiderThanADispatchIsRefused) {
  const Scene scene = build_halves(random_triangles(4, 1));
  const uint64_t width = uint64_t{device().info().max_workgroup_count_x} + 1;
  if (width > 100'000'000) GTEST_SKIP() << "this device has no such limit";
  const TraceSetup setup{.blob = scene.blob,
                         .triangles = scene.triangles,
                         .constants = looking_at_cube(static_cast<uint32_t>(width), 1),
                         .config = {.local_x = 1, .local_y = 1}};
  EXPECT_THAT(error_of([&] { TraceProgram(device(), setup); }), HasSubstr("workgroups, it allows"));
}

TEST_F(Trace, NonsenseIsRefused) {
  const Scene scene = build_halves(random_triangles(4, 1));
  EXPECT_THAT(error_of([&] {
                TraceProgram(device(), {.blob = scene.blob,
                                        .triangles = scene.triangles,
                                        .constants = looking_at_cube(0, 480)});
              }),
              HasSubstr("cannot trace an image of 0 x 480 pixels"));
  EXPECT_THAT(error_of([&] {
                TraceProgram(device(), {.blob = scene.blob,
                                        .triangles = scene.triangles,
                                        .constants = looking_at_cube(8, 8),
                                        .config = {.local_x = 1 << 16, .local_y = 1 << 16}});
              }),
              HasSubstr("cannot trace in workgroups of 65536 x 65536"));
  EXPECT_THAT(error_of([&] {
                TraceProgram(device(), {.blob = scene.blob,
                                        .triangles = scene.triangles,
                                        .kernel = "BHV",
                                        .constants = looking_at_cube(8, 8)});
              }),
              HasSubstr("cannot trace with 'BHV': there is no such kernel; expected BVH_FTB_DF"));
}

TEST_F(Trace, MoreLoopStepsThanACpuDeviceTakesAreNoticed) {
  if (!is_cpu()) GTEST_SKIP() << "only CPU devices end loops early";
  // Every ray enters the box of every triangle (they fill its lower left half) and misses it.
  const std::vector<Corners> triangles(20'000, Corners{{-9, -9, 1}, {9, -9, 1.5f}, {-9, 9, 2}});
  gpu::FrameConstants constants = looking_at_cube(8, 8);
  constants.origin_tmin = gpu::vec4(6, 6, -2, 1e-4f);
  const Scene scene = build_halves(triangles);
  TraceProgram program(device(),
                       {.blob = scene.blob, .triangles = scene.triangles, .constants = constants});
  EXPECT_THAT(error_of([&] { program.run_frame(0, Phase::counted); }),
              HasSubstr("a SIMD group took "));
}

TEST(Work, EfficiencyIsStepsOverTheSlowestLanesSteps) {
  // A 4 x 3 image in workgroups of 4 x 2, two subgroups each; the last row is a workgroup of its
  // own.
  //   primary steps: 1 2 3 4 | 2 2 2 2 | 6 0 0 0;   the first pixel's bounce ray takes 8 more.
  // Occupied: 4 (4 + 8) + 4 * 2 + 4 * 6 = 80; busy: 10 + 8 + 8 + 6 = 32.
  const std::vector<std::array<uint32_t, 3>> pixels{{9, 8, 0}, {2, 0, 0}, {3, 0, 0}, {4, 0, 0},
                                                    {2, 0, 1}, {2, 0, 1}, {2, 0, 1}, {2, 0, 1},
                                                    {6, 0, 0}, {0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
  std::vector<gpu::PixelCounts> counts;
  std::vector<gpu::PixelLanes> lanes;
  for (const auto& [steps, bounce, subgroup] : pixels) {
    counts.push_back({10, 20, 30, steps});
    lanes.push_back({bounce, subgroup});
  }
  const WorkSums sums = sum_work(counts, lanes, {4, 3, 4, 2, 3});
  EXPECT_EQ(sums.node_visits, 120);
  EXPECT_EQ(sums.box_tests, 240);
  EXPECT_EQ(sums.prim_tests, 360);
  EXPECT_EQ(sums.loop_steps, 32);
  EXPECT_DOUBLE_EQ(sums.simd_efficiency, 32.0 / 80.0);
  EXPECT_EQ(sums.max_subgroup_steps, 18);
  // Dispatches of one row make each row a workgroup of its own: nothing changes here but the sums
  // of those that shared one.
  EXPECT_DOUBLE_EQ(sum_work(counts, lanes, {4, 3, 4, 2, 1}).simd_efficiency, 32.0 / 80.0);
}

TEST(KernelList, HasTheKernelsByName) {
  EXPECT_TRUE(kernel_exists("BVH_FTB_DF"));
  EXPECT_FALSE(kernel_exists("bvh_ftb_df"));
  for (const KernelInfo& kernel : kernel_list()) {
    EXPECT_EQ(find_kernel(kernel.name), &kernel);
    EXPECT_GT(kernel.spirv.size(), 1000u);
    EXPECT_EQ(kernel.spirv.size() % 4, 0u);
  }
}

}  // namespace
}  // namespace energyprof::kernels
