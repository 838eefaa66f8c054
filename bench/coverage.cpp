// How often the intervals of `compare` hold what was planted, and how often its gate goes off for
// no reason: first of bare values, then of whole runs with clock and energy. Usage: coverage_bench
// [VALUES [RUNS [FIRST_SEED]]]
#include <fmt/format.h>

#include <cmath>
#include <cstdlib>
#include <iterator>
#include <map>
#include <random>
#include <string>
#include <vector>

#include "analysis/compare.h"
#include "tests/analysis/planted_ratios.h"
#include "tests/analysis/planted_run.h"

namespace {

using namespace energyprof;
using namespace energyprof::analysis;

/// What a pair of whole runs is like.
struct Scenario {
  int repetition_count;
  int algorithm_count;
  double trial_spread;  // of work, and of power
  double idle_ratio;    // power at rest / above rest
  double clock_b;       // of A's
  bool clock_wanders;   // within a run, by 5 %
  int64_t clock_poll_ns;
  int64_t update_ns;  // of the energy counter
};

Scenario make_scenario(std::mt19937_64& random) {
  const auto one_of = [&](auto... values) {
    const std::common_type_t<decltype(values)...> all[] = {values...};
    return all[random() % std::size(all)];
  };
  Scenario s{};
  s.repetition_count = one_of(1, 2, 3);
  s.algorithm_count = one_of(1, 3);
  s.trial_spread = one_of(0.0, 0.005, 0.02);
  s.idle_ratio = one_of(0.3, 1.0, 3.0, 10.0);
  s.clock_b = one_of(1.0, 0.7);
  s.clock_wanders = one_of(false, true);
  s.clock_poll_ns = one_of(1'000'000, 10'000'000);
  s.update_ns = one_of(1'000'000, 20'000'000);
  return s;
}

/// `log_work` and `log_power` by algorithm: what its frames take more than usual.
RunRecord make_run(const Scenario& s, double clock_ghz, const std::vector<double>& log_work,
                   const std::vector<double>& log_power, std::mt19937_64& random) {
  constexpr double net_w = 10;
  struct Piece {
    int64_t begin_ns, end_ns;
    double watts, ghz;
  };
  std::normal_distribution<double> normal;
  planted::RunBuilder builder;
  std::vector<Piece> pieces;
  const double idle_w = net_w * s.idle_ratio;
  const auto idle = [&](int64_t length_ns) {
    const int64_t end_ns = builder.now_ns + length_ns;
    builder.run.events.push_back({builder.now_ns, end_ns, {}, "idle", {}, ""});
    pieces.push_back({builder.now_ns, end_ns, idle_w, clock_ghz / 2});
    builder.now_ns = end_ns;
  };
  const auto follow = [&](double& state, double rho) {
    state = rho * state + std::sqrt(1 - rho * rho) * normal(random);
    return state;
  };
  idle(1'000'000'000);
  double clock_state = 0;
  for (int repetition = 0; repetition < s.repetition_count; ++repetition)
    for (const int64_t view : {0, 1})
      for (std::size_t a = 0; a < log_work.size(); ++a) {
        const double work = log_work[a] + s.trial_spread * normal(random);
        const double power = log_power[a] + s.trial_spread * normal(random);
        double work_state = normal(random);
        double power_state = normal(random);
        std::vector<double> times_ms;
        int64_t now_ns = builder.now_ns;
        for (int i = 0; i < 60; ++i) {
          const double ghz =
              clock_ghz * (s.clock_wanders ? std::exp(0.05 * follow(clock_state, 0.95)) : 1.0);
          const double cycles = 8e6 * (1 + 0.5 * static_cast<double>(a)) *
                                (1 + 0.3 * static_cast<double>(view)) *
                                std::exp(work + 0.01 * follow(work_state, 0.5));
          times_ms.push_back(cycles / ghz * 1e-6);
          const int64_t end_ns = now_ns + std::llround(times_ms.back() * 1e6);
          pieces.push_back({now_ns, end_ns,
                            idle_w + net_w * std::exp(power + 0.03 * follow(power_state, 0.8)),
                            ghz});
          now_ns = end_ns;
        }
        builder.add_trial("m", view, fmt::format("A{}", a), times_ms).repetition = repetition;
        if (builder.now_ns > now_ns) pieces.push_back({now_ns, builder.now_ns, idle_w, clock_ghz});
        idle(500'000'000);
      }
  idle(1'000'000'000);

  const auto sample_count = [&](int64_t period_ns) {
    return static_cast<std::size_t>((builder.now_ns - planted::begin_ns) / period_ns);
  };
  std::size_t at = 0;
  builder.add_channel("i915.gt0.act_freq", Quantity::frequency, Unit::megahertz, Kind::gauge,
                      s.clock_poll_ns, sample_count(s.clock_poll_ns), [&](std::size_t i) {
                        const int64_t t_ns =
                            planted::begin_ns + static_cast<int64_t>(i) * s.clock_poll_ns;
                        while (at + 1 < pieces.size() && pieces[at].end_ns <= t_ns) ++at;
                        return std::round(1e3 * pieces[at].ghz);
                      });
  std::size_t piece = 0;
  double joules = 0;
  int64_t counted_ns = planted::begin_ns;
  builder.add_channel(
      "rapl.package-0.energy", Quantity::energy, Unit::microjoule, Kind::cumulative, 1'000'000,
      sample_count(1'000'000), [&](std::size_t i) {
        const int64_t since_ns = static_cast<int64_t>(i) * 1'000'000;
        const int64_t update_ns = planted::begin_ns + since_ns / s.update_ns * s.update_ns;
        while (counted_ns < update_ns && piece < pieces.size()) {
          const int64_t end_ns = std::min(update_ns, pieces[piece].end_ns);
          joules += pieces[piece].watts * static_cast<double>(end_ns - counted_ns) * 1e-9;
          counted_ns = end_ns;
          if (pieces[piece].end_ns <= counted_ns) ++piece;
        }
        return std::floor(joules * 1e6);
      });
  builder.close();
  return builder.run;
}

struct Count {
  double run = 0, cycles = 0, mean_cycles = 0, energy_run = 0, energy = 0, failed = 0;
};

bool holds(const Ratio& ratio, double log_truth) {
  return ratio.interval.low <= std::exp(log_truth) && std::exp(log_truth) <= ratio.interval.high;
}

void add_run(uint64_t seed, std::map<std::string, Count>& counts) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  const Scenario s = make_scenario(random);
  std::vector<double> work, power;
  for (int a = 0; a < s.algorithm_count; ++a) {
    work.push_back(0.1 * normal(random));
    power.push_back(0.1 * normal(random));
  }
  const std::vector<double> usual(work.size(), 0.0);
  const RunRecord run_a = make_run(s, 1, usual, usual, random);
  const Comparison result = compare(run_a, make_run(s, s.clock_b, work, power, random));
  const Comparison same = compare(run_a, make_run(s, s.clock_b, usual, usual, random));
  const auto index = [](const std::string& algorithm) { return std::stoul(algorithm.substr(1)); };
  Count count;
  count.run = 1;
  count.failed = slower_by(same, 0).slower ? 1 : 0;
  count.cycles = 1;
  for (const ComparedCell& cell : result.cells)
    if (!cell.cycles || !holds(*cell.cycles, work[index(cell.algorithm)])) count.cycles = 0;
  count.mean_cycles = result.cycles && holds(*result.cycles, mean(work)) ? 1 : 0;
  count.energy_run = count.energy = result.energy.empty() ? 0 : 1;
  for (const ComparedEnergy& row : result.energy) {
    const std::size_t a = index(row.algorithm);
    if (!holds(row.joules_per_frame, power[a] + work[a] - std::log(s.clock_b))) count.energy = 0;
  }
  const std::string spread = fmt::format("trials {:.1f} % apart", 100 * s.trial_spread);
  for (const std::string& key :
       {s.repetition_count > 1 ? std::string("2 and 3 trials a cell")
                               : std::string("1 trial a cell"),
        fmt::format("{} trial{} a cell, {}", s.repetition_count, s.repetition_count == 1 ? "" : "s",
                    spread),
        fmt::format("at rest {:4.1f} times as much", s.idle_ratio),
        fmt::format("counter moves every {:2} ms", s.update_ns / 1'000'000),
        fmt::format("clock read every {:2} ms", s.clock_poll_ns / 1'000'000),
        fmt::format("clock of B {:.1f}, {}", s.clock_b, s.clock_wanders ? "wanders" : "steady")}) {
    // What one trial cannot tell is a line of its own.
    if (s.repetition_count == 1 && !key.starts_with("1 ")) continue;
    Count& sum = counts[key];
    sum.run += count.run;
    sum.cycles += count.cycles;
    sum.mean_cycles += count.mean_cycles;
    sum.energy_run += count.energy_run;
    sum.energy += count.energy;
    sum.failed += count.failed;
  }
}

}  // namespace

int main(int argc, char** argv) {
  const auto argument = [&](int i, uint64_t fallback) {
    return argc > i ? std::strtoull(argv[i], nullptr, 10) : fallback;
  };
  const uint64_t first = argument(3, 1);
  planted::Coverage coverage;
  for (uint64_t seed = first; seed < first + argument(1, 6'000); ++seed)
    coverage.add(planted::scenario(seed), seed);
  fmt::print("Bare values: share of runs in which intervals hold\n{}\n", coverage.text());

  std::map<std::string, Count> counts;
  for (uint64_t seed = first; seed < first + argument(2, 1'500); ++seed) add_run(seed, counts);
  fmt::print("Whole runs\n{:<36} {:>6} {:>10} {:>6} {:>11} {:>6} {:>11}\n", "", "runs",
             "all cycles", "mean", "with energy", "all", "false alarm");
  for (const auto& [key, count] : counts)
    fmt::print("{:<36} {:>6} {:>10.3f} {:>6.3f} {:>11} {:>6.3f} {:>11.3f}\n", key, count.run,
               count.cycles / count.run, count.mean_cycles / count.run, count.energy_run,
               count.energy / count.energy_run, count.failed / count.run);
}
