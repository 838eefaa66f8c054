#include "synthetic_run.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <random>
#include <utility>

#include "core/run_db.h"

namespace energyprof::analysis::synthetic {
namespace {

constexpr std::size_t effect_count = 8;
constexpr double clock_hz = 1.3e9;
constexpr double run_begin_s = 1000;

int64_t to_ns(double t_s) { return std::llround(t_s * 1e9); }

class Random {
 public:
  explicit Random(uint64_t seed) : engine_(seed * 0x9E3779B97F4A7C15u + 1) {}
  double uniform(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(engine_);
  }
  double log_uniform(double low, double high) {
    return std::exp(uniform(std::log(low), std::log(high)));
  }
  bool chance(double p) { return uniform(0, 1) < p; }
  int integer(int low, int high) { return std::uniform_int_distribution<int>(low, high)(engine_); }
  double normal() { return normal_(engine_); }
  double exponential(double mean) { return -mean * std::log(1 - uniform(0, 1)); }
  double student(double freedom) { return std::student_t_distribution<double>(freedom)(engine_); }

 private:
  std::mt19937_64 engine_;
  std::normal_distribution<double> normal_;
};

/// What sensors see at an instant.
struct Machine {
  double t_s = run_begin_s;
  double clock = 1;  // of clock_hz
  double requested = 1;
  double power_w = 5;
  double temperature_c = 45;
  std::array<bool, effect_count> flag{};
  bool decoy_flag = false;
  bool tracing = false;
  // Counters:
  double energy_j = 0;
  double misses = 0;
  double steal_s = 0;
  double waiting_s = 0;
  double switches = 0;
  double quota_s = 0;
  double quota_pending_s = 0;  // becomes visible when the quota's period ends
  double residency = 0;
};

struct Sensor {
  Channel channel;
  double period_s = 0.01;
  double next_s = run_begin_s;
  double lost = 0;  // share of readings that fail
  std::function<double(const Machine&)> read;
  double quantum = 1;
  double noise = 0;
};

/// Names of the same things on different machines, ours and foreign ones.
struct Family {
  const char* clock;
  const char* requested;
  const char* power_flag;
  const char* thermal_flag;
  const char* external_flag;
  const char* decoy_flag;     // a real reason that slows nothing this time
  const char* constant_flag;  // set, and no throttling
  const char* energy;
  const char* limit;
  const char* temperature;
  const char* trip;
  const char* misses;
};

constexpr std::array families{
    Family{"i915.gt0.act_freq", "i915.gt0.cur_freq", "i915.gt0.throttle.pl1",
           "i915.gt0.throttle.thermal", "i915.gt0.throttle.prochot", "i915.gt0.throttle.vr_tdc",
           "i915.gt0.rc6_enabled", "rapl.package-0.energy", "rapl.package-0.pl1",
           "thermal.x86_pkg_temp.temp", "thermal.x86_pkg_temp.trip.passive", "perf.llc_misses"},
    Family{"nvml.gpu0.sm_clock", "nvml.gpu0.requested_clock", "nvml.gpu0.reason.sw_power_cap",
           "nvml.gpu0.reason.sw_thermal_slowdown", "nvml.gpu0.reason.hw_power_brake_slowdown",
           "nvml.gpu0.reason.sync_boost", "nvml.gpu0.reason.applications_clocks_setting",
           "nvml.gpu0.energy", "nvml.gpu0.power_limit", "nvml.gpu0.temp", "nvml.gpu0.temp_slowdown",
           "perf.uncore_imc.data_reads"},
    Family{"amdgpu.gfx_freq", "amdgpu.gfx_max_freq", "amdgpu.throttle.sppt",
           "amdgpu.throttle.temp_core", "amdgpu.throttle.prochot_gfx", "amdgpu.throttle.tdc_vdd",
           "amdgpu.status.hotspot", "rapl.package-0.energy", "amdgpu.ppt_limit", "amdgpu.gfx_temp",
           "amdgpu.gfx_temp.crit", "perf.l3_misses"},
    Family{"gpu.clock", "gpu.clock_requested", "gpu.limited_by.power", "gpu.limited_by.thermal",
           "gpu.limited_by.external", "gpu.limited_by.current", "gpu.limited_by.idle", "gpu.energy",
           "gpu.power_limit", "gpu.temperature", "gpu.temperature_limit", "dram.read_bytes"}};

class Simulation {
 public:
  explicit Simulation(const Options& options) : options_(options), random_(options.seed) {
    draw();
    add_sensors();
  }

  SyntheticRun simulate() {
    advance_idle(0.2);
    for (int repetition = 0; repetition < repetitions_; ++repetition)
      for (std::size_t a = 0; a < base_s_.size(); ++a) trace_trial(a, repetition);
    advance_idle(0.2);
    auto& meta = result_.run.meta;
    meta["schema_version"] = "1";
    meta["name"] = fmt::format("synthetic {}", options_.seed);
    meta["begin_ns"] = std::to_string(to_ns(run_begin_s));
    meta["end_ns"] = std::to_string(to_ns(m_.t_s));
    return std::move(result_);
  }

 private:
  void draw() {
    const double base_ms = options_.base_ms > 0 ? options_.base_ms : random_.log_uniform(1, 400);
    const int algorithms = random_.integer(1, 3);
    for (int a = 0; a < algorithms; ++a)
      base_s_.push_back(base_ms * 1e-3 * (a == 0 ? 1 : random_.uniform(0.6, 1.6)));
    repetitions_ = random_.integer(1, 3);
    // Not longer than a minute of simulated time in all.
    const double most = 40 / (base_ms * 1e-3) / (algorithms * repetitions_);
    frames_ =
        static_cast<int>(std::clamp(random_.log_uniform(40, 1500), 30.0, std::max(30.0, most)));
    noise_ = options_.noise > 0 ? options_.noise : random_.log_uniform(0.003, 0.025);
    noise_kind_ = random_.integer(0, 2);
    drift_ = random_.chance(0.4) ? random_.uniform(0.02, 0.12) : 0;
    typical_s_ = base_s_.front();
    step_s_ = std::clamp(typical_s_ / 25, 2e-5, 2e-3);
    lag_s_ = random_.uniform(0.1, 0.5) * typical_s_;
    family_ = families[static_cast<std::size_t>(random_.integer(0, 3))];
    // Events take a tenth of the time together.
    mean_gap_s_ = typical_s_ * random_.uniform(25, 60);
    physics_ =
        (options_.effects.contains(Effect::power) || options_.effects.contains(Effect::thermal)) &&
        random_.chance(0.3);
    pl1_w_ = random_.uniform(12, 20);
    burst_w_ = pl1_w_ * (physics_ ? random_.uniform(1.8, 2.6) : random_.uniform(1.15, 1.4));
    // The limit is reached when a quarter to two thirds of a trial are traced.
    tau_s_ = typical_s_ * (frames_ * random_.uniform(0.25, 0.67) + 8) /
             std::log((burst_w_ - 3) / (burst_w_ - pl1_w_));
    trip_c_ = random_.uniform(85, 100);
    heat_c_per_w_ = (trip_c_ * random_.uniform(1.0, 1.2) - 35) / burst_w_;
    heat_tau_s_ = typical_s_ * frames_ * random_.uniform(0.5, 2);
    result_.description = fmt::format(
        "seed {}: base {:.2f} ms, {} algorithms x {} repetitions x {} frames, noise {:.2f} % kind "
        "{}, drift {:.0f} %, clock channel {}, {}",
        options_.seed, base_ms, algorithms, repetitions_, frames_, noise_ * 100, noise_kind_,
        drift_ * 100, family_.clock, physics_ ? "limits from the model" : "limits at random");
  }

  Sensor& add(const char* name, Quantity quantity, Unit unit, Kind kind, double period_s,
              std::function<double(const Machine&)> read) {
    Sensor sensor;
    sensor.channel.id = static_cast<int32_t>(sensors_.size()) + 1;
    sensor.channel.name = name;
    sensor.channel.source = sensor.channel.name.substr(0, sensor.channel.name.find('.'));
    sensor.channel.quantity = quantity;
    sensor.channel.unit = unit;
    sensor.channel.unit_text = unit_info(unit).name;
    sensor.channel.kind = kind;
    sensor.channel.period_ns = to_ns(period_s);
    sensor.period_s = period_s;
    sensor.read = std::move(read);
    sensor.lost = random_.chance(0.3) ? random_.uniform(0, 0.03) : 0;
    sensors_.push_back(std::move(sensor));
    return sensors_.back();
  }

  void add_sensors() {
    const double quick_s = std::clamp(typical_s_ * random_.uniform(0.2, 0.8), 0.001, 0.05);
    const double flag_s = options_.slow_flags ? std::max(1.0, 60 * typical_s_) : quick_s;
    if (options_.clock) {
      Sensor& clock = add(family_.clock, Quantity::frequency, Unit::megahertz, Kind::gauge, quick_s,
                          [](const Machine& m) { return m.tracing ? m.clock * 1300 : 0; });
      clock.noise = random_.chance(0.5) ? 8 : 0;
      clock.quantum = random_.chance(0.5) ? 50 : 1;
      add(family_.requested, Quantity::frequency, Unit::megahertz, Kind::gauge, 0.1,
          [](const Machine& m) { return m.requested * 1300; });
    }
    const auto flag = [&](const char* name, Effect effect) {
      add(name, Quantity::throttle, Unit::none, Kind::flag, flag_s,
          [effect](const Machine& m) { return m.flag[static_cast<std::size_t>(effect)] ? 1 : 0; });
    };
    if (options_.reason_flags) {
      flag(family_.power_flag, Effect::power);
      flag(family_.thermal_flag, Effect::thermal);
      flag(family_.external_flag, Effect::external);
      if (options_.decoys) {
        add(family_.decoy_flag, Quantity::throttle, Unit::none, Kind::flag, flag_s,
            [](const Machine& m) { return m.decoy_flag ? 1 : 0; });
        add(family_.constant_flag, Quantity::throttle, Unit::none, Kind::flag, flag_s,
            [](const Machine&) { return 1; });
      }
    }
    Sensor& energy = add(family_.energy, Quantity::energy, Unit::microjoule, Kind::cumulative,
                         0.001, [](const Machine& m) { return m.energy_j * 1e6; });
    energy.channel.wrap_at = 65'532'610;  // wraps every few seconds
    energy.quantum = 61;
    Sensor& temperature =
        add(family_.temperature, Quantity::temperature, Unit::millicelsius, Kind::gauge, 0.1,
            [](const Machine& m) { return m.temperature_c * 1000; });
    temperature.quantum = 1000;
    temperature.noise = 300;
    if (options_.limits) {
      add(family_.limit, Quantity::limit, Unit::microwatt, Kind::gauge, 1,
          [this](const Machine&) { return pl1_w_ * 1e6; });
      add(family_.trip, Quantity::limit, Unit::millicelsius, Kind::gauge, 1,
          [this](const Machine&) { return std::round(trip_c_) * 1000; });
    }
    if (options_.cache_counter) {
      Sensor& misses =
          add(family_.misses, random_.chance(0.5) ? Quantity::cache_miss : Quantity::memory_traffic,
              Unit::count, Kind::cumulative, quick_s, [](const Machine& m) { return m.misses; });
      if (random_.chance(0.5)) misses.channel.wrap_at = (int64_t{1} << 32) - 1;
    }
    if (options_.interference) {
      add("proc.stat.steal", Quantity::interference, Unit::clock_tick, Kind::cumulative, 0.01,
          [](const Machine& m) { return std::floor(m.steal_s * 100); });
      add("psi.cpu.some", Quantity::interference, Unit::microsecond, Kind::cumulative, quick_s,
          [](const Machine& m) { return m.waiting_s * 1e6; });
      add("perf.context_switches", Quantity::interference, Unit::count, Kind::cumulative, quick_s,
          [](const Machine& m) { return std::floor(m.switches); });
      const bool v1 = random_.chance(0.5);
      add("cgroup.cpu.throttled", Quantity::interference, v1 ? Unit::nanosecond : Unit::microsecond,
          Kind::cumulative, std::clamp(typical_s_ / 3, 0.001, 0.02),
          [v1](const Machine& m) { return m.quota_s * (v1 ? 1e9 : 1e6); });
    }
  }

  void poll() {
    for (Sensor& sensor : sensors_) {
      if (m_.t_s < sensor.next_s) continue;
      while (sensor.next_s <= m_.t_s)
        sensor.next_s += sensor.period_s * random_.uniform(0.95, 1.05);
      if (random_.chance(sensor.lost)) continue;
      double value = sensor.read(m_);
      if (sensor.noise > 0 && value != 0) value += sensor.noise * random_.normal();
      value = std::round(value / sensor.quantum) * sensor.quantum;
      if (sensor.channel.wrap_at)
        value = std::fmod(value, static_cast<double>(*sensor.channel.wrap_at) + 1);
      SampleSeries& series = result_.run.series[sensor.channel.id];
      series.t_ns.push_back(to_ns(m_.t_s));
      series.value.push_back(std::floor(value));
    }
    if (result_.run.channels.empty())
      for (const Sensor& sensor : sensors_) result_.run.channels.push_back(sensor.channel);
  }

  /// One step; gives the share of it in which the frame made progress at full speed.
  double step(double duration_s) {
    if (m_.tracing) schedule();
    const bool active = m_.t_s < event_end_s_;
    const Effect effect = active ? event_ : Effect::none;
    Effect limited = effect;
    if (physics_) limited = physical_limit(effect, duration_s);

    const bool clocked =
        limited == Effect::power || limited == Effect::thermal || limited == Effect::external;
    const double target = clocked ? 1 / (limited == effect ? strength_ : held_back_by(limited)) : 1;
    m_.clock += (target - m_.clock) * (1 - std::exp(-duration_s / lag_s_));
    m_.flag = {};
    if (clocked) m_.flag[static_cast<std::size_t>(limited)] = true;
    const bool stopped = effect == Effect::quota || effect == Effect::preemption;
    const double cache_factor = effect == Effect::cache ? strength_ : 1;

    const double full_w = burst_w_ * std::pow(m_.clock, 2.0);
    m_.power_w = 3 + (m_.tracing ? (stopped ? 0.2 : 1) * (full_w - 3) : 0);
    // Where limits come at random, what the sensors see agrees with them all the same.
    if (!physics_ && limited == Effect::power) m_.power_w = pl1_w_ * 0.99;
    if (!physics_ && m_.tracing && limited != Effect::power && !stopped)
      m_.power_w = std::min(m_.power_w, pl1_w_ * (limited == Effect::thermal ? 0.6 : 0.85));
    const double warm_c = 40 + std::min(2 * m_.power_w, 30.0);
    if (physics_ || limited != Effect::thermal)
      m_.temperature_c +=
          ((physics_ ? 35 + heat_c_per_w_ * m_.power_w : warm_c) - m_.temperature_c) * duration_s /
          heat_tau_s_;
    if (!physics_) {
      if (limited == Effect::thermal)
        shown_c_ = trip_c_ + 0.5;
      else
        shown_c_ += (m_.temperature_c - shown_c_) * std::min(1.0, duration_s / (3 * typical_s_));
    }
    const double kept_c = m_.temperature_c;
    m_.energy_j += m_.power_w * duration_s;
    const double speed = stopped ? 0 : m_.clock / cache_factor;
    // Misses go with the work; in a burst each piece of work misses more.
    m_.misses += duration_s * (2e6 * (m_.tracing ? speed * miss_growth(cache_factor) : 0) +
                               1e4 * random_.uniform(0.5, 1.5));
    if (effect == Effect::preemption) {
      if (preempted_by_host_) m_.steal_s += duration_s;
      m_.waiting_s += duration_s * random_.uniform(0.8, 1);
      m_.switches += duration_s * 3000;
    }
    m_.waiting_s += duration_s * 0.01 * random_.uniform(0, 2);
    m_.switches += duration_s * 400 * random_.uniform(0, 2);
    if (effect == Effect::quota) m_.quota_pending_s += duration_s;
    if (effect != Effect::quota && m_.quota_pending_s > 0) {
      m_.quota_s += m_.quota_pending_s;
      m_.quota_pending_s = 0;
    }
    if (options_.decoys && m_.t_s >= decoy_end_s_) {
      m_.decoy_flag = false;
      if (random_.chance(duration_s / (40 * typical_s_))) {
        m_.decoy_flag = true;
        decoy_end_s_ = m_.t_s + typical_s_ * random_.uniform(1, 3);
      }
    }
    m_.t_s += duration_s;
    if (!physics_) m_.temperature_c = shown_c_;
    poll();
    m_.temperature_c = kept_c;

    const double lost = 1 - speed;
    Effect blame = limited;
    if (!clocked && effect == Effect::none && m_.clock < 0.999) blame = last_clocked_;
    if (clocked) last_clocked_ = limited;
    lost_s_[static_cast<std::size_t>(blame)] += duration_s * lost;
    return speed;
  }

  /// At PL1 the clock is what the limit allows; power grows with its square.
  [[nodiscard]] double held_back_by(Effect limit) const {
    return limit == Effect::power ? std::sqrt(burst_w_ / (0.98 * pl1_w_)) : 1.6;
  }

  static double miss_growth(double cache_factor) { return 1 + 2.5 * (cache_factor - 1); }

  Effect physical_limit(Effect effect, double duration_s) {
    average_w_ += (m_.power_w - average_w_) * (1 - std::exp(-duration_s / tau_s_));
    if (options_.effects.contains(Effect::power)) {
      if (average_w_ > pl1_w_) at_pl1_ = true;
      if (average_w_ < 0.93 * pl1_w_) at_pl1_ = false;
    }
    if (options_.effects.contains(Effect::thermal)) {
      if (m_.temperature_c > trip_c_) at_trip_ = true;
      if (m_.temperature_c < trip_c_ - 4) at_trip_ = false;
    }
    if (effect != Effect::none) return effect;
    if (at_trip_) return Effect::thermal;
    return at_pl1_ ? Effect::power : Effect::none;
  }

  /// Begins an event now and then; they do not overlap.
  void schedule() {
    if (m_.t_s < next_event_s_ || options_.effects.empty()) return;
    next_event_s_ = m_.t_s + random_.exponential(mean_gap_s_);
    std::vector<Effect> possible;
    for (const Effect effect : options_.effects)
      if (effect != Effect::work &&
          !(physics_ && (effect == Effect::power || effect == Effect::thermal)))
        possible.push_back(effect);
    if (possible.empty() || first_frames_) return;
    event_ = possible[static_cast<std::size_t>(
        random_.integer(0, static_cast<int>(possible.size()) - 1))];
    const bool long_one = random_.chance(0.35);
    double length_s =
        typical_s_ * (long_one ? random_.log_uniform(6, 60) : random_.uniform(1.5, 5));
    length_s = std::max(length_s, 0.004);
    strength_ =
        event_ == Effect::external ? random_.log_uniform(1.6, 8) : random_.log_uniform(1.35, 3.5);
    if (event_ == Effect::quota || event_ == Effect::preemption) {
      length_s = std::max(typical_s_ * random_.log_uniform(0.5, 60), 0.02);
      preempted_by_host_ = random_.chance(0.5);
    }
    event_end_s_ = m_.t_s + length_s;
    // Room enough behind it for the machine to be itself again.
    next_event_s_ = event_end_s_ + 5 * typical_s_ + random_.exponential(mean_gap_s_);
  }

  void advance_idle(double duration_s) {
    m_.tracing = false;
    const double end_s = m_.t_s + duration_s;
    while (m_.t_s < end_s) step(std::min(5e-3, std::max(end_s - m_.t_s, 1e-6)));
  }

  double noise() {
    switch (noise_kind_) {
      case 0:
        return std::exp(noise_ * random_.normal());
      case 1:  // heavy tails on both sides
        return std::exp(std::clamp(noise_ * 0.8 * random_.student(3.5), -0.3, 1.0));
      default:  // skewed: mostly quiet, sometimes longer
        return 1 + noise_ * 0.3 * std::abs(random_.normal()) + random_.exponential(noise_);
    }
  }

  void trace_trial(std::size_t algorithm, int repetition) {
    advance_idle(physics_ ? 3 * tau_s_ : std::min(0.3, 20 * typical_s_));
    Trial trial;
    trial.id = static_cast<int64_t>(result_.run.trials.size()) + 1;
    trial.model = "planted";
    trial.algorithm = fmt::format("ALGORITHM_{}", algorithm);
    trial.repetition = repetition;
    trial.position = trial.id - 1;
    trial.begin_ns = to_ns(m_.t_s);
    m_.tracing = true;
    constexpr int warmup = 4;
    for (int i = 0; i < warmup + frames_; ++i) {
      first_frames_ = i < warmup;
      trace_frame(trial.id, i, base_s_[algorithm] * (i < warmup ? 2.0 : 1.0), i < warmup);
    }
    m_.tracing = false;
    event_end_s_ = std::min(event_end_s_, m_.t_s);
    trial.end_ns = to_ns(m_.t_s);
    result_.run.trials.push_back(trial);
  }

  void trace_frame(int64_t trial_id, int index, double base_s, bool warmup) {
    FrameRecord frame;
    frame.id = static_cast<int64_t>(result_.run.frames.size()) + 1;
    frame.trial_id = trial_id;
    frame.frame = index;
    frame.phase = warmup ? Phase::warmup : Phase::timed;
    frame.submit_ns = frame.begin_ns = to_ns(m_.t_s);
    frame.clock_error_ns = 2'000;
    double more = 1;
    if (!warmup && options_.effects.contains(Effect::work) && m_.t_s >= event_end_s_ &&
        random_.chance(0.02))
      more = random_.log_uniform(1.4, 6);
    frame.ray_count = std::llround(1e6 * more * random_.uniform(0.995, 1.005));
    frame.hit_count = *frame.ray_count / 3;
    lost_s_ = {};
    const double age = (m_.t_s - run_begin_s) / (typical_s_ * frames_);
    const double drifted = 1 + drift_ * (1 - std::exp(-age));
    const double plain_s = base_s * noise() * drifted;
    double left_s = plain_s * more;
    while (left_s > 0) {
      // The last step ends with the frame.
      const double duration_s = std::min(step_s_, left_s / std::max(m_.clock, 1e-3) + 1e-7);
      left_s -= step(duration_s) * duration_s;
    }
    frame.end_ns = to_ns(m_.t_s);
    lost_s_[static_cast<std::size_t>(Effect::work)] += plain_s * (more - 1);
    result_.run.frames.push_back(frame);
    if (warmup) return;

    const double took_s = static_cast<double>(frame.end_ns - frame.begin_ns) * 1e-9;
    FrameTruth truth;
    truth.frame_id = frame.id;
    double all_s = 0;
    for (std::size_t e = 1; e < effect_count; ++e) all_s += lost_s_[e];
    truth.slowdown = took_s / plain_s;
    for (std::size_t e = 1; e < effect_count; ++e)
      if (lost_s_[e] > 0.6 * all_s && all_s > 0.05 * plain_s) truth.effect = static_cast<Effect>(e);
    truth.outlier = truth.slowdown >= 1.3;
    truth.normal = truth.slowdown <= 1.08;
    result_.frames.push_back(truth);
  }

  Options options_;
  Random random_;
  SyntheticRun result_;
  Machine m_;
  std::vector<Sensor> sensors_;
  Family family_{};
  // Drawn:
  std::vector<double> base_s_;
  int repetitions_ = 1;
  int frames_ = 100;
  double noise_ = 0.01;
  int noise_kind_ = 0;
  double drift_ = 0;
  double typical_s_ = 0.01;
  double step_s_ = 1e-4;
  double lag_s_ = 1e-3;
  double mean_gap_s_ = 1;
  bool physics_ = false;
  double pl1_w_ = 15, burst_w_ = 20, tau_s_ = 1;
  double trip_c_ = 95, heat_c_per_w_ = 2, heat_tau_s_ = 1;
  // State:
  Effect event_ = Effect::none;
  Effect last_clocked_ = Effect::power;
  double event_end_s_ = 0, next_event_s_ = 0, strength_ = 1;
  bool preempted_by_host_ = false;
  bool first_frames_ = false;
  double decoy_end_s_ = 0;
  double average_w_ = 5;
  bool at_pl1_ = false, at_trip_ = false;
  double shown_c_ = 45;
  std::array<double, effect_count> lost_s_{};
};

}  // namespace

std::string cause_name(Effect effect) {
  switch (effect) {
    case Effect::none:
      return "";
    case Effect::power:
      return "throttle-power";
    case Effect::thermal:
      return "throttle-thermal";
    case Effect::external:
    case Effect::quota:
      return "throttle-other";
    case Effect::cache:
      return "cache-miss";
    case Effect::preemption:
      return "interference";
    case Effect::work:
      return "more-work";
  }
  return "";
}

SyntheticRun make_run(const Options& options) { return Simulation(options).simulate(); }

void write_run(const RunRecord& run, const std::filesystem::path& file) {
  RunWriter writer(file);
  for (const auto& [key, value] : run.meta) writer.set_meta(key, value);
  for (const Channel& channel : run.channels) writer.add_channel(channel);
  for (const auto& [id, series] : run.series) {
    std::vector<Sample> samples;
    for (std::size_t i = 0; i < series.t_ns.size(); ++i)
      samples.push_back({id, series.t_ns[i], static_cast<int64_t>(series.value[i]), 0});
    writer.add_samples(samples);
  }
  for (const Trial& trial : run.trials) writer.put_trial(trial);
  for (const FrameRecord& frame : run.frames) writer.add_frame(frame);
  for (const Event& event : run.events) writer.add_event(event);
  writer.close();
}

}  // namespace energyprof::analysis::synthetic
