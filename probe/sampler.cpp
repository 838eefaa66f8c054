#include "probe/sampler.h"

#include <fmt/format.h>
#include <linux/futex.h>
#include <pthread.h>
#include <sched.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <boost/lockfree/spsc_queue.hpp>
#include <cmath>
#include <limits>
#include <map>
#include <stdexcept>
#include <thread>
#include <utility>

#include "core/clock.h"
#include "probe/root.h"
#include "probe/text_file.h"

namespace energyprof::probe {
namespace {

constexpr int realtime_priority = 10;
constexpr int64_t gap_report_ns = ns_per_s;
constexpr int64_t cpu_time_report_ns = 250 * ns_per_ms;
constexpr int64_t never = std::numeric_limits<int64_t>::max();

// Adds to a count that only this thread writes: a locked addition would cost more.
void add_to(std::atomic<int64_t>& count, int64_t more) {
  count.store(count.load(std::memory_order_relaxed) + more, std::memory_order_relaxed);
}

// Counts of durations in buckets that are at most one eighth wide.
class Histogram {
 public:
  // For one thread.
  void add(int64_t value_ns) {
    add_to(counts_[bucket(value_ns)], 1);
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

enum class Happening : uint8_t { sensor_gone, sensor_unavailable, missed_ticks, samples_lost };

struct RawEvent {
  Happening what = Happening::sensor_gone;
  int64_t begin_ns = 0;
  int64_t end_ns = 0;
  int64_t count = 0;   // missed_ticks, samples_lost; for the others errno, 0 = none
  size_t channel = 0;  // sensor_gone, sensor_unavailable: index
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

// The newest sample of a channel, written by one thread. t_ns is 0 while it changes, so that a
// reader who sees one t_ns before and after reading the value has a pair that belongs together: who
// reads a new value sees, by release and acquire, that t_ns is no longer the old one. All that a
// sample touches of its channel is here: between two ticks other work takes the caches.
struct LatestSlot {
  int32_t channel_id = 0;
  std::atomic<int64_t> t_ns{0};
  std::atomic<int64_t> value{0};

  void store(const Reading& reading) {
    t_ns.store(0, std::memory_order_relaxed);
    value.store(reading.value, std::memory_order_release);
    t_ns.store(reading.t_ns, std::memory_order_release);
  }
  [[nodiscard]] std::optional<Sampler::Latest> load() const {
    constexpr int tries = 100;
    for (int i = 0; i < tries; ++i) {
      const Sampler::Latest latest{t_ns.load(std::memory_order_acquire),
                                   value.load(std::memory_order_acquire)};
      if (latest.t_ns != 0 && latest.t_ns == t_ns.load(std::memory_order_relaxed)) return latest;
    }
    return std::nullopt;
  }
};

int64_t thread_cpu_ns() {
  timespec ts{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &ts);
  return int64_t{ts.tv_sec} * ns_per_s + ts.tv_nsec;
}

// What the threads are told. Every order changes the word, and a thread that sleeps on it wakes at
// once: no thread ever wakes only to look.
class Orders {
 public:
  static constexpr uint32_t stop_bit = 1;
  static constexpr uint32_t pause_bit = 2;
  static constexpr uint32_t count_step = 4;

  [[nodiscard]] uint32_t get() const { return word_.load(); }
  uint32_t give(uint32_t bits) {
    const uint32_t word = (word_.load() & ~(stop_bit | pause_bit)) + count_step + bits;
    word_.store(word);
    syscall(SYS_futex, &word_, FUTEX_WAKE_PRIVATE, std::numeric_limits<int>::max(), nullptr,
            nullptr, 0);
    return word;
  }
  // Sleeps until the deadline (CLOCK_MONOTONIC), or until the word is no longer `seen`.
  void sleep_until(int64_t deadline_ns, uint32_t seen) const {
    const timespec wake{static_cast<time_t>(deadline_ns / ns_per_s),
                        static_cast<long>(deadline_ns % ns_per_s)};
    while (get() == seen && (deadline_ns == never || now_ns() < deadline_ns))
      syscall(SYS_futex, &word_, FUTEX_WAIT_BITSET_PRIVATE, seen,
              deadline_ns == never ? nullptr : &wake, nullptr, FUTEX_BITSET_MATCH_ANY);
  }

 private:
  std::atomic<uint32_t> word_{0};
  static_assert(sizeof word_ == sizeof(uint32_t));
};

int64_t tick_of(double rate_hz) {
  if (!(rate_hz > 0.0 && rate_hz <= 100'000.0))
    throw std::runtime_error(fmt::format(
        "cannot sample at {} Hz: the rate must be above 0 and at most 100000.", rate_hz));
  return std::max<int64_t>(1, std::llround(static_cast<double>(ns_per_s) / rate_hz));
}

// What all threads of a sampler share: the channels, the orders, the counts.
struct Shared {
  Sampler::Config config;
  int64_t tick_ns = 0;
  std::vector<Channel> channels;
  std::map<int32_t, size_t> index_of;  // channel id -> index
  std::vector<LatestSlot> latest;
  Orders orders;
  std::atomic<bool> idle{false};
  std::atomic<int64_t> tick_count{0};
  std::atomic<int64_t> missed_tick_count{0};
  std::atomic<int64_t> lost_sample_count{0};
  std::atomic<int64_t> lost_event_count{0};
  Histogram lateness;
};

// A thread and the sources that it polls: all quick ones, or the slow ones of one name and GPU.
class Lane {
 public:
  Lane(Shared& shared, std::string name, size_t sample_capacity, bool is_slow)
      : shared_(shared),
        name_(std::move(name)),
        is_slow_(is_slow),
        samples_(sample_capacity),
        events_(shared.config.event_capacity) {}

  void add(SensorSource& source, size_t first_channel) {
    const int64_t tick_ns = shared_.tick_ns;
    Task task;
    task.source = &source;
    task.first_channel = first_channel;
    task.channel_count = source.channels().size();
    task.every = shared_.channels[first_channel].period_ns / tick_ns;
    tasks_.push_back(task);
    readings_.resize(std::max(readings_.size(), task.channel_count));
  }
  [[nodiscard]] const std::string& name() const { return name_; }
  [[nodiscard]] bool is_slow() const { return is_slow_; }

  // Starts the thread; `started` hears of its first round.
  void start() {
    flags_.assign(shared_.channels.size(), 0);
    for (Task& task : tasks_) task.gone_count = 0;
    thread_ = std::thread([this, seen = shared_.orders.get()] { run(seen); });
  }
  void join() {
    if (thread_.joinable()) thread_.join();
  }
  std::thread& thread() { return thread_; }

  // Waits until the thread has obeyed the order `word`.
  void wait_for(uint32_t word) const {
    for (uint32_t done = done_.load(); done != word; done = done_.load()) done_.wait(done);
  }

  void drain(std::vector<Sample>& samples) {
    samples_.consume_all([&](const Sample& sample) { samples.push_back(sample); });
  }
  void drain_events(std::vector<Event>& events) {
    events_.consume_all([&](const RawEvent& raw) { events.push_back(describe(raw)); });
  }
  [[nodiscard]] int64_t cpu_ns() const { return cpu_ns_.load(std::memory_order_relaxed); }
  [[nodiscard]] int64_t sample_count() const {
    return sample_count_.load(std::memory_order_relaxed);
  }

 private:
  // A source and when it is due.
  struct Task {
    SensorSource* source = nullptr;
    int64_t every = 1;  // ticks from poll to poll
    int64_t due = 0;    // next tick
    size_t first_channel = 0;
    size_t channel_count = 0;
    size_t gone_count = 0;
  };
  static constexpr char gone = 1;
  static constexpr char told_unavailable = 2;

  void run(uint32_t seen) {
    prctl(PR_SET_TIMERSLACK, 1UL);
    const int64_t cpu_before_ns = cpu_ns();
    begin_ns_ = now_ns();
    poll_all();
    obeyed(seen);
    int64_t cpu_reported_ns = begin_ns_;
    while (true) {
      const int64_t tick = next_tick();
      const int64_t deadline_ns = tick == never ? never : begin_ns_ + tick * shared_.tick_ns;
      shared_.orders.sleep_until(deadline_ns, seen);
      const uint32_t word = shared_.orders.get();
      const int64_t woke_ns = now_ns();
      if (word != seen) {
        seen = word;
        poll_all();
        obeyed(seen);
        if ((seen & Orders::stop_bit) != 0) break;
        continue;
      }
      if ((seen & Orders::pause_bit) != 0) continue;
      if (!is_slow_) shared_.lateness.add(woke_ns - deadline_ns);
      const int64_t missed = serve((woke_ns - begin_ns_) / shared_.tick_ns);
      if (!is_slow_) add_to(shared_.tick_count, 1);
      if (missed > 0) {
        shared_.missed_tick_count.fetch_add(missed, std::memory_order_relaxed);
        missed_gap_.add(deadline_ns, woke_ns, missed);
      }
      report_gaps(woke_ns, gap_report_ns);
      if (woke_ns - cpu_reported_ns >= cpu_time_report_ns) {
        cpu_ns_.store(cpu_before_ns + thread_cpu_ns(), std::memory_order_relaxed);
        cpu_reported_ns = woke_ns;
      }
    }
    report_gaps(now_ns(), 0);
    cpu_ns_.store(cpu_before_ns + thread_cpu_ns(), std::memory_order_relaxed);
  }

  // Orders begin and end with a poll of everything: what happens between two of them lies between
  // two samples.
  void poll_all() {
    const int64_t tick = (now_ns() - begin_ns_) / shared_.tick_ns;
    for (Task& task : tasks_) {
      poll(task);
      task.due = tick + task.every;
    }
  }

  void obeyed(uint32_t word) {
    paused_ = (word & Orders::pause_bit) != 0;
    done_.store(word);
    done_.notify_all();
  }

  [[nodiscard]] int64_t next_tick() const {
    int64_t tick = never;
    if (paused_) return tick;
    for (const Task& task : tasks_)
      if (task.gone_count < task.channel_count) tick = std::min(tick, task.due);
    return tick;
  }

  // Polls what is due at `tick` or was before. Returns how many ticks went unserved.
  int64_t serve(int64_t tick) {
    int64_t missed = 0;
    for (Task& task : tasks_) {
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
    if (task.source->traits().wakes_device && shared_.idle.load(std::memory_order_relaxed)) return;
    const std::span<Reading> out(readings_.data(), task.channel_count);
    task.source->poll(out);
    for (size_t i = 0; i < out.size(); ++i) take(task, task.first_channel + i, out[i]);
  }

  void take(Task& task, size_t channel, const Reading& reading) {
    char& flags = flags_[channel];
    if ((flags & gone) != 0) return;
    switch (reading.status) {
      case PollStatus::ok:
        push({shared_.latest[channel].channel_id, reading.t_ns, reading.value,
              reading.width_ns > wide_read_ns
                  ? static_cast<uint32_t>(
                        std::min<int64_t>(reading.width_ns, std::numeric_limits<uint32_t>::max()))
                  : 0});
        shared_.latest[channel].store(reading);
        break;
      case PollStatus::retry:
        if (reading.error == 0 || is_transient(reading.error) || (flags & told_unavailable) != 0)
          break;
        flags |= told_unavailable;
        push({Happening::sensor_unavailable, reading.t_ns, reading.t_ns, reading.error, channel});
        break;
      case PollStatus::gone:
        flags |= gone;
        ++task.gone_count;
        push({Happening::sensor_gone, reading.t_ns, reading.t_ns, reading.error, channel});
        break;
    }
  }

  void push(const Sample& sample) {
    if (samples_.push(sample)) {
      add_to(sample_count_, 1);
    } else {
      shared_.lost_sample_count.fetch_add(1, std::memory_order_relaxed);
      lost_gap_.add(sample.t_ns, sample.t_ns, 1);
    }
  }

  void push(const RawEvent& event) {
    if (!events_.push(event)) shared_.lost_event_count.fetch_add(1, std::memory_order_relaxed);
  }

  // Turns gaps that began at least `age_ns` before `at_ns` into events.
  void report_gaps(int64_t at_ns, int64_t age_ns) {
    for (auto [gap, what] : {std::pair{&missed_gap_, Happening::missed_ticks},
                             std::pair{&lost_gap_, Happening::samples_lost}}) {
      if (gap->count == 0 || at_ns - gap->begin_ns < age_ns) continue;
      push({what, gap->begin_ns, gap->end_ns, gap->count, 0});
      *gap = {};
    }
  }

  [[nodiscard]] Event describe(const RawEvent& raw) const {
    const Channel& channel = shared_.channels[raw.channel];
    Event event;
    event.t_ns = raw.begin_ns;
    event.severity = Severity::warning;
    switch (raw.what) {
      case Happening::sensor_gone:
        event.kind = "sensor-gone";
        event.channel_id = channel.id;
        event.text = fmt::format("'{}' went away ({}{}); recording goes on without it.",
                                 channel.name, channel.origin, because(raw));
        break;
      case Happening::sensor_unavailable:
        event.kind = "sensor-unavailable";
        event.channel_id = channel.id;
        event.text = fmt::format("'{}' cannot be read now ({}{}); it is tried again.", channel.name,
                                 channel.origin, because(raw));
        break;
      case Happening::missed_ticks:
        event.kind = "missed-ticks";
        event.end_ns = raw.end_ns;
        event.text =
            fmt::format("{} sensor ticks of {:.3f} ms were missed{}.", raw.count,
                        static_cast<double>(shared_.tick_ns) / static_cast<double>(ns_per_ms),
                        is_slow_ ? fmt::format(" by the thread for {}", name_) : "");
        break;
      case Happening::samples_lost:
        event.kind = "samples-lost";
        event.end_ns = raw.end_ns;
        event.text =
            fmt::format("{} samples of {} were lost: the queue was full.", raw.count, name_);
        break;
    }
    return event;
  }

  static std::string because(const RawEvent& raw) {
    return raw.count == 0 ? "" : ": " + errno_text(static_cast<int>(raw.count));
  }

  Shared& shared_;
  std::string name_;
  bool is_slow_;
  boost::lockfree::spsc_queue<Sample> samples_;
  boost::lockfree::spsc_queue<RawEvent> events_;
  std::atomic<uint32_t> done_{std::numeric_limits<uint32_t>::max()};  // the last order obeyed
  std::atomic<int64_t> cpu_ns_{0};
  std::atomic<int64_t> sample_count_{0};

  // The thread's own.
  std::vector<Task> tasks_;
  std::vector<Reading> readings_;
  std::vector<char> flags_;  // by channel
  Gap missed_gap_;
  Gap lost_gap_;
  int64_t begin_ns_ = 0;
  bool paused_ = false;

  std::thread thread_;
};

// The polling period in ticks: the config's for this source, else its own.
int64_t ticks_between_polls(const SensorSource& source, const Sampler::Config& config,
                            int64_t tick_ns) {
  const auto wanted = config.periods_ns.find(std::string(source.name()));
  const int64_t period_ns = wanted == config.periods_ns.end() ? source.period_ns() : wanted->second;
  return std::max<int64_t>(1, (period_ns + tick_ns / 2) / tick_ns);
}

}  // namespace

struct Sampler::Impl {
  Impl(std::span<const std::unique_ptr<SensorSource>> sources, const Config& config) {
    shared.config = config;
    shared.tick_ns = tick_of(config.rate_hz);
    for (const auto& source : sources) {
      const size_t first_channel = shared.channels.size();
      for (Channel channel : std::as_const(*source).channels()) {
        channel.period_ns = ticks_between_polls(*source, config, shared.tick_ns) * shared.tick_ns;
        shared.index_of.emplace(channel.id, shared.channels.size());
        shared.channels.push_back(std::move(channel));
      }
      lane_of(*source).add(*source, first_channel);
    }
    shared.latest = std::vector<LatestSlot>(shared.channels.size());
    for (size_t i = 0; i < shared.channels.size(); ++i)
      shared.latest[i].channel_id = shared.channels[i].id;
  }

  Lane& lane_of(const SensorSource& source) {
    const SourceTraits& traits = source.traits();
    const bool slow = traits.slow;
    std::string name(slow ? source.name() : "the quick sources");
    for (const std::string& owner : {traits.gpu, traits.chip})
      if (slow && !owner.empty()) name += " of " + owner;
    for (const auto& lane : lanes)
      if (lane->is_slow() == slow && lane->name() == name) return *lane;
    const size_t capacity = shared.config.sample_capacity;
    return *lanes.emplace_back(std::make_unique<Lane>(
        shared, name, slow ? std::max<size_t>(1, capacity / 16) : capacity, slow));
  }

  // Gives an order and waits until every thread has obeyed it.
  void order(uint32_t bits) {
    const uint32_t word = shared.orders.give(bits);
    for (const auto& lane : lanes) lane->wait_for(word);
  }

  Shared shared;
  std::vector<std::unique_ptr<Lane>> lanes;
  std::string scheduling;
  bool running = false;
  bool paused = false;
};

Sampler::Sampler(std::span<const std::unique_ptr<SensorSource>> sources, const Config& config)
    : impl_(std::make_unique<Impl>(sources, config)) {}

Sampler::~Sampler() { stop(); }

std::vector<Channel> Sampler::channels() const { return impl_->shared.channels; }

void Sampler::start() {
  if (impl_->running) return;
  const uint32_t word = impl_->shared.orders.give(0);
  impl_->running = true;
  impl_->paused = false;
  impl_->scheduling = "SCHED_OTHER";
  for (const auto& lane : impl_->lanes) {
    lane->start();
    if (!impl_->shared.config.realtime || lane->is_slow()) continue;
    const sched_param param{realtime_priority};
    const int error = pthread_setschedparam(lane->thread().native_handle(), SCHED_FIFO, &param);
    impl_->scheduling =
        error == 0 ? fmt::format("SCHED_FIFO, priority {}", realtime_priority)
                   : fmt::format("SCHED_OTHER (SCHED_FIFO refused: {})", errno_text(error));
  }
  for (const auto& lane : impl_->lanes) lane->wait_for(word);
}

void Sampler::stop() {
  if (!impl_->running) return;
  impl_->shared.orders.give(Orders::stop_bit);
  for (const auto& lane : impl_->lanes) lane->join();
  impl_->running = false;
}

void Sampler::pause() {
  if (!impl_->running || impl_->paused) return;
  impl_->order(Orders::pause_bit);
  impl_->paused = true;
}

void Sampler::resume() {
  if (!impl_->running || !impl_->paused) return;
  impl_->order(0);
  impl_->paused = false;
}

void Sampler::set_idle(bool idle) { impl_->shared.idle.store(idle); }

void Sampler::drain(std::vector<Sample>& samples) {
  for (const auto& lane : impl_->lanes) lane->drain(samples);
}

void Sampler::drain_events(std::vector<Event>& events) {
  for (const auto& lane : impl_->lanes) lane->drain_events(events);
}

std::optional<Sampler::Latest> Sampler::latest(int32_t channel_id) const {
  const auto found = impl_->shared.index_of.find(channel_id);
  if (found == impl_->shared.index_of.end()) return std::nullopt;
  return impl_->shared.latest[found->second].load();
}

Sampler::Stats Sampler::stats() const {
  const Shared& shared = impl_->shared;
  Stats stats;
  stats.tick_count = shared.tick_count.load(std::memory_order_relaxed);
  stats.missed_tick_count = shared.missed_tick_count.load(std::memory_order_relaxed);
  stats.lost_sample_count = shared.lost_sample_count.load(std::memory_order_relaxed);
  stats.lost_event_count = shared.lost_event_count.load(std::memory_order_relaxed);
  for (const auto& lane : impl_->lanes) {
    stats.cpu_ns += lane->cpu_ns();
    stats.sample_count += lane->sample_count();
  }
  stats.thread_count = static_cast<int64_t>(impl_->lanes.size());
  stats.lateness_p50_ns = shared.lateness.quantile(0.50);
  stats.lateness_p99_ns = shared.lateness.quantile(0.99);
  stats.lateness_max_ns = shared.lateness.quantile(1.0);
  stats.scheduling = impl_->scheduling;
  return stats;
}

}  // namespace energyprof::probe
