#include "analysis/format.h"

#include <gtest/gtest.h>

namespace energyprof::analysis {
namespace {

TEST(Format, ScalesToThreeDigits) {
  EXPECT_EQ(scaled(0.0031, "s"), "3.10 ms");
  EXPECT_EQ(scaled(0.0312, "s"), "31.2 ms");
  EXPECT_EQ(scaled(0.312, "s"), "312 ms");
  EXPECT_EQ(scaled(3.1e-9, "J"), "3.10 nJ");
  EXPECT_EQ(scaled(-2.5e6, "Hz"), "-2.50 MHz");
  EXPECT_EQ(scaled(0, "W"), "0 W");
}

TEST(Format, RoundsUpIntoTheNextPrefix) {
  EXPECT_EQ(scaled(999.6e-6, "s"), "1.00 ms");
  EXPECT_EQ(scaled(999.4e-6, "s"), "999 µs");
  EXPECT_EQ(scaled(9.996, "W"), "10.0 W");
  EXPECT_EQ(scaled(99.96, "W"), "100 W");
}

TEST(Format, ScalesWhatSensorsStore) {
  EXPECT_EQ(scaled_stored(34'100'000, "uJ"), "34.1 J");
  EXPECT_EQ(scaled_stored(1'300, "MHz"), "1.30 GHz");
  EXPECT_EQ(scaled_stored(52'500, "mC"), "52.5 °C");
  EXPECT_EQ(scaled_stored(5250, "cC"), "52.5 °C");
  EXPECT_EQ(scaled_stored(1, "1"), "1");
  EXPECT_EQ(scaled_stored(12, "count"), "12");
  EXPECT_EQ(scaled_stored(40, "%"), "40 %");
  EXPECT_EQ(scaled_stored(1'000'000, "ppm"), "100 %");
  EXPECT_EQ(scaled_stored(2.5, "furlong"), "2.5 furlong");
}

TEST(Format, CountsInWords) {
  EXPECT_EQ(counted(1, "frame"), "1 frame");
  EXPECT_EQ(counted(0, "frame"), "0 frames");
}

TEST(Format, AxesHaveHandyUnits) {
  EXPECT_EQ(axis_unit("Hz").name, "MHz");
  EXPECT_DOUBLE_EQ(axis_unit("Hz").factor, 1e-6);
  EXPECT_EQ(axis_unit("s/s").name, "%");
  EXPECT_EQ(axis_unit("furlong/s").name, "furlong/s");
}

}  // namespace
}  // namespace energyprof::analysis
