#include "analysis/prefix.h"

#include <array>

namespace energyprof::analysis {

Prefix prefix_of(double size) {
  constexpr std::array prefixes{Prefix{1e12, "T"}, Prefix{1e9, "G"},  Prefix{1e6, "M"},
                                Prefix{1e3, "k"},  Prefix{1, ""},     Prefix{1e-3, "m"},
                                Prefix{1e-6, "µ"}, Prefix{1e-9, "n"}, Prefix{1e-12, "p"}};
  if (size == 0) return {};
  // 999.5 is where three digits would round up to the next prefix.
  for (const Prefix& prefix : prefixes)
    if (size >= 0.9995 * prefix.factor) return prefix;
  return prefixes.back();
}

int three_digit_decimals(double size) { return size >= 99.95 ? 0 : size >= 9.995 ? 1 : 2; }

}  // namespace energyprof::analysis
