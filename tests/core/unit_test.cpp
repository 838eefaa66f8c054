// Names of units, quantities and kinds survive the way into the database and back.
#include "core/unit.h"

#include <gtest/gtest.h>

#include <set>
#include <utility>

namespace energyprof {
namespace {

TEST(Unit, EveryNameIsUniqueAndParsesBack) {
  std::set<std::string_view> names;
  for (int i = 0; i <= static_cast<int>(Unit::ppm); ++i) {
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

TEST(Unit, ParsesWhatOtherToolsCallTheSame) {
  for (const auto& [name, unit] : {std::pair{"bytes", Unit::byte},
                                   {"MiB", Unit::mebibyte},
                                   {"J", Unit::joule},
                                   {"Joules", Unit::joule},
                                   {"\u00b5J", Unit::microjoule},
                                   {"\u03bcs", Unit::microsecond},
                                   {"\u00b0C", Unit::celsius},
                                   {"m\u00b0C", Unit::millicelsius},
                                   {"degC", Unit::celsius},
                                   {"millidegC", Unit::millicelsius},
                                   {"GHz", Unit::gigahertz},
                                   {"mhz", Unit::megahertz},
                                   {"usec", Unit::microsecond},
                                   {"s", Unit::second},
                                   {"seconds", Unit::second},
                                   {"jiffies", Unit::clock_tick},
                                   {"ticks", Unit::clock_tick},
                                   {"GB/s", Unit::gigabyte_per_second},
                                   {"events", Unit::count},
                                   {"misses", Unit::count},
                                   {"percent", Unit::percent},
                                   {"bool", Unit::none}})
    EXPECT_EQ(parse_unit(name), unit) << name;
  EXPECT_EQ(parse_unit("MJ"), std::nullopt) << "a megajoule is no millijoule";
  EXPECT_EQ(parse_unit("MW"), std::nullopt);
  EXPECT_EQ(parse_unit(""), std::nullopt);
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
