// Scenes and cameras.
#include "app/scene.h"

#include <gtest/gtest.h>

#include <cmath>

#include "core/trace_math.h"

namespace energyprof::app {
namespace {

TEST(Scene, IsScaledByAPowerOfTwoIntoOneToTwo) {
  const Scene scene = load_scene("teapot", [](std::string_view) {});
  const accel::Bounds box = accel::bounds(scene.mesh);
  const float extent =
      std::max({box.max.x - box.min.x, box.max.y - box.min.y, box.max.z - box.min.z});
  EXPECT_GE(extent, 1.0f);
  EXPECT_LT(extent, 2.0f);
  int exponent = 0;
  EXPECT_EQ(std::frexp(scene.scale, &exponent), 0.5);  // a power of two: no digit is lost
}

TEST(Scene, CameraLooksAtTheTargetFromTheOrbit) {
  Scene scene;
  scene.scale = 0.25;
  const ViewConfig view{1.1, -2.0, 6.0, {0.5, 1.5, -0.5}};
  const gpu::FrameConstants c = frame_constants(scene, view, 1280, 720, 1, 1);
  const glm::vec3 origin(c.origin_tmin);
  const glm::vec3 to_target = glm::vec3(view.target * 0.25) - origin;
  EXPECT_NEAR(glm::length(to_target), 6.0 * 0.25, 1e-5);
  EXPECT_NEAR(glm::dot(glm::normalize(to_target), glm::vec3(c.forward)), 1.0, 1e-6);
  EXPECT_GT(c.up.y, 0.0f);
  EXPECT_NEAR(glm::length(glm::vec3(c.up)), std::tan(22.5 * 3.14159265358979 / 180.0), 1e-6);
  EXPECT_NEAR(glm::length(glm::vec3(c.right_tmax)) / glm::length(glm::vec3(c.up)), 1280.0 / 720.0,
              1e-5);
  EXPECT_NEAR(glm::dot(glm::vec3(c.right_tmax), glm::vec3(c.up)), 0.0, 1e-6);
  EXPECT_FLOAT_EQ(c.origin_tmin.w, 1e-4f * 0.25f);
}

TEST(Scene, LookingStraightDownHasARightAndAnUp) {
  const gpu::FrameConstants c = frame_constants(Scene{}, {0.0, 0.0, 2.0, {}}, 4, 4, 0, 1);
  EXPECT_NEAR(glm::length(glm::vec3(c.right_tmax)), std::tan(22.5 * 3.14159265358979 / 180.0),
              1e-6);
  EXPECT_TRUE(std::isfinite(c.up.x + c.up.y + c.up.z));
}

TEST(Scene, ViewsOfTheConfigAndOfTheModel) {
  const Scene scene = load_scene("teapot", [](std::string_view) {});
  EXPECT_EQ(resolve_view(scene, ViewChoice(1)).distance, 6.870121);
  EXPECT_EQ(resolve_view(scene, ViewChoice(ViewConfig{1, 2, 3, {}})).distance, 3.0);
}

}  // namespace
}  // namespace energyprof::app
