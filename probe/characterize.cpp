#include "probe/characterize.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <limits>
#include <optional>
#include <thread>

namespace energyprof::probe {
namespace {

constexpr int64_t slow_cost_ns = 200 * ns_per_us;
constexpr int64_t shortest_spacing_ns = 100 * ns_per_us;
constexpr size_t fewest_updates = 5;
constexpr size_t most_polls = 4096;
// A source with a longer period is asked a few times for its cost; its updates would take too long.
constexpr int64_t longest_watched_ns = 200 * ns_per_ms;
constexpr size_t polls_of_unwatched = 3;

int64_t quantile(std::vector<int64_t> values, double ratio) {
  const auto rank = static_cast<size_t>(ratio * static_cast<double>(values.size() - 1) + 0.5);
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(rank);
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

// The energy of a GPU that idles may stand still although it is measured.
bool moves_with_the_cpu(const Channel& channel) {
  return channel.gpu.empty() && channel.name.find("uncore") == std::string::npos;
}

// One source under observation.
class Observation {
 public:
  explicit Observation(SensorSource& source)
      : source_(source),
        spacing_ns_(std::max(shortest_spacing_ns, source.period_ns() / 4)),
        readings_(source.channels().size()),
        watches_(source.channels().size()) {}

  [[nodiscard]] bool is_watched() const { return source_.period_ns() <= longest_watched_ns; }
  [[nodiscard]] bool is_done() const {
    return costs_ns_.size() >= (is_watched() ? most_polls : polls_of_unwatched);
  }
  // When the next poll makes sense.
  [[nodiscard]] int64_t due_ns() const { return costs_ns_.empty() ? 0 : last_ns_ + spacing_ns_; }

  void poll() {
    const int64_t before_ns = now_ns();
    source_.poll(readings_);
    const int64_t after_ns = now_ns();
    costs_ns_.push_back(after_ns - before_ns);
    last_ns_ = before_ns;
    for (size_t i = 0; i < readings_.size(); ++i)
      if (readings_[i].status == PollStatus::ok) watches_[i].see(readings_[i]);
  }

  // Writes what was learnt into the source's channels.
  void conclude(bool on_this_machine) {
    const auto channel_count = static_cast<int64_t>(readings_.size());
    const int64_t cost_ns = quantile(costs_ns_, 0.5);
    const int64_t cost_p99_ns = quantile(costs_ns_, 0.99);
    int64_t fastest_ns = std::numeric_limits<int64_t>::max();
    bool all_known = true;
    for (size_t i = 0; i < readings_.size(); ++i) {
      Channel& channel = source_.channels()[i];
      const Watch& watch = watches_[i];
      channel.read_cost_ns = cost_ns / channel_count;
      channel.read_cost_p99_ns = cost_p99_ns / channel_count;
      channel.quantum = watch.quantum;
      if (watch.gaps_ns.size() >= fewest_updates)
        channel.update_period_ns = quantile(watch.gaps_ns, 0.5);
      all_known = all_known && channel.update_period_ns.has_value();
      fastest_ns = std::min(fastest_ns, channel.update_period_ns.value_or(fastest_ns));
      channel.stands_still = on_this_machine && is_watched() && watch.first_value.has_value() &&
                             channel.quantity == Quantity::energy &&
                             channel.kind == Kind::cumulative && moves_with_the_cpu(channel) &&
                             watch.updates == 0;
    }
    if (all_known && fastest_ns / 2 > source_.period_ns()) source_.set_period_ns(fastest_ns / 2);
    if (cost_ns > slow_cost_ns) source_.mark_slow();
  }

 private:
  // One channel's changes.
  struct Watch {
    std::optional<int64_t> first_value;
    int64_t value = 0;
    int64_t changed_ns = 0;
    size_t updates = 0;
    std::optional<int64_t> quantum;
    std::vector<int64_t> gaps_ns;

    void see(const Reading& reading) {
      if (!first_value) {
        first_value = value = reading.value;
        return;
      }
      if (reading.value == value) return;
      const bool rises = reading.value > value;
      // Unsigned: the distance of two extreme values does not fit a signed one.
      const uint64_t step =
          rises ? static_cast<uint64_t>(reading.value) - static_cast<uint64_t>(value)
                : static_cast<uint64_t>(value) - static_cast<uint64_t>(reading.value);
      if (step <= static_cast<uint64_t>(std::numeric_limits<int64_t>::max()))
        quantum = std::min(quantum.value_or(std::numeric_limits<int64_t>::max()),
                           static_cast<int64_t>(step));
      if (updates++ > 0) gaps_ns.push_back(reading.t_ns - changed_ns);
      changed_ns = reading.t_ns;
      value = reading.value;
    }
  };

  SensorSource& source_;
  int64_t spacing_ns_;
  int64_t last_ns_ = 0;
  std::vector<int64_t> costs_ns_;
  std::vector<Reading> readings_;
  std::vector<Watch> watches_;
};

// Polls in turn whatever is due, without sleeping: a processor is kept busy.
void observe(std::vector<Observation*> pending, int64_t budget_ns) {
  const int64_t end_ns = now_ns() + budget_ns;
  for (Observation* one : pending) one->poll();
  while (now_ns() < end_ns && !pending.empty()) {
    for (Observation* one : pending)
      if (now_ns() >= one->due_ns()) one->poll();
    std::erase_if(pending, [](const Observation* one) { return one->is_done(); });
  }
}

void observe_slow(Observation& one, int64_t budget_ns) {
  const int64_t end_ns = now_ns() + budget_ns;
  one.poll();
  while (!one.is_done() && std::max(now_ns(), one.due_ns()) < end_ns) {
    std::this_thread::sleep_for(std::chrono::nanoseconds(one.due_ns() - now_ns()));
    one.poll();
  }
}

}  // namespace

void characterize(Discovery& discovery, const Root& root, const CharacterizeBudget& budget) {
  std::vector<Observation> observations;
  observations.reserve(discovery.sources.size());
  for (const auto& source : discovery.sources) observations.emplace_back(*source);
  std::vector<Observation*> quick;
  std::vector<std::jthread> slow;
  for (size_t i = 0; i < observations.size(); ++i) {
    Observation& one = observations[i];
    if (discovery.sources[i]->traits().slow)
      slow.emplace_back([&one, &budget] { observe_slow(one, budget.slow_ns); });
    else
      quick.push_back(&one);
  }
  observe(std::move(quick), budget.quick_ns);
  slow.clear();  // joins
  for (Observation& one : observations) one.conclude(root.is_host());
  for (const auto& source : discovery.sources)
    for (const Channel& channel : source->channels())
      if (channel.stands_still)
        discovery.missing.push_back(
            {channel.source,
             fmt::format("'{}' did not move while a processor was kept busy: unsupported here, not "
                         "0 W",
                         channel.name),
             ""});
}

}  // namespace energyprof::probe
