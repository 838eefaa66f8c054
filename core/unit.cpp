#include "core/unit.h"

#include <array>
#include <cassert>

namespace energyprof {
namespace {

constexpr std::array unit_table{
    UnitInfo{Unit::none, "1", "1", 1.0},
    UnitInfo{Unit::nanojoule, "nJ", "J", 1e-9},
    UnitInfo{Unit::microjoule, "uJ", "J", 1e-6},
    UnitInfo{Unit::millijoule, "mJ", "J", 1e-3},
    UnitInfo{Unit::joule, "J", "J", 1.0},
    UnitInfo{Unit::microwatt, "uW", "W", 1e-6},
    UnitInfo{Unit::milliwatt, "mW", "W", 1e-3},
    UnitInfo{Unit::watt, "W", "W", 1.0},
    UnitInfo{Unit::kilohertz, "kHz", "Hz", 1e3},
    UnitInfo{Unit::megahertz, "MHz", "Hz", 1e6},
    UnitInfo{Unit::gigahertz, "GHz", "Hz", 1e9},
    UnitInfo{Unit::hertz, "Hz", "Hz", 1.0},
    UnitInfo{Unit::millicelsius, "mC", "C", 1e-3},
    UnitInfo{Unit::centicelsius, "cC", "C", 1e-2},
    UnitInfo{Unit::celsius, "C", "C", 1.0},
    UnitInfo{Unit::millivolt, "mV", "V", 1e-3},
    UnitInfo{Unit::milliampere, "mA", "A", 1e-3},
    UnitInfo{Unit::nanosecond, "ns", "s", 1e-9},
    UnitInfo{Unit::microsecond, "us", "s", 1e-6},
    UnitInfo{Unit::millisecond, "ms", "s", 1e-3},
    UnitInfo{Unit::second, "s", "s", 1.0},
    UnitInfo{Unit::clock_tick, "tick", "s", 1e-2},
    UnitInfo{Unit::byte, "B", "B", 1.0},
    UnitInfo{Unit::byte_per_second, "B/s", "B/s", 1.0},
    UnitInfo{Unit::megabyte_per_second, "MB/s", "B/s", 1e6},
    UnitInfo{Unit::count, "count", "count", 1.0},
    UnitInfo{Unit::percent, "%", "1", 1e-2},
    UnitInfo{Unit::permille, "permille", "1", 1e-3},
    UnitInfo{Unit::centipercent, "c%", "1", 1e-4},
    UnitInfo{Unit::ppm, "ppm", "1", 1e-6},
};

constexpr std::array<std::string_view, 10> quantity_names{
    "energy",     "power",          "frequency",   "temperature",  "throttle",
    "cache_miss", "memory_traffic", "utilization", "interference", "limit"};

constexpr std::array<std::string_view, 4> kind_names{"cumulative", "gauge", "average", "flag"};

template <class Enum, std::size_t N>
std::optional<Enum> parse_enum(const std::array<std::string_view, N>& names,
                               std::string_view name) {
  for (std::size_t i = 0; i < N; ++i)
    if (names[i] == name) return static_cast<Enum>(i);
  return std::nullopt;
}

}  // namespace

const UnitInfo& unit_info(Unit unit) {
  const UnitInfo& info = unit_table[static_cast<std::size_t>(unit)];
  assert(info.unit == unit);
  return info;
}

std::optional<Unit> parse_unit(std::string_view name) {
  for (const UnitInfo& info : unit_table)
    if (info.name == name) return info.unit;
  return std::nullopt;
}

std::string_view to_string(Quantity quantity) {
  return quantity_names[static_cast<std::size_t>(quantity)];
}

std::optional<Quantity> parse_quantity(std::string_view name) {
  return parse_enum<Quantity>(quantity_names, name);
}

std::string_view to_string(Kind kind) { return kind_names[static_cast<std::size_t>(kind)]; }

std::optional<Kind> parse_kind(std::string_view name) { return parse_enum<Kind>(kind_names, name); }

}  // namespace energyprof
