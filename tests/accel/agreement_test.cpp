// Every algorithm on every structure finds the closest hit: as brute force does, bit by bit, and as
// Embree does.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <random>

#include "accel/gpu_triangles.h"
#include "accel/models.h"
#include "accel/structure.h"
#include "accel/trace_cpu.h"
#include "accel/validate.h"
#include "core/algorithms.h"
#include "tests/accel/embree_oracle.h"
#include "tests/accel/scenes.h"

namespace energyprof::accel {
namespace {

using testing::IsEmpty;

struct NamedConfig {
  const char* name;
  StructureConfig config;
};

/// The paper's parameters, the tuned ones, and others that take other paths through the builders.
std::vector<NamedConfig> configs() {
  StructureConfig sweep = tuned_structures();
  sweep.bvh.method = BvhConfig::Method::sweep;
  sweep.bvh.max_leaf_size = 2;
  sweep.kdtree.clip = true;
  sweep.kdtree.max_leaf_size = 1;
  sweep.grid.lambda = 0.1f;
  return {{"paper", {}}, {"tuned", tuned_structures()}, {"sweep", sweep}};
}

/// Calls check(algorithm, config's name, structure) for all there are.
template <class Check>
void for_each_structure(const Mesh& mesh, Check&& check) {
  for (const NamedConfig& named : configs())
    for (const AlgorithmInfo& algorithm : algorithm_list) {
      SCOPED_TRACE(testing::Message() << algorithm.name << ", " << named.name);
      check(algorithm.name, build_structure(mesh, algorithm.kind, named.config).blob);
    }
}

class Agreement : public testing::TestWithParam<test::NamedMesh> {};

TEST_P(Agreement, OfEveryAlgorithmWithBruteForceAndEmbree) {
  const Mesh& mesh = GetParam().mesh;
  const std::vector<gpu::Triangle> triangles = gpu_triangles(mesh);
  gpu::FrameConstants camera = test::camera_for(mesh, 64, 48);
  const CpuFrame expected = trace_brute_force(triangles, camera);
  const FrameSums sums = sum_hits(expected.hits);
  if (!triangles.empty()) {
    EXPECT_GT(sums.hit_count, 0);
  }
  const test::EmbreeOracle oracle(mesh);
  EXPECT_EQ(test::pixels_unlike_embree(oracle, mesh, triangles, camera, expected.hits), 0u);
  for_each_structure(mesh, [&](std::string_view algorithm, const AccelBlob& blob) {
    EXPECT_THAT(validate(blob, mesh), IsEmpty());
    const CpuFrame found = trace_cpu(algorithm, {blob, triangles}, camera);
    EXPECT_EQ(test::different_pixels(expected.hits, found.hits), 0u);
    EXPECT_EQ(sum_hits(found.hits).hit_checksum, sums.hit_checksum);
  });
}

INSTANTIATE_TEST_SUITE_P(UglyScenes, Agreement, testing::ValuesIn(test::ugly_scenes()),
                         [](const auto& test) {
                           std::string name = test.param.name;
                           std::replace(name.begin(), name.end(), ' ', '_');
                           return name;
                         });

/// One ray, as a frame of one pixel.
gpu::FrameConstants single_ray(const glm::vec3& origin, const glm::vec3& direction) {
  gpu::FrameConstants constants{};
  constants.origin_tmin = glm::vec4(origin, 0.0f);
  constants.right_tmax = glm::vec4(0.0f, 0.0f, 0.0f, 1e13f);
  constants.forward = glm::vec4(direction, 0.0f);
  constants.width = 1;
  constants.height = 1;
  return constants;
}

/// Points of a small lattice: rays from and to them run along axes, lie in split planes and in the
/// planes of cells, start on triangles, and meet edges and corners.
glm::vec3 lattice_point() {
  const auto coordinate = [] { return static_cast<float>(*rc::gen::inRange(-4, 5)); };
  const float x = coordinate();
  const float y = coordinate();
  return {x, y, coordinate()};
}

RC_GTEST_PROP(Agreement, HoldsForRaysInPlanesAndThroughCorners, ()) {
  Mesh mesh;
  const auto triangle_count = *rc::gen::inRange<uint32_t>(1, 40);
  for (uint32_t i = 0; i < triangle_count; ++i) {
    for (int corner = 0; corner < 3; ++corner) mesh.positions.push_back(lattice_point());
    mesh.triangles.emplace_back(3 * i, 3 * i + 1, 3 * i + 2);
  }
  const float scale = std::ldexp(1.0f, *rc::gen::inRange(-20, 21));
  const bool is_far = *rc::gen::inRange(0, 4) == 0;
  const glm::vec3 offset(is_far ? 1e6f * scale : 0.0f, 0.0f, 0.0f);
  mesh = weld(test::transformed(mesh, scale, offset));
  RC_PRE(!mesh.triangles.empty());
  const std::vector<gpu::Triangle> triangles = gpu_triangles(mesh);
  std::vector<gpu::FrameConstants> rays;
  for (int i = 0; i < 50; ++i) {
    glm::vec3 direction = lattice_point();
    if (i % 3 == 0) direction.x = direction.y = 0.0f;
    if (direction != glm::vec3(0.0f))
      rays.push_back(single_ray(lattice_point() * scale + offset, direction));
  }
  for (const NamedConfig& named : configs())
    for (const AlgorithmInfo& algorithm : algorithm_list) {
      const AccelBlob blob = build_structure(mesh, algorithm.kind, named.config).blob;
      if (const auto violations = validate(blob, mesh); !violations.empty())
        RC_FAIL(std::string(algorithm.name) + ", " + named.name + ": " + violations.front());
      for (const gpu::FrameConstants& ray : rays) {
        const gpu::PixelHits expected = trace_brute_force(triangles, ray).hits[0];
        const gpu::PixelHits found = trace_cpu(algorithm.name, {blob, triangles}, ray).hits[0];
        if (found.primary_id != expected.primary_id || found.primary_t != expected.primary_t)
          RC_FAIL(std::string(algorithm.name) + ", " + named.name + ": hit " +
                  std::to_string(found.primary_id) + " at " +
                  std::to_string(gpu::uintBitsToFloat(found.primary_t)) + " instead of " +
                  std::to_string(expected.primary_id) + " at " +
                  std::to_string(gpu::uintBitsToFloat(expected.primary_t)));
      }
    }
}

TEST(Agreement, HoldsForOriginsInsideTheScene) {
  const Mesh mesh = test::triangle_soup(3000, 0.1f, 31);
  const std::vector<gpu::Triangle> triangles = gpu_triangles(mesh);
  gpu::FrameConstants camera = test::camera_for(mesh, 48, 48);
  camera.origin_tmin = glm::vec4(0.5f, 0.5f, 0.5f, 0.0f);
  const CpuFrame expected = trace_brute_force(triangles, camera);
  for_each_structure(mesh, [&](std::string_view algorithm, const AccelBlob& blob) {
    const CpuFrame found = trace_cpu(algorithm, {blob, triangles}, camera);
    EXPECT_EQ(test::different_pixels(expected.hits, found.hits), 0u);
  });
}

TEST(Agreement, HoldsForNeedlesSeenFromAfar) {
  // Triangles a thousandth long and a millionth wide, a unit away: rounding makes rays hit them
  // that pass beside them.
  std::mt19937 random(37);
  std::uniform_real_distribution<float> unit(-1.0f, 1.0f);
  const auto point = [&] { return glm::vec3(unit(random), unit(random), unit(random)); };
  Mesh mesh;
  std::vector<gpu::FrameConstants> rays;
  for (uint32_t i = 0; i < 1000; ++i) {
    const glm::vec3 tip = point();
    const glm::vec3 along = 1e-3f * glm::normalize(point());
    for (const glm::vec3& corner : {tip, tip + along, tip + 0.9f * along + 1e-6f * point()})
      mesh.positions.push_back(corner);
    mesh.triangles.emplace_back(3 * i, 3 * i + 1, 3 * i + 2);
    const glm::vec3 origin = 2.0f * glm::normalize(point());
    for (int k = 0; k < 10; ++k)
      rays.push_back(
          single_ray(origin, glm::normalize(tip + (0.13f * static_cast<float>(k) - 0.13f) * along +
                                            1e-6f * point() - origin)));
  }
  const std::vector<gpu::Triangle> triangles = gpu_triangles(mesh);
  std::vector<gpu::PixelHits> expected;
  int hit_count = 0;
  for (const gpu::FrameConstants& ray : rays) {
    expected.push_back(trace_brute_force(triangles, ray).hits[0]);
    hit_count += expected.back().primary_id != 0 ? 1 : 0;
  }
  EXPECT_GT(hit_count, 100);
  for_each_structure(mesh, [&](std::string_view algorithm, const AccelBlob& blob) {
    int different = 0;
    for (size_t i = 0; i < rays.size(); ++i) {
      const gpu::PixelHits found = trace_cpu(algorithm, {blob, triangles}, rays[i]).hits[0];
      different +=
          found.primary_id != expected[i].primary_id || found.primary_t != expected[i].primary_t
              ? 1
              : 0;
    }
    EXPECT_EQ(different, 0);
  });
}

/// On a model too large for brute force: all algorithms alike, and like Embree but for ties.
void expect_agreement_on(const Mesh& mesh) {
  const std::vector<gpu::Triangle> triangles = gpu_triangles(mesh);
  const gpu::FrameConstants camera = test::camera_for(mesh, 160, 90);
  const test::EmbreeOracle oracle(mesh);
  std::string checksum;
  for_each_structure(mesh, [&](std::string_view algorithm, const AccelBlob& blob) {
    EXPECT_THAT(validate(blob, mesh), IsEmpty());
    const CpuFrame found = trace_cpu(algorithm, {blob, triangles}, camera);
    const std::string sum = sum_hits(found.hits).hit_checksum;
    if (checksum.empty()) {
      checksum = sum;
      EXPECT_LE(test::pixels_unlike_embree(oracle, mesh, triangles, camera, found.hits), 1u)
          << "of " << found.hits.size();
    }
    EXPECT_EQ(sum, checksum);
  });
}

class ModelAgreement : public testing::TestWithParam<const char*> {};

TEST_P(ModelAgreement, HoldsInFullAndDecimated) {
  const ModelInfo& info = *find_model(GetParam());
  if (!is_available(info)) GTEST_SKIP() << "not fetched: energyprof models fetch " << info.name;
  const Mesh mesh = load_model(GetParam(), [](std::string_view) {}).mesh;
  expect_agreement_on(test::decimated(mesh, 100.0f));
  if (!test::is_sanitized) expect_agreement_on(mesh);
}

INSTANTIATE_TEST_SUITE_P(Models, ModelAgreement, testing::Values("bunny", "dragon"),
                         [](const auto& test) { return std::string(test.param); });

}  // namespace
}  // namespace energyprof::accel
