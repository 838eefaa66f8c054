// Decimal numbers become the nearest float: compared with strtof, digit for digit.
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <array>
#include <bit>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <random>
#include <string>

#include "accel/mesh_reader.h"

namespace energyprof::accel {
namespace {

/// What scan_float() makes of a text that it should read to the end; NaN if it does not.
float scanned(const std::string& text) {
  float value = 0;
  const char* const stop = scan_float(text.data(), text.data() + text.size(), value);
  return stop == text.data() + text.size() ? value : std::numeric_limits<float>::quiet_NaN();
}

void expect_as_strtof(const std::string& text) {
  const float expected = std::strtof(text.c_str(), nullptr);
  if (std::isinf(expected)) {
    EXPECT_TRUE(std::isnan(scanned(text))) << text;
  } else {
    EXPECT_EQ(std::bit_cast<uint32_t>(scanned(text)), std::bit_cast<uint32_t>(expected)) << text;
  }
}

TEST(ScanFloat, RoundsAsStrtofDoesWhereItIsHard) {
  for (const char* text :
       {"0", "-0", "0.0", "-0.000", "1", "+1", "1.", ".5", "-.5", "1e5", "1E+5", "1e-5", "12345678",
        "123456789", "1234567890123456789", "12345678901234567890", "0.1", "0.3", "16777217",
        // just between two floats: 2^24 + 1, and a little to both sides of it
        "16777217.0000000000000000001", "16777216.9999999999999999999", "33554433", "33554435",
        "0.500000029802322387695312", "0.5000000298023223876953125",
        "0.50000002980232238769531250001",
        // a double that rounds onto the midpoint of two floats while the number is not on it
        "1.00000017881393432617187499", "1.00000017881393432617187500",
        "1.00000017881393432617187501",
        // the ends of the range
        "3.4028234e38", "3.4028235e38", "3.40282356e38", "3.40282357e38", "1.17549435e-38",
        "1.1754942e-38", "1.4e-45", "0.7e-45", "0.70064923216240853e-45", "0.70064923216240854e-45",
        "1e-46", "1e-400", "-1e-400", "0e999", "1e39", "1e400", "-1e39",
        "0.00000000000000000000000000000000000000000000000000000000000000001e20",
        "100000000000000000000000000000000000000000000e-10", "123456789012345678901234567890"}) {
    expect_as_strtof(text);
  }
}

TEST(ScanFloat, RefusesWhatIsNotAFiniteNumber) {
  for (const char* text :
       {"",    "-",  "+",   ".",    "-.",  "e5",  "nan",  "inf", "-inf",  "NaN", "infinity",
        "abc", "1e", "1e+", "0x10", "--1", "+-1", "1..2", "1,5", "1e5.5", "-+1"}) {
    EXPECT_TRUE(std::isnan(scanned(text))) << text;
  }
}

TEST(ScanFloat, StopsAtTheEndOfTheTextItIsGiven) {
  const std::string text = "12345678901234567";  // no terminator within reach is looked at
  for (size_t length = 1; length <= text.size(); ++length) {
    float value = 0;
    EXPECT_EQ(scan_float(text.data(), text.data() + length, value), text.data() + length);
    EXPECT_EQ(value, std::strtof(text.substr(0, length).c_str(), nullptr)) << length;
  }
}

TEST(ScanFloat, RoundsAsStrtofDoesForMidpointsOfFloats) {
  constexpr unsigned seed = 1;
  SCOPED_TRACE(seed);
  std::mt19937 random(seed);
  for (int i = 0; i < 20000; ++i) {
    const auto bits = static_cast<uint32_t>(random()) & 0x7fffffff;
    const float low = std::bit_cast<float>(bits);
    const float high = std::bit_cast<float>(bits + 1);
    if (!std::isfinite(low) || !std::isfinite(high)) continue;
    std::array<char, 400> text{};
    const int digits = std::array{17, 19, 25, 60}[random() % 4];
    std::snprintf(text.data(), text.size(), "%.*e", digits, 0.5 * (double{low} + double{high}));
    expect_as_strtof(text.data());
    std::snprintf(text.data(), text.size(), "%.9g", double{low});
    expect_as_strtof(text.data());
    EXPECT_EQ(std::bit_cast<uint32_t>(scanned(text.data())), bits)
        << text.data();  // 9 digits suffice
  }
}

RC_GTEST_PROP(ScanFloat, RoundsAsStrtofDoesForAnyDigits,
              (bool negative, uint64_t before, uint64_t after)) {
  const int zeros = *rc::gen::inRange(0, 30);
  const int exponent = *rc::gen::inRange(-60, 45);
  const uint64_t limit = *rc::gen::element<uint64_t>(10, 100000, ~uint64_t{0});
  std::string text =
      fmt::format("{}{}.{:0>{}}{}", negative ? "-" : "", before % limit, "", zeros, after);
  if (*rc::gen::arbitrary<bool>()) text += fmt::format("e{}", exponent);
  expect_as_strtof(text);
  RC_ASSERT(!::testing::Test::HasFailure());
}

RC_GTEST_PROP(ScanDigits, ReadsWhatFollowsAsOneNumber, (uint32_t number)) {
  const std::string tail =
      *rc::gen::element<std::string>("", " ", "/7", ".", "\xff\xff\xff", "-1", "\n1 2 3 4 5");
  const std::string text = std::to_string(number) + tail;
  uint64_t value = 0;
  const char* const stop = scan_digits(text.data(), text.data() + text.size(), value);
  RC_ASSERT(value == number);
  RC_ASSERT(stop == text.data() + text.size() - tail.size());
}

}  // namespace
}  // namespace energyprof::accel
