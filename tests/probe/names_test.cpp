// Channel names and natural order.
#include "probe/names.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <string>

namespace energyprof::probe {
namespace {

TEST(Slug, KeepsWhatDistinguishesAndDropsTheRest) {
  EXPECT_EQ(slug("Package id 0"), "package_id_0");
  EXPECT_EQ(slug("VDD_CPU_GPU_CV"), "vdd_cpu_gpu_cv");
  EXPECT_EQ(slug("package-0"), "package-0");
  EXPECT_EQ(slug("  a..b  "), "a_b");
  EXPECT_EQ(slug("0000:c4:00.0"), "0000:c4:00_0");
  EXPECT_EQ(slug(""), "unnamed");
  EXPECT_EQ(slug("\xC2\xB0"), "unnamed");
}

TEST(Slug, IsNeverLong) {
  EXPECT_EQ(slug(std::string(100'000, 'x')), std::string(64, 'x'));
  EXPECT_EQ(slug(std::string(63, 'x') + " y"), std::string(63, 'x'));
}

TEST(Shown, IsOneShortPrintableLine) {
  EXPECT_EQ(shown("fast\nfaster\n"), "fast");
  EXPECT_EQ(shown(std::string_view("a\0\xff\tb", 5)), "a???b");
  EXPECT_EQ(shown(std::string(60, 'x')), std::string(60, 'x'));
  EXPECT_EQ(shown(std::string(61, 'x')), std::string(60, 'x') + "...");
  EXPECT_EQ(shown(""), "");
}

TEST(Numbered, IsAPrefixAndDigits) {
  EXPECT_TRUE(is_numbered("cpu12", "cpu"));
  for (const char* text : {"cpu", "cpu1x", "cpufreq", "xcpu1", "", "cp"})
    EXPECT_FALSE(is_numbered(text, "cpu")) << text;
}

RC_GTEST_PROP(Slug, IsStableAndFitsADottedName, (const std::string& text)) {
  const std::string once = slug(text);
  RC_ASSERT(!once.empty());
  RC_ASSERT(once.find('.') == std::string::npos);
  RC_ASSERT(slug(once) == once);
}

TEST(NaturalOrder, ComparesRunsOfDigitsAsNumbers) {
  EXPECT_TRUE(natural_less("cpu2", "cpu12"));
  EXPECT_FALSE(natural_less("cpu12", "cpu2"));
  EXPECT_TRUE(natural_less("intel-rapl:0", "intel-rapl:0:1"));
  EXPECT_TRUE(natural_less("intel-rapl:9", "intel-rapl:a"));
  EXPECT_FALSE(natural_less("a1", "a1"));
  EXPECT_TRUE(natural_less("a01", "a1") != natural_less("a1", "a01"));
  EXPECT_TRUE(natural_less("x18446744073709551616", "x18446744073709551617"));
}

RC_GTEST_PROP(NaturalOrder, OfNumberedThingsIsThatOfTheirNumbers, (uint32_t a, uint32_t b)) {
  RC_ASSERT(natural_less("cpu" + std::to_string(a), "cpu" + std::to_string(b)) == (a < b));
}

RC_GTEST_PROP(NaturalOrder, IsTotal, (const std::string& a, const std::string& b)) {
  RC_ASSERT((natural_less(a, b) || natural_less(b, a)) == (a != b));
  RC_ASSERT(!(natural_less(a, b) && natural_less(b, a)));
}

}  // namespace
}  // namespace energyprof::probe
