#include "planted_run.h"

#include <fmt/format.h>

#include <cmath>

namespace energyprof::analysis::planted {

RunBuilder::RunBuilder() { run.meta.emplace("schema_version", "1"); }

Trial& RunBuilder::add_trial(const std::string& model, int64_t view, const std::string& algorithm,
                             const std::vector<double>& times_ms) {
  Trial trial;
  trial.id = static_cast<int64_t>(run.trials.size()) + 1;
  trial.model = model;
  trial.view = view;
  trial.algorithm = algorithm;
  trial.position = trial.id - 1;
  trial.begin_ns = now_ns;
  for (std::size_t i = 0; i < times_ms.size(); ++i) {
    FrameRecord frame;
    frame.id = static_cast<int64_t>(run.frames.size()) + 1;
    frame.trial_id = trial.id;
    frame.frame = static_cast<int64_t>(i);
    frame.submit_ns = now_ns;
    frame.begin_ns = now_ns;
    frame.end_ns = now_ns + std::llround(times_ms[i] * 1e6);
    frame.clock_error_ns = 2'000;
    frame.ray_count = 1'000;
    frame.hit_count = 400;
    frame.hit_checksum = fmt::format("h{}", i);
    now_ns = frame.end_ns;
    run.frames.push_back(frame);
  }
  trial.end_ns = now_ns;
  run.trials.push_back(trial);
  return run.trials.back();
}

Channel& RunBuilder::add_channel(const std::string& name, Quantity quantity, Unit unit, Kind kind,
                                 int64_t period_ns, std::size_t count,
                                 const std::function<double(std::size_t)>& value) {
  Channel channel;
  channel.id = static_cast<int32_t>(run.channels.size()) + 1;
  channel.name = name;
  channel.source = name.substr(0, name.find('.'));
  channel.quantity = quantity;
  channel.unit = unit;
  channel.unit_text = unit_info(unit).name;
  channel.kind = kind;
  channel.period_ns = period_ns;
  run.channels.push_back(channel);
  for (std::size_t i = 0; i < count; ++i) {
    SampleSeries& series = run.series[channel.id];
    series.t_ns.push_back(begin_ns + static_cast<int64_t>(i) * period_ns);
    series.value.push_back(value(i));
  }
  return run.channels.back();
}

void RunBuilder::close() {
  run.meta["begin_ns"] = std::to_string(begin_ns);
  run.meta["end_ns"] = std::to_string(now_ns);
}

namespace {

/// Frame i of a pseudo-noisy series around `base_ms`: within 3 %, every 17th frame three times as
/// long.
std::vector<double> frame_times(double base_ms, std::size_t shift) {
  std::vector<double> times_ms;
  for (std::size_t i = 0; i < 40; ++i) {
    const double noise = 0.03 * std::sin(2.4 * static_cast<double>(i * i + shift));
    const bool stutter = (i + shift) % 17 == 16;
    times_ms.push_back(base_ms * (1 + noise) * (stutter ? 3 : 1));
  }
  return times_ms;
}

void add_laptop_sensors(RunBuilder& builder) {
  constexpr int64_t ms = 1'000'000;
  const auto count = static_cast<std::size_t>((builder.now_ns - begin_ns) / ms);
  const auto throttled = [count](std::size_t i) { return i > count / 2 && i < count * 3 / 4; };
  // 15 W, 9 W while throttled: the counter wraps at 10 J.
  Channel& energy = builder.add_channel("rapl.package-0.energy", Quantity::energy, Unit::microjoule,
                                        Kind::cumulative, ms, count,
                                        [&, total = 9'000'000.0](std::size_t i) mutable {
                                          total += throttled(i) ? 9'000 : 15'000;
                                          return std::fmod(total, 10'000'001.0);
                                        });
  energy.wrap_at = 10'000'000;
  energy.read_cost_ns = 2'400;
  energy.origin = "/sys/class/powercap/intel-rapl:0/energy_uj";
  builder.add_channel(
      "i915.gt0.act_freq", Quantity::frequency, Unit::megahertz, Kind::gauge, ms, count,
      [&](std::size_t i) { return throttled(i) ? 600.0 : (i / 7 % 2 == 0 ? 1300.0 : 1250.0); });
  builder.add_channel("i915.gt0.throttle.pl1", Quantity::throttle, Unit::none, Kind::flag, ms,
                      count, [&](std::size_t i) { return throttled(i) ? 1.0 : 0.0; });
  builder.add_channel("hwmon.coretemp.package_id_0.temp", Quantity::temperature, Unit::millicelsius,
                      Kind::gauge, 10 * ms, count / 10, [&](std::size_t i) {
                        return 52'000 + 1'000 * std::floor(0.15 * static_cast<double>(i));
                      });
  builder.add_channel("rapl.package-0.limit.long_term", Quantity::limit, Unit::microwatt,
                      Kind::gauge, 100 * ms, count / 100, [](std::size_t) { return 15e6; });
  builder.add_channel("nvml.gpu0.energy", Quantity::energy, Unit::millijoule, Kind::cumulative, ms,
                      0, [](std::size_t) { return 0.0; });
}

}  // namespace

RunRecord laptop_run() {
  RunBuilder builder;
  std::size_t shift = 0;
  for (const char* model : {"dragon", "teapot </script><b>"})
    for (int64_t view : {0, 1})
      for (const auto& [algorithm, base_ms] :
           {std::pair("GRID", 2.0), {"BVH_FTB_BF", 3.1}, {"KD_TREE", 6.4}}) {
        Trial& trial = builder.add_trial(model, view, algorithm, frame_times(base_ms, shift++));
        trial.build_ns = 41'000'000;
        trial.blob_bytes = 28'000'000;
        trial.triangle_count = 871'306;
        builder.now_ns += 5'000'000;
      }
  Trial& skipped = builder.add_trial("dragon", 1, "GRID", {2, 2});
  skipped.skip_reason = "device lost | and found again";
  add_laptop_sensors(builder);
  builder.close();

  auto& meta = builder.run.meta;
  meta["name"] = "dragon";
  meta["config"] =
      R"({"name":"dragon","question":"which paradigm costs least energy per ray here, and why?",
    "algorithms":["BVH_FTB_BF","KD_TREE","GRID"],"analysis":{"truncate":0.1,"weight_mean":0.5,"weight_stddev":0.5}})";
  meta["device"] = R"({"name":"Iris Xe, planted","type":"integrated","driver":"planted"})";
  meta["host"] = R"({"cpu":"a CPU","kernel":"6.1","os":"Debian 12","cores":8})";
  meta["device_refusals"] =
      R"([{"name":"Foo GPU","reason":"timestampValidBits is 0 on its compute queue"}])";
  meta["missing_sensors"] =
      R"([{"source":"perf","reason":"perf_event_paranoid is 3","fix":"sysctl kernel.perf_event_paranoid=1"},
          {"source":"nvml","reason":"libnvidia-ml.so.1 is not installed"}])";
  meta["begin_utc"] = "2024-05-01T10:00:00Z";
  meta.emplace("simulated", "1");
  meta["verdict"] = "Energy of the CPU package can be sensed; that of the GPU alone cannot.";
  meta["sampler_cpu_ns"] = "12000000";
  meta["sampler_ticks"] = "2000";
  meta["sampler_missed_ticks"] = "3";
  meta["sampler_lateness_p99_ns"] = "45000";

  Event event;
  event.t_ns = begin_ns + 700'000'000;
  event.severity = Severity::warning;
  event.kind = "missed-ticks";
  event.text = "3 ticks were missed <b>";
  builder.run.events.push_back(event);
  return builder.run;
}

}  // namespace energyprof::analysis::planted
