// What the GPU hits is what the CPU oracle hits: pixel by pixel, and by checksum.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <optional>

#include "accel/bvh.h"
#include "accel/models.h"
#include "accel/trace_cpu.h"
#include "kernels/device.h"
#include "kernels/runner.h"
#include "tests/accel/scenes.h"

namespace energyprof {
namespace {

using testing::IsEmpty;

/// The device, with validation; nullopt and a reason where there is none.
std::optional<kernels::Device> open_device(std::string& reason) {
  try {
    return kernels::Device(kernels::DeviceRequest{"auto", true});
  } catch (const std::runtime_error& error) {
    reason = error.what();
    return std::nullopt;
  }
}

void expect_agreement(const accel::Mesh& mesh, const gpu::FrameConstants& camera) {
  std::string reason;
  auto device = open_device(reason);
  if (!device) GTEST_SKIP() << reason;
  const AccelBlob blob = accel::build_bvh(mesh).blob;
  kernels::TraceProgram program(*device, {blob, "BVH_FTB_DF", camera, {}});
  const FrameRecord record = program.run_frame(camera.frame, Phase::counted);

  const accel::CpuFrame oracle = accel::trace_cpu(blob, camera, accel::CpuMethod::traverse);
  const accel::FrameSums sums = accel::sum_hits(oracle.hits);
  const size_t pixel_count = oracle.hits.size();
  const size_t different = test::different_pixels(oracle.hits, program.read_hits());
  EXPECT_LE(static_cast<double>(different), 1e-4 * static_cast<double>(pixel_count))
      << different << " of " << pixel_count << " pixels";
  if (device->info().type == "cpu") {
    // The same arithmetic on the same processor: no difference at all.
    EXPECT_EQ(different, 0u);
    EXPECT_EQ(record.hit_checksum, sums.hit_checksum);
    EXPECT_EQ(record.hit_count, sums.hit_count);
    EXPECT_EQ(record.ray_count, sums.ray_count);
    int64_t node_visits = 0;
    int64_t prim_tests = 0;
    for (const gpu::PixelCounts& counts : oracle.counts) {
      node_visits += counts.node_visits;
      prim_tests += counts.prim_tests;
    }
    EXPECT_EQ(record.node_visit_count, node_visits);
    EXPECT_EQ(record.prim_test_count, prim_tests);
  }
  EXPECT_THAT(device->validation_messages(), IsEmpty());
}

class Agreement : public testing::TestWithParam<test::NamedMesh> {};

TEST_P(Agreement, OfGpuAndOracle) {
  gpu::FrameConstants camera = test::camera_for(GetParam().mesh, 157, 93);
  camera.frame = 4;
  expect_agreement(GetParam().mesh, camera);
}

INSTANTIATE_TEST_SUITE_P(UglyScenes, Agreement, testing::ValuesIn(test::ugly_scenes()),
                         [](const auto& test) {
                           std::string name = test.param.name;
                           std::replace(name.begin(), name.end(), ' ', '_');
                           return name;
                         });

TEST(Agreement, OnTheDragon) {
  const accel::ModelInfo& info = *accel::find_model("dragon");
  if (!accel::is_available(info))
    GTEST_SKIP() << "the dragon is not fetched: energyprof models fetch dragon";
  const accel::LoadedModel dragon = accel::load_model("dragon", [](std::string_view) {});
  ASSERT_EQ(dragon.mesh.positions.size(), 435'545u);
  ASSERT_EQ(dragon.mesh.triangles.size(), 871'306u);
  expect_agreement(dragon.mesh, test::camera_for(dragon.mesh, 320, 180));
  // At a thousandth of its size: the dragon in metres is smaller still. No hit may depend on it.
  const accel::Mesh small = test::transformed(dragon.mesh, 0x1p-10f, glm::vec3(0.0f));
  expect_agreement(small, test::camera_for(small, 320, 180));
}

}  // namespace
}  // namespace energyprof
