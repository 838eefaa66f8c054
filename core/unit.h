/// Units and quantities of channels: the only table of them in the project.
#pragma once

#include <cstdint>
#include <optional>
#include <string_view>

namespace energyprof {

/// What a channel measures. The names are those of the run database (contract: channels.quantity).
enum class Quantity : uint8_t {
  energy,
  power,
  frequency,
  temperature,
  throttle,
  cache_miss,
  memory_traffic,
  utilization,
  interference,
  limit,
};

/// How successive values relate.
enum class Kind : uint8_t {
  cumulative,  ///< a counter: only differences mean something; it may wrap at Channel::wrap_at
  gauge,       ///< the value at the moment of reading
  average,     ///< a value the device has already averaged over some time
  flag,        ///< 0 or 1
};

/// The unit in which a sensor reports. Values are recorded in it and converted once, in analysis.
enum class Unit : uint8_t {
  none,
  nanojoule,
  microjoule,
  millijoule,
  joule,
  microwatt,
  milliwatt,
  watt,
  kilohertz,
  megahertz,
  gigahertz,
  hertz,
  millicelsius,
  centicelsius,
  celsius,
  millivolt,
  volt,
  milliampere,
  ampere,
  nanosecond,
  microsecond,
  millisecond,
  second,
  clock_tick,  ///< USER_HZ, 1/100 s on Linux
  byte,
  kilobyte,
  megabyte,
  gigabyte,
  kibibyte,
  mebibyte,
  gibibyte,
  byte_per_second,
  kilobyte_per_second,
  megabyte_per_second,
  gigabyte_per_second,
  mebibyte_per_second,
  gibibyte_per_second,
  count,
  percent,
  permille,
  centipercent,
  ppm,
};

struct UnitInfo {
  Unit unit;
  std::string_view name;  ///< as stored in channels.unit
  std::string_view si;    ///< the SI unit it converts to
  double to_si;           ///< factor to `si`
};

/// Symbol and factor of `unit`.
const UnitInfo& unit_info(Unit unit);
/// The unit whose stored name is `name`, or that other tools call so: "bytes", "degC", "jiffies",
/// "usec", with or without a micro sign. Case counts in symbols (mW, MW). nullopt for a name this
/// version does not know.
std::optional<Unit> parse_unit(std::string_view name);

std::string_view to_string(Quantity quantity);
std::optional<Quantity> parse_quantity(std::string_view name);
std::string_view to_string(Kind kind);
std::optional<Kind> parse_kind(std::string_view name);

}  // namespace energyprof
