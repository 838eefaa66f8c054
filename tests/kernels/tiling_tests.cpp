// How many rows the next dispatch gets.
#include "kernels/tiling.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

namespace energyprof::kernels {
namespace {

TEST(Tiling, GrowsToTheWholeImageWhenDispatchesAreShort) {
  EXPECT_EQ(next_rows_per_dispatch(32, 1 * ns_per_ms, 8, 720), 720u);
}

TEST(Tiling, GrowsToHalfOfWhatIsAllowed) {
  // 32 rows in 10 ms: 400 rows in 125 ms.
  EXPECT_EQ(next_rows_per_dispatch(32, 10 * ns_per_ms, 8, 720), 400u);
}

TEST(Tiling, ShrinksAfterADispatchThatWasTooLong) {
  // 720 rows in 1 s: 90 rows in 125 ms, rounded down to workgroups.
  EXPECT_EQ(next_rows_per_dispatch(720, ns_per_s, 8, 720), 88u);
}

TEST(Tiling, StaysWhereADispatchIsNeitherLongNorShort) {
  EXPECT_EQ(next_rows_per_dispatch(400, 125 * ns_per_ms, 8, 720), 400u);
  EXPECT_EQ(next_rows_per_dispatch(400, 249 * ns_per_ms, 8, 720), 400u);
}

TEST(Tiling, NeverGoesBelowOneWorkgroupNorAboveTheImage) {
  EXPECT_EQ(next_rows_per_dispatch(8, 60 * ns_per_s, 8, 720), 8u);
  EXPECT_EQ(next_rows_per_dispatch(5, 60 * ns_per_s, 8, 5), 5u);
  EXPECT_EQ(next_rows_per_dispatch(16, 0, 8, 20), 20u);
}

RC_GTEST_PROP(Tiling, SettlesBelowTheLimit, ()) {
  // An image whose rows all cost the same, up to 20 ms each.
  const auto height = *rc::gen::inRange<uint32_t>(1, 5000);
  const auto row_ns = *rc::gen::inRange<int64_t>(1, 20 * ns_per_ms);
  const uint32_t step = 8;
  uint32_t rows = std::min(first_rows_per_dispatch, height);
  for (int frame = 0; frame < 3; ++frame) {
    rows = next_rows_per_dispatch(rows, rows * row_ns, step, height);
  }
  RC_ASSERT(rows * row_ns <= longest_dispatch_ns);
  RC_ASSERT(next_rows_per_dispatch(rows, rows * row_ns, step, height) == rows);
}

}  // namespace
}  // namespace energyprof::kernels
