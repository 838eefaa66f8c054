#include "analysis/format.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cmath>

#include "analysis/prefix.h"
#include "core/unit.h"

namespace energyprof::analysis {
namespace {

/// Three significant digits of a value from 1 to 999, trailing zeros kept.
std::string three_digits(double value) {
  return fmt::format("{:.{}f}", value, three_digit_decimals(std::fabs(value)));
}

std::string plain(double value) {
  return value == std::floor(value) && std::fabs(value) < 1e15 ? fmt::format("{:.0f}", value)
                                                               : fmt::format("{:.4g}", value);
}

}  // namespace

std::string scaled(double value, std::string_view unit) {
  if (value == 0) return fmt::format("0 {}", unit);
  const Prefix prefix = prefix_of(std::fabs(value));
  if (std::fabs(value) < prefix.factor * 0.9995) return fmt::format("{:.3g} {}", value, unit);
  return fmt::format("{} {}{}", three_digits(value / prefix.factor), prefix.symbol, unit);
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
    case Unit::centicelsius:
    case Unit::millicelsius:
      return fmt::format("{:.1f} °C", value * info.to_si);
    default:
      if (info.si == "1") return fmt::format("{} %", plain(100 * value * info.to_si));
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

std::string lower_case(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return text;
}

std::string counted(std::size_t count, std::string_view noun) {
  return fmt::format("{} {}{}", count, noun, count == 1 ? "" : "s");
}

}  // namespace energyprof::analysis
