// The arithmetic that C++ and the kernels share, against closed forms.
#include "core/trace_math.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace energyprof::gpu {
namespace {

FrameConstants constants_looking_down_z() {
  FrameConstants c{};
  c.origin_tmin = vec4(0, 0, 5, 1e-4f);
  c.right_tmax = vec4(1, 0, 0, 1e13f);
  c.up = vec4(0, 1, 0, 0);
  c.forward = vec4(0, 0, -1, 0);
  c.width = 64;
  c.height = 64;
  c.seed = 7;
  return c;
}

TEST(TraceMath, PrimaryRaysAreUnitLengthAndStayInTheirPixel) {
  const FrameConstants c = constants_looking_down_z();
  for (uint y = 0; y < c.height; ++y)
    for (uint x = 0; x < c.width; ++x) {
      const Ray ray = primary_ray(c, x, y);
      EXPECT_NEAR(glm::length(ray.direction), 1.0f, 1e-6f);
      // Where the ray crosses z = 4, one unit ahead: the image plane, [-1, 1] on both axes.
      const float px = (ray.direction.x / -ray.direction.z + 1.0f) * 0.5f * 64.0f;
      const float py = (1.0f - ray.direction.y / -ray.direction.z) * 0.5f * 64.0f;
      EXPECT_GE(px, static_cast<float>(x) - 1e-3f);
      EXPECT_LE(px, static_cast<float>(x) + 1.0f + 1e-3f);
      EXPECT_GE(py, static_cast<float>(y) - 1e-3f);
      EXPECT_LE(py, static_cast<float>(y) + 1.0f + 1e-3f);
    }
}

TEST(TraceMath, BounceDirectionsAreUniformOverTheHemisphere) {
  // Uniform over a hemisphere: the mean direction is n / 2, the mean of z^2 is 1/3.
  FrameConstants c = constants_looking_down_z();
  const Ray down = {vec3(0, 0, 5), vec3(0, 0, -1), 1e-4f, 1e13f, inverse_direction(vec3(0, 0, -1))};
  double sum_z = 0.0;
  double sum_z2 = 0.0;
  double sum_x = 0.0;
  constexpr int n = 100'000;
  for (int i = 0; i < n; ++i) {
    c.frame = static_cast<uint>(i);
    const Ray ray = bounce_ray(c, down, 5.0f, vec3(0, 0, -3), 11u);  // normal of either sign
    EXPECT_GE(ray.direction.z, 0.0f);
    sum_z += ray.direction.z;
    sum_z2 += ray.direction.z * ray.direction.z;
    sum_x += ray.direction.x;
  }
  // Standard errors: sqrt(1/12 / n) = 0.0009, sqrt(4/45 / n) = 0.0009, sqrt(1/3 / n) = 0.0018.
  EXPECT_NEAR(sum_z / n, 0.5, 0.005);
  EXPECT_NEAR(sum_z2 / n, 1.0 / 3.0, 0.005);
  EXPECT_NEAR(sum_x / n, 0.0, 0.01);
}

TEST(TraceMath, TriangleTestDoesNotDependOnTheScale) {
  for (const float scale : {1e-8f, 1e-5f, 1e-3f, 1.0f, 1e4f, 1e8f}) {
    SCOPED_TRACE(scale);
    const Ray ray = {vec3(0.25f, 0.25f, 1.0f) * scale, vec3(0, 0, -1), 0.0f, 1e30f,
                     inverse_direction(vec3(0, 0, -1))};
    const Hit hit =
        closer_hit(Hit{1e30f, 0u}, ray, vec3(0), vec3(scale, 0, 0), vec3(0, scale, 0), 41);
    EXPECT_EQ(hit.prim_id, 42u);
    EXPECT_FLOAT_EQ(hit.t, scale);
  }
}

TEST(TraceMath, EqualDistancesGoToTheLowerTriangle) {
  const Ray ray = {vec3(0.25f, 0.25f, 1.0f), vec3(0, 0, -1), 0.0f, 1e30f,
                   inverse_direction(vec3(0, 0, -1))};
  const auto test = [&](Hit best, uint prim) {
    return closer_hit(best, ray, vec3(0), vec3(1, 0, 0), vec3(0, 1, 0), prim);
  };
  const Hit none{1e30f, 0u};
  EXPECT_EQ(test(test(none, 3), 8).prim_id, 4u);
  EXPECT_EQ(test(test(none, 8), 3).prim_id, 4u);
}

TEST(TraceMath, DegenerateTrianglesAreNeverHit) {
  const Ray ray = {vec3(0.5f, 0.0f, 1.0f), vec3(0, 0, -1), 0.0f, 1e30f,
                   inverse_direction(vec3(0, 0, -1))};
  EXPECT_EQ(closer_hit(Hit{1e30f, 0u}, ray, vec3(0), vec3(1, 0, 0), vec3(1, 0, 0), 0).prim_id, 0u);
  EXPECT_EQ(closer_hit(Hit{1e30f, 0u}, ray, vec3(0), vec3(0), vec3(0), 0).prim_id, 0u);
}

TEST(TraceMath, AxisParallelRaysEnterAPaddedBox) {
  // The unit cube, padded as the builders pad it: rays in its faces are inside.
  const vec3 low(-2e-7f);
  const vec3 high(1.0f + 2e-7f);
  // Along an edge, in a face, from inside, just outside, and away from it.
  const auto enters = [&](vec3 origin, vec3 direction) {
    return enter_box(low, high, origin, inverse_direction(direction), 0.0f, 1e30f) >= 0.0f;
  };
  EXPECT_TRUE(enters(vec3(0, 0, 2), vec3(0, 0, -1)));
  EXPECT_TRUE(enters(vec3(1, 0.5f, 2), vec3(0, 0, -1)));
  EXPECT_TRUE(enters(vec3(0.5f, 0.5f, 0.5f), vec3(0, -0.0f, 1)));
  EXPECT_FALSE(enters(vec3(1.001f, 0.5f, 2), vec3(0, 0, -1)));
  EXPECT_FALSE(enters(vec3(0.5f, 0.5f, 2), vec3(0, 0, 1)));
}

TEST(TraceMath, ChecksumNoticesASwapOfTwoPixels) {
  const PixelHits a{1, 0, 2, 0};
  const PixelHits b{2, 0, 1, 0};
  const uvec2 straight = checksum_terms(0, a) + checksum_terms(1, b);
  const uvec2 swapped = checksum_terms(0, b) + checksum_terms(1, a);
  EXPECT_NE(straight, swapped);
}

}  // namespace
}  // namespace energyprof::gpu
