#include "analysis/format.h"

#include <fmt/format.h>

#include <array>
#include <cmath>

#include "core/unit.h"

namespace energyprof::analysis {
namespace {

struct Prefix {
  double factor;
  std::string_view symbol;
};
constexpr std::array prefixes{Prefix{1e12, "T"}, Prefix{1e9, "G"},  Prefix{1e6, "M"},
                              Prefix{1e3, "k"},  Prefix{1, ""},     Prefix{1e-3, "m"},
                              Prefix{1e-6, "µ"}, Prefix{1e-9, "n"}, Prefix{1e-12, "p"}};

/// Three significant digits of a value from 1 to 999, trailing zeros kept.
std::string three_digits(double value) {
  const double size = std::fabs(value);
  const int decimals = size >= 99.95 ? 0 : size >= 9.995 ? 1 : 2;
  return fmt::format("{:.{}f}", value, decimals);
}

std::string plain(double value) {
  return value == std::floor(value) && std::fabs(value) < 1e15 ? fmt::format("{:.0f}", value)
                                                               : fmt::format("{:.4g}", value);
}

}  // namespace

std::string scaled(double value, std::string_view unit) {
  if (value == 0) return fmt::format("0 {}", unit);
  for (const Prefix& prefix : prefixes) {
    // 999.5 is where three digits would round up to the next prefix.
    if (std::fabs(value) >= 0.9995 * prefix.factor)
      return fmt::format("{} {}{}", three_digits(value / prefix.factor), prefix.symbol, unit);
  }
  return fmt::format("{:.3g} {}", value, unit);
}

std::string scaled_stored(double value, std::string_view stored_unit) {
  const auto unit = parse_unit(stored_unit);
  if (!unit || *unit == Unit::none)
    return stored_unit == "1" ? plain(value) : fmt::format("{} {}", plain(value), stored_unit);
  const UnitInfo& info = unit_info(*unit);
  switch (*unit) {
    case Unit::count:
      return plain(value);
    case Unit::percent:
      return fmt::format("{} %", plain(value));
    case Unit::permille:
      return fmt::format("{:.1f} %", value * 0.1);
    case Unit::celsius:
    case Unit::millicelsius:
      return fmt::format("{:.1f} °C", value * info.to_si);
    default:
      return scaled(value * info.to_si, info.si);
  }
}

AxisUnit axis_unit(std::string_view si) {
  if (si == "Hz") return {"MHz", 1e-6};
  if (si == "C") return {"°C", 1};
  if (si == "B") return {"MB", 1e-6};
  if (si == "B/s") return {"MB/s", 1e-6};
  if (si == "1" || si == "s/s") return {"%", 100};
  if (si == "count/s") return {"1/s", 1};
  return {std::string(si), 1};
}

std::string counted(std::size_t count, std::string_view noun) {
  return fmt::format("{} {}{}", count, noun, count == 1 ? "" : "s");
}

}  // namespace energyprof::analysis
