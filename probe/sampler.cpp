#include "probe/sampler.h"

#include <fmt/format.h>
#include <pthread.h>
#include <sched.h>
#include <sys/prctl.h>
#include <time.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <boost/lockfree/spsc_queue.hpp>
#include <cmath>
#include <future>
#include <limits>
#include <map>
#include <stdexcept>
#include <stop_token>
#include <thread>
#include <utility>

#include "core/clock.h"
#include "probe/root.h"

namespace energyprof::probe {
namespace {

constexpr int realtime_priority = 10;
constexpr int64_t longest_sleep_ns = 50 * ns_per_ms;  // how long stop() may have to wait
constexpr int64_t gap_report_ns = ns_per_s;
constexpr int64_t cpu_time_report_ns = 250 * ns_per_ms;
constexpr int64_t never = std::numeric_limits<int64_t>::max();

// Counts of durations in buckets that are at most one eighth wide.
class Histogram {
 public:
  void add(int64_t value_ns) {
    counts_[bucket(value_ns)].fetch_add(1, std::memory_order_relaxed);
    if (value_ns > max_.load(std::memory_order_relaxed))
      max_.store(value_ns, std::memory_order_relaxed);
  }

  // Upper end of the bucket that holds the quantile; nullopt without values.
  [[nodiscard]] std::optional<int64_t> quantile(double ratio) const {
    int64_t total = 0;
    for (const auto& count : counts_) total += count.load(std::memory_order_relaxed);
    if (total == 0) return std::nullopt;
    const auto wanted = static_cast<int64_t>(std::ceil(ratio * static_cast<double>(total)));
    int64_t seen = 0;
    size_t i = 0;
    while ((seen += counts_[i].load(std::memory_order_relaxed)) < wanted) ++i;
    return std::min(upper_end(i), max_.load(std::memory_order_relaxed));
  }

 private:
  // 0..7 one each; above, eight per power of two: the bits below the leading one.
  static size_t bucket(int64_t value_ns) {
    const auto value = static_cast<uint64_t>(std::max<int64_t>(value_ns, 0));
    if (value < 8) return static_cast<size_t>(value);
    const auto shift = static_cast<size_t>(std::bit_width(value)) - 4;
    return 8 * shift + static_cast<size_t>(value >> shift);
  }
  static int64_t upper_end(size_t i) {
    if (i < 16) return static_cast<int64_t>(i);
    const size_t shift = i / 8 - 1;
    return static_cast<int64_t>(((i - 8 * shift + 1) << shift) - 1);
  }

  std::array<std::atomic<int64_t>, 8 * 62> counts_{};
  std::atomic<int64_t> max_{0};
};

enum class Happening : uint8_t { sensor_gone, missed_ticks, samples_lost };

struct RawEvent {
  Happening what = Happening::sensor_gone;
  int64_t begin_ns = 0;
  int64_t end_ns = 0;
  int64_t count = 0;
  size_t channel = 0;  // sensor_gone: index
};

// Things that were missed within about a second of the first one.
struct Gap {
  int64_t begin_ns = 0;
  int64_t end_ns = 0;
  int64_t count = 0;

  void add(int64_t from_ns, int64_t to_ns, int64_t more) {
    if (count == 0) begin_ns = from_ns;
    end_ns = to_ns;
    count += more;
  }
};

// The newest sample, written by one thread. t_ns is 0 while it changes, so that a reader who sees
// one t_ns before and after reading the value has a pair that belongs together.
struct LatestSlot {
  std::atomic<int64_t> t_ns{0};
  std::atomic<int64_t> value{0};

  void store(const Reading& reading) {
    t_ns.store(0);
    value.store(reading.value);
    t_ns.store(reading.t_ns);
  }
  [[nodiscard]] std::optional<Sampler::Latest> load() const {
    constexpr int tries = 100;
    for (int i = 0; i < tries; ++i) {
      const Sampler::Latest latest{t_ns.load(), value.load()};
      if (latest.t_ns != 0 && latest.t_ns == t_ns.load()) return latest;
    }
    return std::nullopt;
  }
};

int64_t thread_cpu_ns() {
  timespec ts{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &ts);
  return int64_t{ts.tv_sec} * ns_per_s + ts.tv_nsec;
}

// False if stopped meanwhile.
bool sleep_until(int64_t deadline_ns, const std::stop_token& stop) {
  for (int64_t now = now_ns(); now < deadline_ns; now = now_ns()) {
    if (stop.stop_requested()) return false;
    const int64_t wake_ns = std::min(deadline_ns, now + longest_sleep_ns);
    const timespec wake{static_cast<time_t>(wake_ns / ns_per_s),
                        static_cast<long>(wake_ns % ns_per_s)};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &wake, nullptr);
  }
  return !stop.stop_requested();
}

int64_t tick_of(double rate_hz) {
  if (!(rate_hz > 0.0 && rate_hz <= 100'000.0))
    throw std::runtime_error(fmt::format(
        "cannot sample at {} Hz: the rate must be above 0 and at most 100000.", rate_hz));
  return std::max<int64_t>(1, std::llround(static_cast<double>(ns_per_s) / rate_hz));
}

}  // namespace

struct Sampler::Impl {
  // A source and when it is due.
  struct Task {
    SensorSource* source = nullptr;
    int64_t every = 1;  // ticks from poll to poll
    int64_t due = 0;    // next tick
    size_t first_channel = 0;
    size_t channel_count = 0;
    size_t gone_count = 0;
  };

  Impl(std::span<const std::unique_ptr<SensorSource>> sources, const Config& sampler_config)
      : config(sampler_config),
        tick_ns(tick_of(sampler_config.rate_hz)),
        samples(sampler_config.sample_capacity),
        events(sampler_config.event_capacity) {
    for (const auto& source : sources) {
      Task task;
      task.source = source.get();
      task.every = std::max<int64_t>(1, (source->period_ns() + tick_ns / 2) / tick_ns);
      task.first_channel = channels.size();
      for (Channel channel : std::as_const(*source).channels()) {
        channel.period_ns = task.every * tick_ns;
        index_of.emplace(channel.id, channels.size());
        channels.push_back(std::move(channel));
      }
      task.channel_count = channels.size() - task.first_channel;
      readings.resize(std::max(readings.size(), task.channel_count));
      tasks.push_back(task);
    }
    gone.resize(channels.size(), 0);
    latest = std::vector<LatestSlot>(channels.size());
  }

  void run(const std::stop_token& stop, std::promise<void> first_round) {
    prctl(PR_SET_TIMERSLACK, 1UL);
    const int64_t begin_ns = now_ns();
    for (Task& task : tasks) {
      poll(task);
      task.due = task.every;
    }
    first_round.set_value();
    int64_t cpu_reported_ns = begin_ns;
    while (!stop.stop_requested()) {
      const int64_t tick = next_tick();
      const int64_t deadline_ns =
          tick == never ? now_ns() + longest_sleep_ns : begin_ns + tick * tick_ns;
      if (!sleep_until(deadline_ns, stop)) break;
      if (tick == never) continue;
      const int64_t woke_ns = now_ns();
      lateness.add(woke_ns - deadline_ns);
      const int64_t missed = serve((woke_ns - begin_ns) / tick_ns);
      tick_count.fetch_add(1, std::memory_order_relaxed);
      if (missed > 0) {
        missed_tick_count.fetch_add(missed, std::memory_order_relaxed);
        missed_gap.add(deadline_ns, woke_ns, missed);
      }
      report_gaps(gap_report_ns);
      if (woke_ns - cpu_reported_ns >= cpu_time_report_ns) {
        cpu_ns.store(cpu_before_ns + thread_cpu_ns(), std::memory_order_relaxed);
        cpu_reported_ns = woke_ns;
      }
    }
    for (Task& task : tasks) poll(task);
    report_gaps(0);
    cpu_before_ns += thread_cpu_ns();
    cpu_ns.store(cpu_before_ns, std::memory_order_relaxed);
  }

  [[nodiscard]] int64_t next_tick() const {
    int64_t tick = never;
    for (const Task& task : tasks)
      if (task.gone_count < task.channel_count) tick = std::min(tick, task.due);
    return tick;
  }

  // Polls what is due at `tick` or was before. Returns how many ticks went unserved.
  int64_t serve(int64_t tick) {
    int64_t missed = 0;
    for (Task& task : tasks) {
      if (task.due > tick || task.gone_count == task.channel_count) continue;
      const int64_t skipped = (tick - task.due) / task.every;
      missed = std::max(missed, skipped);
      task.due += (skipped + 1) * task.every;
      poll(task);
    }
    return missed;
  }

  void poll(Task& task) {
    if (task.gone_count == task.channel_count) return;
    const std::span<Reading> out(readings.data(), task.channel_count);
    task.source->poll(out);
    for (size_t i = 0; i < out.size(); ++i) {
      const size_t channel = task.first_channel + i;
      if (gone[channel] != 0) continue;
      if (out[i].status == PollStatus::ok) {
        push({channels[channel].id, out[i].t_ns, out[i].value});
        latest[channel].store(out[i]);
      } else if (out[i].status == PollStatus::gone) {
        gone[channel] = 1;
        ++task.gone_count;
        push({Happening::sensor_gone, out[i].t_ns, out[i].t_ns, 1, channel});
      }
    }
  }

  void push(const Sample& sample) {
    if (samples.push(sample)) {
      sample_count.fetch_add(1, std::memory_order_relaxed);
    } else {
      lost_sample_count.fetch_add(1, std::memory_order_relaxed);
      lost_gap.add(sample.t_ns, sample.t_ns, 1);
    }
  }

  void push(const RawEvent& event) {
    if (!events.push(event)) lost_event_count.fetch_add(1, std::memory_order_relaxed);
  }

  // Turns gaps that began at least `age_ns` ago into events.
  void report_gaps(int64_t age_ns) {
    const int64_t now = now_ns();
    for (auto [gap, what] : {std::pair{&missed_gap, Happening::missed_ticks},
                             std::pair{&lost_gap, Happening::samples_lost}}) {
      if (gap->count == 0 || now - gap->begin_ns < age_ns) continue;
      push({what, gap->begin_ns, gap->end_ns, gap->count, 0});
      *gap = {};
    }
  }

  [[nodiscard]] Event describe(const RawEvent& raw) const {
    Event event;
    event.t_ns = raw.begin_ns;
    event.severity = Severity::warning;
    switch (raw.what) {
      case Happening::sensor_gone: {
        const Channel& channel = channels[raw.channel];
        event.kind = "sensor-gone";
        event.channel_id = channel.id;
        event.text = fmt::format("'{}' went away ({}); recording goes on without it.", channel.name,
                                 channel.origin);
        break;
      }
      case Happening::missed_ticks:
        event.kind = "missed-ticks";
        event.end_ns = raw.end_ns;
        event.text = fmt::format("{} sensor ticks of {:.3f} ms were missed.", raw.count,
                                 static_cast<double>(tick_ns) / static_cast<double>(ns_per_ms));
        break;
      case Happening::samples_lost:
        event.kind = "samples-lost";
        event.end_ns = raw.end_ns;
        event.text = fmt::format("{} samples were lost: the queue of {} was full.", raw.count,
                                 config.sample_capacity);
        break;
    }
    return event;
  }

  Config config;
  int64_t tick_ns;
  std::vector<Channel> channels;
  std::map<int32_t, size_t> index_of;  // channel id -> index
  std::vector<LatestSlot> latest;
  boost::lockfree::spsc_queue<Sample> samples;
  boost::lockfree::spsc_queue<RawEvent> events;
  std::string scheduling;

  // The thread's own.
  std::vector<Task> tasks;
  std::vector<Reading> readings;
  std::vector<char> gone;
  Gap missed_gap;
  Gap lost_gap;
  int64_t cpu_before_ns = 0;  // of earlier threads

  std::atomic<int64_t> tick_count{0};
  std::atomic<int64_t> missed_tick_count{0};
  std::atomic<int64_t> sample_count{0};
  std::atomic<int64_t> lost_sample_count{0};
  std::atomic<int64_t> lost_event_count{0};
  std::atomic<int64_t> cpu_ns{0};
  Histogram lateness;

  std::jthread thread;  // last, so that it ends first
};

Sampler::Sampler(std::span<const std::unique_ptr<SensorSource>> sources, const Config& config)
    : impl_(std::make_unique<Impl>(sources, config)) {}

Sampler::~Sampler() { stop(); }

std::vector<Channel> Sampler::channels() const { return impl_->channels; }

void Sampler::start() {
  if (impl_->thread.joinable()) return;
  std::promise<void> promise;
  const std::future<void> first_round = promise.get_future();
  impl_->thread = std::jthread(
      [impl = impl_.get()](const std::stop_token& stop, std::promise<void> done) {
        impl->run(stop, std::move(done));
      },
      std::move(promise));
  impl_->scheduling = "SCHED_OTHER";
  if (impl_->config.realtime) {
    const sched_param param{realtime_priority};
    const int error = pthread_setschedparam(impl_->thread.native_handle(), SCHED_FIFO, &param);
    impl_->scheduling =
        error == 0 ? fmt::format("SCHED_FIFO, priority {}", realtime_priority)
                   : fmt::format("SCHED_OTHER (SCHED_FIFO refused: {})", errno_text(error));
  }
  first_round.wait();
}

void Sampler::stop() {
  if (!impl_->thread.joinable()) return;
  impl_->thread.request_stop();
  impl_->thread.join();
}

void Sampler::drain(std::vector<Sample>& samples) {
  impl_->samples.consume_all([&](const Sample& sample) { samples.push_back(sample); });
}

void Sampler::drain_events(std::vector<Event>& events) {
  impl_->events.consume_all([&](const RawEvent& raw) { events.push_back(impl_->describe(raw)); });
}

std::optional<Sampler::Latest> Sampler::latest(int32_t channel_id) const {
  const auto found = impl_->index_of.find(channel_id);
  if (found == impl_->index_of.end()) return std::nullopt;
  return impl_->latest[found->second].load();
}

Sampler::Stats Sampler::stats() const {
  Stats stats;
  stats.tick_count = impl_->tick_count.load(std::memory_order_relaxed);
  stats.missed_tick_count = impl_->missed_tick_count.load(std::memory_order_relaxed);
  stats.sample_count = impl_->sample_count.load(std::memory_order_relaxed);
  stats.lost_sample_count = impl_->lost_sample_count.load(std::memory_order_relaxed);
  stats.lost_event_count = impl_->lost_event_count.load(std::memory_order_relaxed);
  stats.cpu_ns = impl_->cpu_ns.load(std::memory_order_relaxed);
  stats.lateness_p50_ns = impl_->lateness.quantile(0.50);
  stats.lateness_p99_ns = impl_->lateness.quantile(0.99);
  stats.lateness_max_ns = impl_->lateness.quantile(1.0);
  stats.scheduling = impl_->scheduling;
  return stats;
}

}  // namespace energyprof::probe
