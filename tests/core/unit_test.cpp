// Names of units, quantities and kinds survive the way into the database and back.
#include "core/unit.h"

#include <gtest/gtest.h>

#include <set>

namespace energyprof {
namespace {

TEST(Unit, EveryNameIsUniqueAndParsesBack) {
  std::set<std::string_view> names;
  for (int i = 0; i <= static_cast<int>(Unit::permille); ++i) {
    const auto unit = static_cast<Unit>(i);
    const UnitInfo& info = unit_info(unit);
    EXPECT_EQ(info.unit, unit);
    EXPECT_TRUE(names.insert(info.name).second) << info.name;
    EXPECT_EQ(parse_unit(info.name), unit);
    EXPECT_GT(info.to_si, 0.0);
  }
  EXPECT_EQ(parse_unit("furlong"), std::nullopt);
  // Not those of any sensor here, but other tools write them.
  for (const std::string_view name : {"J", "s", "GHz"}) EXPECT_TRUE(parse_unit(name)) << name;
}

TEST(Unit, QuantitiesAndKindsAreThoseOfTheRunFormat) {
  for (const std::string_view name :
       {"energy", "power", "frequency", "temperature", "throttle", "cache_miss", "memory_traffic",
        "utilization", "interference", "limit"}) {
    ASSERT_TRUE(parse_quantity(name)) << name;
    EXPECT_EQ(to_string(*parse_quantity(name)), name);
  }
  for (const std::string_view name : {"cumulative", "gauge", "average", "flag"}) {
    ASSERT_TRUE(parse_kind(name)) << name;
    EXPECT_EQ(to_string(*parse_kind(name)), name);
  }
  EXPECT_EQ(parse_quantity("Energy"), std::nullopt);
  EXPECT_EQ(parse_kind(""), std::nullopt);
}

}  // namespace
}  // namespace energyprof
