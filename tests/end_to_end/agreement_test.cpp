// What the GPU hits is what the CPU hits, with every algorithm on every structure: pixel by pixel,
// by checksum, and with the same work.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <optional>

#include "accel/gpu_triangles.h"
#include "accel/models.h"
#include "accel/structure.h"
#include "accel/trace_cpu.h"
#include "core/algorithms.h"
#include "kernels/device.h"
#include "kernels/runner.h"
#include "tests/accel/scenes.h"

namespace energyprof {
namespace {

using testing::IsEmpty;

/// The device, with validation; nullopt and a reason where there is none.
std::optional<kernels::Device> open_device(std::string& reason, bool gpu_assisted = false) {
  try {
    return kernels::Device(
        kernels::DeviceRequest{.validation = true, .gpu_assisted_validation = gpu_assisted});
  } catch (const std::runtime_error& error) {
    reason = error.what();
    return std::nullopt;
  }
}

/// Steps, visits and tests of a frame.
using Work = std::array<int64_t, 4>;

Work sum_work(const std::vector<gpu::PixelCounts>& counts) {
  Work work{};
  for (const gpu::PixelCounts& pixel : counts) {
    work[0] += pixel.loop_steps;
    work[1] += pixel.node_visits;
    work[2] += pixel.box_tests;
    work[3] += pixel.prim_tests;
  }
  return work;
}

/// `expected`: the checksum that every algorithm must arrive at; the first one fills it in.
void expect_agreement(kernels::Device& device, std::string_view algorithm, const AccelBlob& blob,
                      const std::vector<gpu::Triangle>& triangles,
                      const gpu::FrameConstants& camera, std::string& expected) {
  kernels::TraceProgram program(device, {.blob = blob,
                                         .triangles = triangles,
                                         .kernel = std::string(algorithm),
                                         .constants = camera});
  const FrameRecord timed = program.run_frame(camera.frame, Phase::timed);
  const FrameRecord record = program.run_frame(camera.frame, Phase::counted);
  EXPECT_EQ(timed.hit_checksum, record.hit_checksum);
  const accel::CpuFrame oracle = accel::trace_cpu(algorithm, {blob, triangles}, camera);
  const size_t different = test::different_pixels(oracle.hits, program.read_hits());
  EXPECT_LE(static_cast<double>(different), 1e-4 * static_cast<double>(oracle.hits.size()))
      << different << " of " << oracle.hits.size() << " pixels";
  if (device.info().type != "cpu") return;
  // The same arithmetic on the same processor: no difference at all.
  const accel::FrameSums sums = accel::sum_hits(oracle.hits);
  EXPECT_EQ(different, 0u);
  EXPECT_EQ(record.hit_checksum, sums.hit_checksum);
  EXPECT_EQ(record.hit_count, sums.hit_count);
  EXPECT_EQ(record.ray_count, sums.ray_count);
  const Work work{*record.loop_step_count, *record.node_visit_count, *record.box_test_count,
                  *record.prim_test_count};
  EXPECT_EQ(work, sum_work(oracle.counts));
  if (expected.empty()) expected = record.hit_checksum;
  EXPECT_EQ(record.hit_checksum, expected);
}

void expect_agreement_of_all(const accel::Mesh& mesh, const gpu::FrameConstants& camera) {
  std::string reason;
  auto device = open_device(reason);
  if (!device) GTEST_SKIP() << reason;
  const std::vector<gpu::Triangle> triangles = accel::gpu_triangles(mesh);
  std::string checksum;
  for (const bool tuned : {false, true})
    for (const AlgorithmInfo& algorithm : algorithm_list) {
      SCOPED_TRACE(testing::Message() << algorithm.name << (tuned ? ", tuned" : ", paper"));
      const AccelBlob blob =
          accel::build_structure(mesh, algorithm.kind,
                                 tuned ? accel::tuned_structures() : accel::StructureConfig{})
              .blob;
      expect_agreement(*device, algorithm.name, blob, triangles, camera, checksum);
    }
  EXPECT_THAT(device->validation_messages(), IsEmpty());
}

class Agreement : public testing::TestWithParam<test::NamedMesh> {};

TEST_P(Agreement, OfGpuAndCpu) {
  gpu::FrameConstants camera = test::camera_for(GetParam().mesh, 157, 93);
  camera.frame = 4;
  expect_agreement_of_all(GetParam().mesh, camera);
}

INSTANTIATE_TEST_SUITE_P(UglyScenes, Agreement, testing::ValuesIn(test::ugly_scenes()),
                         [](const auto& test) {
                           std::string name = test.param.name;
                           std::replace(name.begin(), name.end(), ' ', '_');
                           return name;
                         });

TEST(Agreement, HoldsForRaysAlongAxesAndOriginsInPlanes) {
  // All primary rays alike, along an axis, from a point of the lattice that the mesh is made of.
  accel::Mesh mesh = test::flat_square(8);
  const accel::Mesh side = mesh;
  for (const glm::vec3& p : side.positions) mesh.positions.emplace_back(p.z + 0.5f, p.x, p.y);
  const auto base = static_cast<uint32_t>(side.positions.size());
  for (const glm::uvec3& t : side.triangles) mesh.triangles.push_back(t + base);
  for (int axis = 0; axis < 3; ++axis)
    for (const float sign : {-1.0f, 1.0f}) {
      SCOPED_TRACE(testing::Message() << "along " << (sign < 0 ? "-" : "+") << "xyz"[axis]);
      gpu::FrameConstants camera{};
      glm::vec3 forward(0.0f);
      forward[axis] = sign;
      camera.origin_tmin = glm::vec4(glm::vec3(0.5f) - 2.0f * forward, 1e-4f);
      camera.right_tmax.w = 1e13f;
      camera.forward = glm::vec4(forward, 0.0f);
      camera.width = 16;
      camera.height = 16;
      camera.bounce_count = 1;
      camera.row_count = 16;
      expect_agreement_of_all(mesh, camera);
    }
}

TEST(Agreement, GpuAssistedValidationIsSilentOnTheTeapot) {
  std::string reason;
  auto device = open_device(reason, true);
  if (!device) GTEST_SKIP() << reason;
  const accel::Mesh mesh = accel::make_teapot();
  const std::vector<gpu::Triangle> triangles = accel::gpu_triangles(mesh);
  const gpu::FrameConstants camera = test::camera_for(mesh, 80, 45);
  std::string checksum;
  for (const AlgorithmInfo& algorithm : algorithm_list) {
    SCOPED_TRACE(algorithm.name);
    const AccelBlob blob = accel::build_structure(mesh, algorithm.kind).blob;
    expect_agreement(*device, algorithm.name, blob, triangles, camera, checksum);
  }
  EXPECT_THAT(device->validation_messages(), IsEmpty());
}

TEST(Agreement, GpuAssistedValidationWouldSpeak) {
  const accel::Mesh mesh = accel::make_teapot();
  const std::vector<gpu::Triangle> triangles = accel::gpu_triangles(mesh);
  const auto expect_message = [&](std::string_view algorithm, const AccelBlob& broken) {
    SCOPED_TRACE(algorithm);
    std::string reason;
    auto device = open_device(reason, true);
    if (!device) GTEST_SKIP() << reason;
    kernels::TraceProgram program(*device, {.blob = broken,
                                            .triangles = triangles,
                                            .kernel = std::string(algorithm),
                                            .constants = test::camera_for(mesh, 16, 16)});
    static_cast<void>(program.run_frame(0, Phase::timed));
    EXPECT_THAT(device->validation_messages(), testing::Not(IsEmpty()));
  };
  // Links, lists and cells that reach far out of their buffers.
  AccelBlob bvh = accel::build_structure(mesh, AccelKind::bvh_breadth_first).blob;
  reinterpret_cast<gpu::BvhNode*>(bvh.nodes.data())->max_link.w = gpu::uintBitsToFloat(1u << 24u);
  expect_message("BVH_FTB_BF", bvh);
  AccelBlob kd = accel::build_structure(mesh, AccelKind::kd_tree).blob;
  kd.refs.assign(kd.refs.size(), 1u << 24u);
  expect_message("KD_TREE", kd);
  AccelBlob grid = accel::build_structure(mesh, AccelKind::grid).blob;
  grid.nodes.resize(sizeof(gpu::GridCell));
  expect_message("GRID", grid);
}

class ModelAgreement : public testing::TestWithParam<const char*> {};

TEST_P(ModelAgreement, OfGpuAndCpu) {
  const accel::ModelInfo& info = *accel::find_model(GetParam());
  if (!accel::is_available(info))
    GTEST_SKIP() << "not fetched: energyprof models fetch " << info.name;
  const accel::Mesh mesh = accel::load_model(GetParam(), [](std::string_view) {}).mesh;
  EXPECT_EQ(mesh.triangles.size(), static_cast<size_t>(info.triangle_count));
  // At a thousandth of its size too: the dragon in metres is smaller still. No hit may depend on
  // it.
  const accel::Mesh traced = test::is_sanitized ? test::decimated(mesh, 100.0f) : mesh;
  for (const float scale : {1.0f, 0x1p-10f}) {
    SCOPED_TRACE(scale);
    const accel::Mesh scaled = test::transformed(traced, scale, glm::vec3(0.0f));
    expect_agreement_of_all(scaled, test::camera_for(scaled, 160, 90));
  }
}

INSTANTIATE_TEST_SUITE_P(Models, ModelAgreement, testing::Values("bunny", "dragon"),
                         [](const auto& test) { return std::string(test.param); });

}  // namespace
}  // namespace energyprof
