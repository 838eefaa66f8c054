#include "analysis/analyze.h"
#include <gtest/gtest.h>
#include <fmt/format.h>
#include "scores.h"
namespace energyprof::analysis {
TEST(Dbg, PerRun) {
  using synthetic::Effect;
  for (uint64_t seed=1; seed<=60; ++seed) {
    synthetic::Options o{.effects = {Effect::power, Effect::thermal, Effect::external, Effect::quota, Effect::cache, Effect::preemption, Effect::work}};
    o.seed=seed;
    const auto made=synthetic::make_run(o);
    synthetic::Scores s; s.add(made);
    const Analysis a = analyze(made.run);
    const auto frames = timed_frames(made.run, a.cells);
    const auto t = find_throttling(made.run, frames);
    if(s.missed<10) continue;
    fmt::print("{} hit {} missed {}\n", made.description, s.hit, s.missed);
    for (auto& q : t.sources) fmt::print("   {} {} inferred {} exposure {:.3f} chance {:.3f} spans {}\n", made.run.channels[q.channel].name, to_string(q.reason), q.inferred, q.exposure_ratio, q.chance_ratio, q.active.spans().size());
    for (int k=0;k<3;++k) { for (auto n: s.confusion[k]) fmt::print(" {}", n); fmt::print("\n"); }
  }
}
}
