/// Numbers and words for people: the only place where units are scaled.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

namespace energyprof::analysis {

/// `value` of an SI unit with three significant digits and the prefix that suits it, from pico to
/// tera: scaled(0.0031, "s") is "3.10 ms". Bytes are scaled by 1000 as well ("kB").
std::string scaled(double value, std::string_view unit);

/// `value` as a sensor with this stored unit gave it ("uJ", "kHz", ...), scaled for people. Units
/// this version does not know are kept as they are.
std::string scaled_stored(double value, std::string_view stored_unit);

/// The unit a chart's axis has, and the factor to it.
struct AxisUnit {
  std::string name;
  double factor = 1;
};
/// The axis for values in `si` ("Hz" gives MHz, "1" gives %); other units stay as they are.
AxisUnit axis_unit(std::string_view si);

/// ASCII letters in lower case: names that others wrote.
std::string lower_case(std::string text);

/// "1 frame", "2 frames".
std::string counted(std::size_t count, std::string_view noun);

}  // namespace energyprof::analysis
