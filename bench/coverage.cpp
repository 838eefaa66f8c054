// How often the intervals of `compare` hold the ratios that were planted, and how often its gate
// goes off for no reason. Usage: coverage_bench [RUNS [FIRST_SEED]]
#include <fmt/format.h>

#include <cstdlib>

#include "tests/analysis/planted_ratios.h"

int main(int argc, char** argv) {
  using namespace energyprof::analysis::planted;
  const uint64_t run_count = argc > 1 ? std::strtoull(argv[1], nullptr, 10) : 6'000;
  const uint64_t first = argc > 2 ? std::strtoull(argv[2], nullptr, 10) : 1;
  Coverage coverage;
  for (uint64_t seed = first; seed < first + run_count; ++seed) coverage.add(scenario(seed), seed);
  fmt::print("{}", coverage.text());
}
