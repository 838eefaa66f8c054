/// The prefixes of the International System of Units.
#pragma once

#include <string_view>

namespace energyprof::analysis {

struct Prefix {
  double factor = 1;
  std::string_view symbol;
};

/// The prefix with which a value of this size (0 or more) has one to three digits before the point;
/// none for 0, pico for what is smaller still.
Prefix prefix_of(double size);

/// How many decimals make three digits of a number from 1 to 999.
int three_digit_decimals(double size);

}  // namespace energyprof::analysis
