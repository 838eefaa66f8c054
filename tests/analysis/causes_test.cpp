#include "analysis/causes.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "scores.h"

namespace energyprof::analysis {
namespace {

using synthetic::Effect;
using synthetic::Options;
using synthetic::Scores;

const std::set<Effect> all_effects{Effect::power, Effect::thermal, Effect::external,
                                   Effect::quota, Effect::cache,   Effect::preemption,
                                   Effect::work};

Scores scores_of(Options options, uint64_t first_seed, uint64_t last_seed) {
  Scores scores;
  for (uint64_t seed = first_seed; seed <= last_seed; ++seed) {
    options.seed = seed;
    scores.add(synthetic::make_run(options));
  }
  fmt::print("{}", scores.text());
  return scores;
}

TEST(Causes, AreNamedRightOver210RunsWhoseSensorsCoverThem) {
  const Scores scores = scores_of({.effects = all_effects}, 1, 210);
  EXPECT_GE(scores.macro_f1(), 0.95);
  EXPECT_LE(scores.wrong_ratio(), 0.02);
  EXPECT_GE(scores.recall(), 0.97);
  EXPECT_GE(scores.precision(), 0.97);
}

TEST(Causes, AreNamedRightWithoutAClockOver70Runs) {
  const Scores scores = scores_of({.effects = all_effects, .clock = false}, 301, 370);
  EXPECT_GE(scores.macro_f1(), 0.90);
  EXPECT_LE(scores.wrong_ratio(), 0.03);
}

TEST(Causes, AreInferredWithoutReasonFlagsOver70Runs) {
  const Scores scores = scores_of({.effects = all_effects, .reason_flags = false}, 401, 470);
  EXPECT_LE(scores.wrong_ratio(), 0.02);
}

TEST(Causes, StayUnexplainedRatherThanWrongWithoutTheirSensor) {
  {
    SCOPED_TRACE("no reason flags, no limits");
    EXPECT_LE(scores_of({.effects = all_effects, .reason_flags = false, .limits = false}, 501, 550)
                  .wrong_ratio(),
              0.02);
  }
  {
    SCOPED_TRACE("no reason flags, no limits, no clock");
    EXPECT_LE(scores_of({.effects = {Effect::power, Effect::thermal, Effect::external},
                         .reason_flags = false,
                         .clock = false,
                         .limits = false},
                        551, 600)
                  .wrong_ratio(),
              0.02);
  }
  {
    SCOPED_TRACE("no cache counter");
    EXPECT_LE(
        scores_of({.effects = {Effect::cache}, .cache_counter = false}, 601, 650).wrong_ratio(),
        0.02);
  }
  {
    SCOPED_TRACE("no cache counter, no clock");
    EXPECT_LE(
        scores_of({.effects = {Effect::cache}, .clock = false, .cache_counter = false}, 651, 700)
            .wrong_ratio(),
        0.02);
  }
  {
    SCOPED_TRACE("no interference counters");
    EXPECT_LE(
        scores_of({.effects = {Effect::preemption, Effect::quota}, .interference = false}, 701, 750)
            .wrong_ratio(),
        0.02);
  }
  {
    SCOPED_TRACE("slow reason flags");
    EXPECT_LE(scores_of({.effects = all_effects, .slow_flags = true}, 751, 800).wrong_ratio(),
              0.02);
  }
}

}  // namespace
}  // namespace energyprof::analysis
