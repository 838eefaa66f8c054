// How well outliers and their causes are found on synthetic runs with planted truth: recall,
// precision, confusion matrix, and how often a stated confidence is right. Usage: attribution_bench
// [RUNS]
#include <fmt/format.h>

#include <cstdlib>

#include "tests/analysis/scores.h"

namespace {

using namespace energyprof::analysis::synthetic;

void print(const char* title, Options options, uint64_t run_count) {
  Scores scores;
  for (uint64_t seed = 1; seed <= run_count; ++seed) {
    options.seed = seed;
    scores.add(make_run(options));
  }
  fmt::print("{}\n{}\n", title, scores.text());
}

}  // namespace

int main(int argc, char** argv) {
  const uint64_t run_count = argc > 1 ? std::strtoull(argv[1], nullptr, 10) : 200;
  using enum Effect;
  const std::set<Effect> all{power, thermal, external, quota, cache, preemption, work};
  print("all sensors", {.effects = all}, run_count);
  print("no clock", {.effects = all, .clock = false}, run_count);
  print("no reason flags", {.effects = all, .reason_flags = false}, run_count);
  print("no reason flags, no limits", {.effects = all, .reason_flags = false, .limits = false},
        run_count);
  print("slow reason flags", {.effects = all, .slow_flags = true}, run_count);
  print("no cache counter", {.effects = all, .cache_counter = false}, run_count);
  print("no interference counters", {.effects = all, .interference = false}, run_count);
  print("nothing planted", {.effects = {}}, run_count);
}
