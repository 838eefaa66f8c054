// How the analysis grows with the number of samples: 100,000 frames under 40 channels with 0.5, 5
// and 50 million samples in memory. Prints CSV, a line per size.
//
//   analyze_bench [LARGEST] > analyze.csv
//   analyze_bench --write FILE [SAMPLES]
//
// The second form writes such a run as run.sqlite instead, for `energyprof analyze` and for
// analyze_pandas.py to read the same.
//
// Everything of analyze() is in it, permutation tests included; reading and writing files is not.
#include <fmt/format.h>
#include <sys/resource.h>

#include <chrono>
#include <cmath>
#include <cstdlib>
#include <random>
#include <string_view>

#include "analysis/analyze.h"
#include "core/run_db.h"

namespace {

using namespace energyprof;

constexpr std::size_t frame_count = 100'000;
constexpr std::size_t trial_length = 500;
constexpr int64_t ns_per_s = 1'000'000'000;

struct Machine {
  RunRecord run;
  int64_t begin_ns = 1'000 * ns_per_s;
  int64_t end_ns = begin_ns;
  std::mt19937_64 random{1};
  std::normal_distribution<double> normal;

  /// 5 algorithms take turns on 2 models and 4 views. A hundredth of the frames is slow.
  void trace() {
    const std::vector<std::string> algorithms{"A", "B", "C", "D", "E"};
    int64_t now_ns = begin_ns + ns_per_s;
    for (std::size_t t = 0; t * trial_length < frame_count; ++t) {
      Trial trial;
      trial.id = static_cast<int64_t>(t) + 1;
      trial.algorithm = algorithms[t % 5];
      trial.model = t / 5 % 2 == 0 ? "m" : "n";
      trial.view = static_cast<int64_t>(t / 10 % 4);
      trial.begin_ns = now_ns;
      for (std::size_t i = 0; i < trial_length; ++i) {
        FrameRecord frame;
        frame.id = static_cast<int64_t>(run.frames.size()) + 1;
        frame.trial_id = trial.id;
        frame.frame = static_cast<int64_t>(i);
        frame.begin_ns = frame.submit_ns = now_ns;
        const double slow = random() % 100 == 0 ? 3 : 1;
        now_ns += static_cast<int64_t>(1e6 * (1 + static_cast<double>(t % 5)) * slow *
                                       (1 + 0.02 * normal(random)));
        frame.end_ns = now_ns;
        frame.ray_count = 1'000'000;
        run.frames.push_back(frame);
      }
      trial.end_ns = now_ns;
      run.trials.push_back(trial);
      now_ns += ns_per_s / 20;
    }
    end_ns = now_ns + ns_per_s;
  }

  void sense(std::size_t sample_count) {
    const std::vector<std::pair<Quantity, Kind>> kinds{
        {Quantity::energy, Kind::cumulative},       {Quantity::frequency, Kind::gauge},
        {Quantity::temperature, Kind::gauge},       {Quantity::throttle, Kind::flag},
        {Quantity::cache_miss, Kind::cumulative},   {Quantity::power, Kind::average},
        {Quantity::interference, Kind::cumulative}, {Quantity::utilization, Kind::gauge}};
    constexpr std::size_t channel_count = 40;
    const std::size_t each = sample_count / channel_count;
    for (std::size_t c = 0; c < channel_count; ++c) {
      Channel channel;
      channel.id = static_cast<int32_t>(c) + 1;
      channel.name = fmt::format("source{}.channel{}.value", c % 8, c);
      std::tie(channel.quantity, channel.kind) = kinds[c % kinds.size()];
      channel.unit = channel.quantity == Quantity::energy      ? Unit::microjoule
                     : channel.quantity == Quantity::power     ? Unit::milliwatt
                     : channel.quantity == Quantity::frequency ? Unit::megahertz
                                                               : Unit::none;
      if (channel.quantity == Quantity::throttle)
        channel.name = fmt::format("i915.gt{}.throttle.pl1", c);
      channel.period_ns = (end_ns - begin_ns) / static_cast<int64_t>(each);
      SampleSeries& series = run.series[channel.id];
      double value = 1'000;
      for (std::size_t i = 0; i < each; ++i) {
        const double noise = normal(random);
        if (channel.kind == Kind::cumulative)
          value += std::floor(15 * static_cast<double>(channel.period_ns) * 1e-3 *
                              (1 + 0.1 * std::fabs(noise)));
        else if (channel.kind == Kind::flag)
          value = i / 50 % 20 == c % 20 ? 1 : 0;
        else
          value = 0.99 * value + 10 + noise;
        series.t_ns.push_back(begin_ns + static_cast<int64_t>(i) * channel.period_ns);
        series.value.push_back(channel.kind == Kind::gauge ? std::round(value) : value);
      }
      run.channels.push_back(channel);
    }
  }
};

void write(const RunRecord& run, const std::string& file) {
  RunWriter writer(file);
  for (const Channel& channel : run.channels) writer.add_channel(channel);
  for (const auto& [id, series] : run.series) {
    std::vector<Sample> samples;
    for (std::size_t i = 0; i < series.t_ns.size(); ++i)
      samples.push_back({id, series.t_ns[i], std::llround(series.value[i]), 0});
    writer.add_samples(samples);
    writer.flush();
  }
  for (const Trial& trial : run.trials) writer.put_trial(trial);
  for (const FrameRecord& frame : run.frames) writer.add_frame(frame);
  writer.close();
}

std::size_t sample_count_of(const char* text) {
  const std::size_t count = std::strtoull(text, nullptr, 10);
  if (count >= 10'000) return count;
  fmt::print(stderr, "analyze_bench: SAMPLES is '{}'; at least 10000 are needed\n", text);
  std::exit(2);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc > 2 && std::string_view(argv[1]) == "--write") {
    Machine machine;
    machine.trace();
    machine.sense(argc > 3 ? sample_count_of(argv[3]) : 5'000'000);
    write(machine.run, argv[2]);
    return 0;
  }
  const std::size_t largest = argc > 1 ? sample_count_of(argv[1]) : 5'000'000;
  fmt::print("frames,channels,samples,seconds,peak_mib,correlations,related\n");
  for (std::size_t sample_count = 500'000; sample_count <= largest; sample_count *= 10) {
    Machine machine;
    machine.trace();
    machine.sense(sample_count);
    const auto begin = std::chrono::steady_clock::now();
    const analysis::Analysis result = analysis::analyze(machine.run);
    const std::chrono::duration<double> taken = std::chrono::steady_clock::now() - begin;
    rusage usage{};
    getrusage(RUSAGE_SELF, &usage);
    std::size_t related = 0;
    for (const analysis::Correlation& row : result.correlations)
      related += row.verdict.relation == analysis::Relation::related ? 1 : 0;
    fmt::print("{},{},{},{:.2f},{},{},{}\n", machine.run.frames.size(), machine.run.channels.size(),
               sample_count, taken.count(), usage.ru_maxrss / 1024, result.correlations.size(),
               related);
  }
  return 0;
}
