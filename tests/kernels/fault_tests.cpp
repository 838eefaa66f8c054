// Drivers that fail: device loss, hangs, no memory, odd clocks. The faults come from
// fault_layer.cpp; everything above it runs as it would on a broken machine.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/clock.h"
#include "kernels/clock_sync.h"
#include "kernels/runner.h"
#include "scene.h"

namespace energyprof::kernels {
namespace {

using testing::HasSubstr;

class Faults : public testing::Test {
 protected:
  void SetUp() override {
    if (const std::string reason = no_device_reason(); !reason.empty()) GTEST_SKIP() << reason;
  }

  [[nodiscard]] TraceSetup setup() const {
    return {.blob = scene_.blob,
            .triangles = scene_.triangles,
            .constants = constants_,
            .config = {.rows_per_dispatch = 8}};
  }
  /// What a healthy device says.
  [[nodiscard]] std::string expected_checksum(uint32_t frame) const {
    return trace_brute_force(scene_, constants_, frame).checksum;
  }
  /// True if begin and end lie between submission and now, within the error.
  static testing::AssertionResult lies_in_time(const FrameRecord& record) {
    const int64_t error_ns = record.clock_error_ns.value();
    const bool fits = record.begin_ns + error_ns >= record.submit_ns &&
                      record.end_ns > record.begin_ns && record.end_ns - error_ns <= now_ns();
    if (fits) return testing::AssertionSuccess();
    return testing::AssertionFailure()
           << "begin is " << record.begin_ns - record.submit_ns << " ns, end "
           << record.end_ns - record.submit_ns << " ns after submission, +- " << error_ns;
  }

  const Scene scene_ = build_halves(random_triangles(200, 3));
  const gpu::FrameConstants constants_ = looking_at_cube(40, 30);
};

template <typename Exception, typename Call>
std::string error_of(Call&& call) {
  try {
    call();
  } catch (const Exception& error) {
    return error.what();
  }
  return "no such error";
}

TEST_F(Faults, ALayerWithoutFaultsChangesNothing) {
  const ScopedFault fault("");
  ValidatedDevice device;
  TraceProgram program(*device, setup());
  EXPECT_EQ(program.run_frame(0, Phase::timed).hit_checksum, expected_checksum(0));
}

TEST_F(Faults, ALostDeviceIsSaidAndANewOneWorks) {
  // The 2nd of a frame's 4 tiles, with the first one still running; and the 3rd submission of all
  // waits, in the second frame.
  for (const char* kind : {"device-lost:2", "device-lost-wait:3"}) {
    SCOPED_TRACE(kind);
    const ScopedFault fault(kind);
    {
      ValidatedDevice device;
      TraceProgram program(*device, setup());
      const std::string error = error_of<DeviceLost>([&] {
        for (uint32_t frame = 0; frame < 3; ++frame) program.run_frame(frame, Phase::timed);
      });
      EXPECT_THAT(error, HasSubstr("cannot trace a frame on '" + device->info().name +
                                   "': VK_ERROR_DEVICE_LOST"));
      EXPECT_THROW(program.run_frame(9, Phase::timed), DeviceLost);
    }
    ValidatedDevice device;
    TraceProgram program(*device, setup());
    EXPECT_EQ(program.run_frame(0, Phase::timed).hit_checksum, expected_checksum(0));
  }
}

TEST_F(Faults, AHangEndsAsALostDevice) {
  const ScopedFault fault("hang:1");
  Device device({.timeout_ns = 300 * ns_per_ms});
  TraceProgram program(device, setup());
  const std::string error = error_of<DeviceLost>([&] { program.run_frame(0, Phase::timed); });
  EXPECT_THAT(error, HasSubstr("not finished after 0.3 s"));
  // What may still be running is neither waited for nor used again.
  EXPECT_THAT(error_of<DeviceLost>([&] { program.run_frame(1, Phase::timed); }),
              HasSubstr("the device was lost earlier"));
}

TEST_F(Faults, MissingMemoryNamesTheBufferAndItsSize) {
  // In the order in which they are allocated.
  const std::vector<std::string> buffers{"node buffer", "reference buffer", "triangle buffer",
                                         "hit buffer",  "work buffer",      "lane buffer",
                                         "sum buffer"};
  for (size_t i = 0; i < buffers.size(); ++i) {
    SCOPED_TRACE(buffers[i]);
    const ScopedFault fault("out-of-memory:" + std::to_string(i + 1));
    ValidatedDevice device;
    const std::string error = error_of<OutOfMemory>([&] { TraceProgram(*device, setup()); });
    EXPECT_THAT(error, HasSubstr("for the " + buffers[i] + " on '" + device->info().name));
    EXPECT_THAT(error, testing::ContainsRegex("cannot allocate [0-9.]+ (bytes|MiB) "));
    EXPECT_THAT(error, HasSubstr("VK_ERROR_OUT_OF_DEVICE_MEMORY"));
    // It was only once: the same device goes on.
    TraceProgram program(*device, setup());
    EXPECT_EQ(program.run_frame(0, Phase::timed).hit_checksum, expected_checksum(0));
  }
}

TEST_F(Faults, ABufferBeyondTheLimitIsRefusedByNumber) {
  const ScopedFault fault("small-range");
  ValidatedDevice device;
  Scene scene = scene_;
  scene.blob.nodes.resize(2u << 20u);
  const std::string error = error_of<std::runtime_error>([&] {
    TraceProgram(*device,
                 {.blob = scene.blob, .triangles = scene.triangles, .constants = constants_});
  });
  EXPECT_EQ(error, "no Vulkan device fits: '" + device->info().name +
                       "': maxStorageBufferRange is 1 MiB, the node buffer needs 2 MiB.");
}

TEST_F(Faults, WithoutCalibrationFramesLieBetweenSubmitAndFence) {
  for (const char* kind : {"no-calibrated", "no-monotonic"}) {
    SCOPED_TRACE(kind);
    const ScopedFault fault(kind);
    ValidatedDevice device;
    EXPECT_FALSE(device->info().calibrated_timestamps);
    EXPECT_THAT(device->info().clock_note, HasSubstr("midway between"));
    TraceProgram program(*device, setup());
    for (uint32_t frame = 0; frame < 3; ++frame) {
      const FrameRecord record = program.run_frame(frame, Phase::timed);
      EXPECT_TRUE(lies_in_time(record));
      EXPECT_GE(record.begin_ns, record.submit_ns);
      EXPECT_LE(record.end_ns, now_ns());
      EXPECT_EQ(record.hit_checksum, expected_checksum(frame));
    }
  }
}

TEST_F(Faults, TimestampsMayWrapAroundAnywhere) {
  // Calibrated or not, the counter wraps 200 us after the first timestamp is read.
  for (const char* kind :
       {"valid-bits:36", "valid-bits:36,tick-period:52.083332", "valid-bits:36,no-calibrated",
        "valid-bits:36,no-calibrated,tick-period:52.083332"}) {
    SCOPED_TRACE(kind);
    const ScopedFault fault(kind);
    ValidatedDevice device;
    EXPECT_EQ(device->info().timestamp_valid_bits, 36u);
    TraceProgram program(*device, setup());
    for (uint32_t frame = 0; frame < 4; ++frame) {
      EXPECT_TRUE(lies_in_time(program.run_frame(frame, Phase::timed)));
    }
  }
}

TEST_F(Faults, ADeviceWithoutTimestampsIsRefused) {
  const ScopedFault fault("valid-bits:0");
  EXPECT_THAT(error_of<std::runtime_error>([] { const Device device; }),
              HasSubstr("timestampValidBits is 0 on its compute queue"));
  const DeviceList list = list_devices();
  EXPECT_TRUE(list.usable.empty());
  EXPECT_FALSE(list.unusable.empty());
}

TEST_F(Faults, DiscreteDevicesGetTheirDataThroughStagingBuffers) {
  const ScopedFault fault("device-type:discrete");
  ValidatedDevice device;
  EXPECT_EQ(device->info().type, "discrete");
  TraceProgram program(*device, setup());
  const ExpectedFrame expected = trace_brute_force(scene_, constants_, 5);
  EXPECT_EQ(program.run_frame(5, Phase::timed).hit_checksum, expected.checksum);
  EXPECT_EQ(program.run_frame(5, Phase::counted).hit_checksum, expected.checksum);
  const auto hits = program.read_hits();
  ASSERT_EQ(hits.size(), expected.hits.size());
  for (size_t i = 0; i < hits.size(); ++i) {
    EXPECT_EQ(hits[i].primary_t, expected.hits[i].primary_t) << i;
    EXPECT_EQ(hits[i].bounce_t, expected.hits[i].bounce_t) << i;
  }
  EXPECT_EQ(program.read_counts().size(), hits.size());
}

TEST_F(Faults, StagingCopiesMoreThanItsBufferHolds) {
  // 16 MiB of pixels and a row more: read back in two pieces. The triangle fills the last row, and
  // leaves the first one empty.
  const ScopedFault fault("device-type:discrete");
  ValidatedDevice device;
  const Scene scene = build_halves({{{-9, -9, 1}, {9, -9, 1}, {0.5f, 0.9f, 1}}});
  const gpu::FrameConstants constants = looking_at_cube(1024, 1025);
  TraceProgram program(*device,
                       {.blob = scene.blob, .triangles = scene.triangles, .constants = constants});
  const ExpectedFrame expected = trace_brute_force(scene, constants, 0);
  EXPECT_EQ(program.run_frame(0, Phase::timed).hit_checksum, expected.checksum);
  const auto hits = program.read_hits();
  ASSERT_EQ(hits.size(), expected.hits.size());
  EXPECT_EQ(hits.front().primary_id, 0u);
  EXPECT_EQ(hits.back().primary_id, 1u);
  size_t different = 0;
  for (size_t i = 0; i < hits.size(); ++i) {
    different += hits[i].primary_id != expected.hits[i].primary_id;
  }
  EXPECT_EQ(different, 0u);
}

TEST_F(Faults, GpusBeginWithSmallDispatchesAndGrow) {
  const ScopedFault fault("device-type:integrated");
  ValidatedDevice device;
  const gpu::FrameConstants constants = looking_at_cube(16, 200);
  TraceProgram program(
      *device, {.blob = scene_.blob, .triangles = scene_.triangles, .constants = constants});
  const FrameRecord first = program.run_frame(0, Phase::warmup);
  EXPECT_EQ(first.dispatch_count, 7);  // 200 rows in tiles of 32
  // So small an image soon goes in one dispatch, compilation of the first frame or not.
  FrameRecord last;
  for (uint32_t frame = 1; frame < 20; ++frame) last = program.run_frame(frame, Phase::timed);
  EXPECT_EQ(last.dispatch_count, 1);
  EXPECT_EQ(last.hit_checksum, trace_brute_force(scene_, constants, 19).checksum);
}

}  // namespace
}  // namespace energyprof::kernels
