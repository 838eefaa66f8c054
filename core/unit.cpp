#include "core/unit.h"

#include <array>
#include <cassert>
#include <cctype>
#include <span>
#include <string>
#include <utility>

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
    UnitInfo{Unit::volt, "V", "V", 1.0},
    UnitInfo{Unit::milliampere, "mA", "A", 1e-3},
    UnitInfo{Unit::ampere, "A", "A", 1.0},
    UnitInfo{Unit::nanosecond, "ns", "s", 1e-9},
    UnitInfo{Unit::microsecond, "us", "s", 1e-6},
    UnitInfo{Unit::millisecond, "ms", "s", 1e-3},
    UnitInfo{Unit::second, "s", "s", 1.0},
    UnitInfo{Unit::clock_tick, "tick", "s", 1e-2},
    UnitInfo{Unit::byte, "B", "B", 1.0},
    UnitInfo{Unit::kilobyte, "kB", "B", 1e3},
    UnitInfo{Unit::megabyte, "MB", "B", 1e6},
    UnitInfo{Unit::gigabyte, "GB", "B", 1e9},
    UnitInfo{Unit::kibibyte, "KiB", "B", 0x1p10},
    UnitInfo{Unit::mebibyte, "MiB", "B", 0x1p20},
    UnitInfo{Unit::gibibyte, "GiB", "B", 0x1p30},
    UnitInfo{Unit::byte_per_second, "B/s", "B/s", 1.0},
    UnitInfo{Unit::kilobyte_per_second, "kB/s", "B/s", 1e3},
    UnitInfo{Unit::megabyte_per_second, "MB/s", "B/s", 1e6},
    UnitInfo{Unit::gigabyte_per_second, "GB/s", "B/s", 1e9},
    UnitInfo{Unit::mebibyte_per_second, "MiB/s", "B/s", 0x1p20},
    UnitInfo{Unit::gibibyte_per_second, "GiB/s", "B/s", 0x1p30},
    UnitInfo{Unit::count, "count", "count", 1.0},
    UnitInfo{Unit::percent, "%", "1", 1e-2},
    UnitInfo{Unit::permille, "permille", "1", 1e-3},
    UnitInfo{Unit::centipercent, "c%", "1", 1e-4},
    UnitInfo{Unit::ppm, "ppm", "1", 1e-6},
};

struct Spelling {
  std::string_view text;
  Unit unit;
};

/// Symbols that other tools write. Case counts: mW is not MW.
constexpr std::array symbols{
    Spelling{"uj", Unit::microjoule},
    Spelling{"mj", Unit::millijoule},
    Spelling{"uw", Unit::microwatt},
    Spelling{"mw", Unit::milliwatt},
    Spelling{"khz", Unit::kilohertz},
    Spelling{"KHz", Unit::kilohertz},
    Spelling{"mhz", Unit::megahertz},
    Spelling{"Mhz", Unit::megahertz},
    Spelling{"ghz", Unit::gigahertz},
    Spelling{"hz", Unit::hertz},
    Spelling{"mdeg", Unit::millicelsius},
    Spelling{"mc", Unit::millicelsius},
    Spelling{"Cel", Unit::celsius},
    Spelling{"KB", Unit::kilobyte},
    Spelling{"KB/s", Unit::kilobyte_per_second},
};

/// Words that other tools write, in lower case and singular.
constexpr std::array words{
    Spelling{"nanojoule", Unit::nanojoule},
    Spelling{"microjoule", Unit::microjoule},
    Spelling{"millijoule", Unit::millijoule},
    Spelling{"joule", Unit::joule},
    Spelling{"microwatt", Unit::microwatt},
    Spelling{"milliwatt", Unit::milliwatt},
    Spelling{"watt", Unit::watt},
    Spelling{"hertz", Unit::hertz},
    Spelling{"degc", Unit::celsius},
    Spelling{"celsius", Unit::celsius},
    Spelling{"degree_c", Unit::celsius},
    Spelling{"degrees_c", Unit::celsius},
    Spelling{"mdegc", Unit::millicelsius},
    Spelling{"millic", Unit::millicelsius},
    Spelling{"millidegc", Unit::millicelsius},
    Spelling{"millidegree", Unit::millicelsius},
    Spelling{"millidegree_c", Unit::millicelsius},
    Spelling{"millicelsius", Unit::millicelsius},
    Spelling{"centidegc", Unit::centicelsius},
    Spelling{"centicelsius", Unit::centicelsius},
    Spelling{"nsec", Unit::nanosecond},
    Spelling{"nanosecond", Unit::nanosecond},
    Spelling{"usec", Unit::microsecond},
    Spelling{"microsecond", Unit::microsecond},
    Spelling{"msec", Unit::millisecond},
    Spelling{"millisecond", Unit::millisecond},
    Spelling{"sec", Unit::second},
    Spelling{"second", Unit::second},
    Spelling{"jiffie", Unit::clock_tick},
    Spelling{"jiffy", Unit::clock_tick},
    Spelling{"tick", Unit::clock_tick},
    Spelling{"clock_tick", Unit::clock_tick},
    Spelling{"user_hz", Unit::clock_tick},
    Spelling{"byte", Unit::byte},
    Spelling{"bytes/s", Unit::byte_per_second},
    Spelling{"count", Unit::count},
    Spelling{"event", Unit::count},
    Spelling{"misse", Unit::count},
    Spelling{"number", Unit::count},
    Spelling{"percent", Unit::percent},
    Spelling{"pct", Unit::percent},
    Spelling{"ratio", Unit::none},
    Spelling{"fraction", Unit::none},
    Spelling{"bool", Unit::none},
    Spelling{"boolean", Unit::none},
    Spelling{"flag", Unit::none},
};

std::optional<Unit> find_spelling(std::span<const Spelling> table, std::string_view text) {
  for (const Spelling& spelling : table)
    if (spelling.text == text) return spelling.unit;
  return std::nullopt;
}

/// `name` with both micro signs as "u" and without degree signs.
std::string in_ascii(std::string_view name) {
  std::string text(name);
  for (const auto& [from, to] : {std::pair<std::string_view, std::string_view>{"\u00b5", "u"},
                                 {"\u03bc", "u"},
                                 {"\u00b0", ""}})
    for (std::size_t at = text.find(from); at != std::string::npos; at = text.find(from))
      text.replace(at, from.size(), to);
  return text;
}

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
  const std::string text = in_ascii(name);
  for (const UnitInfo& info : unit_table)
    if (info.name == text) return info.unit;
  if (const auto unit = find_spelling(symbols, text)) return unit;
  std::string word = text;
  for (char& c : word)
    c = c == ' ' ? '_' : static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  if (word.size() <= 2) return std::nullopt;
  if (const auto unit = find_spelling(words, word)) return unit;
  if (word.back() == 's') word.pop_back();
  return find_spelling(words, word);
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
