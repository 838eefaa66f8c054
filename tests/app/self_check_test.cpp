#include "app/self_check.h"

#include <gtest/gtest.h>

#include "core/clock.h"

namespace energyprof::app {
namespace {

/// What a plan takes when its frames do.
int64_t duration_ns(const SelfCheckPlan& plan, int64_t frame_ns) {
  return 4 * plan.round_count * plan.frames_per_block * frame_ns;
}

TEST(SelfCheckPlan, FillsItsTimeAndKeepsToIt) {
  const int64_t budget_ns = 8 * ns_per_s;
  for (const int64_t frame_ns : {200 * ns_per_us, ns_per_ms, 7 * ns_per_ms, 100 * ns_per_ms}) {
    SCOPED_TRACE(frame_ns);
    const SelfCheckPlan plan = plan_self_check(frame_ns, budget_ns);
    EXPECT_GE(plan.round_count, 4);
    EXPECT_GE(plan.frames_per_block, 5);
    EXPECT_LE(duration_ns(plan, frame_ns), budget_ns);
    EXPECT_GE(duration_ns(plan, frame_ns), budget_ns * 4 / 5);
  }
}

TEST(SelfCheckPlan, HasFourRoundsHoweverLongAFrameTakes) {
  const SelfCheckPlan plan = plan_self_check(3 * ns_per_s, 8 * ns_per_s);
  EXPECT_EQ(plan.round_count, 4);
  EXPECT_EQ(plan.frames_per_block, 5);
  EXPECT_LE(plan_self_check(0, 8 * ns_per_s).frames_per_block, 2000);
}

TEST(SelfCheckPlan, ShrinksTheImageSoThatTheFewestFramesFit) {
  EXPECT_EQ(self_check_image_factor(ns_per_ms, 8 * ns_per_s), 1.0);
  EXPECT_EQ(self_check_image_factor(0, 8 * ns_per_s), 1.0);
  // 80 frames of 0.4 s are 32 s, four times too many: half as wide and half as high.
  EXPECT_DOUBLE_EQ(self_check_image_factor(400 * ns_per_ms, 8 * ns_per_s), 0.5);
}

}  // namespace
}  // namespace energyprof::app
