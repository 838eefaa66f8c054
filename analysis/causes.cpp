#include "analysis/causes.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <utility>

#include "analysis/stats.h"

namespace energyprof::analysis {
namespace {

/// What may have slowed a frame. Finer than Cause: a quota stops the work without touching the
/// clock, and a low clock may have no known reason.
enum Hypothesis : std::size_t {
  power,
  thermal,
  other,
  quota,
  low_clock,
  misses,
  interruption,
  work,
  nothing,
  hypothesis_count
};
using Likelihood = std::array<double, hypothesis_count>;

constexpr double strongest = 1000;  // no reading is believed more than this
constexpr double denial = 0.02;     // a sensor that looked and saw nothing
// A clock that did not fall: then it cannot have been held down, whatever a flag says.
constexpr double clock_denial = 0.002;
constexpr double min_set_share = 0.3;    // of a frame's time in which its reason is set
constexpr double min_trial_share = 0.8;  // of what a counter's reading is about
constexpr std::size_t min_trial_reference = 8;
constexpr std::size_t min_cell_reference = 3;
constexpr int em_round_count = 30;
/// What it takes to name the reason that low clocks usually have in a run, where none was read.
constexpr double min_habit_confidence = 0.97;
constexpr std::ptrdiff_t max_reading_count = 32;
/// A group that uses up its quota is stopped once in each period, which is 100 ms long unless
/// somebody set another (Documentation/scheduler/sched-bwc.rst of Linux).
constexpr int64_t quota_period_ns = 100'000'000;
/// About a frame: what others used is counted in ticks, too coarse for less.
constexpr int64_t company_ns = 1'000'000'000;

Cause cause_of(std::size_t hypothesis) {
  switch (hypothesis) {
    case power:
      return Cause::throttle_power;
    case thermal:
      return Cause::throttle_thermal;
    case other:
    case quota:
      return Cause::throttle_other;
    case misses:
      return Cause::cache_miss;
    case interruption:
      return Cause::interference;
    case work:
      return Cause::more_work;
    default:
      return Cause::unexplained;
  }
}

/// What a source speaks for.
std::optional<std::size_t> hypothesis_of(const ThrottleSource& source) {
  if (source.quota) return quota;
  switch (source.reason) {
    case ThrottleClass::power_sustained:
    case ThrottleClass::power_burst:
    case ThrottleClass::power_peak:
      return power;
    case ThrottleClass::thermal:
      return thermal;
    case ThrottleClass::external:
    case ThrottleClass::vr:
    case ThrottleClass::os:
      return other;
    case ThrottleClass::none:
      // Inferred, it is a low clock, which was looked at already.
      if (source.inferred) return std::nullopt;
      return low_clock;
  }
  return std::nullopt;
}

struct Window {
  int64_t begin_ns = 0;
  int64_t end_ns = 0;
};

/// Values of normal frames, to ask how unusual one is. Frames that a slow sensor read together
/// count as one: a hundred frames within one poll are no hundred witnesses.
class Tail {
 public:
  explicit Tail(int64_t resolution_ns) : resolution_ns_(resolution_ns) {}
  void add(const TimedFrame& frame, double value) {
    values_.push_back(value);
    const int64_t reading = frame.begin_ns / resolution_ns_;
    if (reading_count_ == 0 || reading != last_reading_) ++reading_count_;
    last_reading_ = reading;
  }
  void sort() { std::sort(values_.begin(), values_.end()); }
  [[nodiscard]] std::size_t count() const { return values_.size(); }
  /// Share of normal values at least as large, never below half of one reading.
  [[nodiscard]] double at_least(double value) const {
    const auto first = std::lower_bound(values_.begin(), values_.end(), value);
    const auto share = values_.empty() ? 0.0
                                       : static_cast<double>(values_.end() - first) /
                                             static_cast<double>(values_.size());
    const auto count = static_cast<double>(reading_count_);
    return (share * count + 0.5) / (count + 1);
  }
  [[nodiscard]] double quantile_of(double share) const {
    return values_[static_cast<std::size_t>(share * static_cast<double>(values_.size() - 1))];
  }

 private:
  int64_t resolution_ns_;
  int64_t last_reading_ = 0;
  std::size_t reading_count_ = 0;
  std::vector<double> values_;
};

/// Likelihood ratio of a reading that the cause would show nine times in ten.
double ratio_against(const Tail& tail, double value) {
  return std::min(0.9 / tail.at_least(value), strongest);
}

/// A number per frame with what is normal for it: the median of the normal frames of its trial, or
/// of its cell where the trial has too few.
class Reference {
 public:
  Reference(std::span<const TimedFrame> frames, const std::vector<bool>& normal,
            const std::vector<std::optional<double>>& values) {
    std::map<std::size_t, std::vector<double>> by_trial;
    std::map<std::size_t, std::vector<double>> by_cell;
    for (std::size_t i = 0; i < frames.size(); ++i) {
      if (!normal[i] || !values[i]) continue;
      by_trial[frames[i].trial_index].push_back(*values[i]);
      by_cell[frames[i].cell].push_back(*values[i]);
    }
    for (const auto& [trial, list] : by_trial)
      if (list.size() >= min_trial_reference) trial_[trial] = median(list);
    for (const auto& [cell, list] : by_cell)
      if (list.size() >= min_cell_reference) cell_[cell] = median(list);
  }
  [[nodiscard]] std::optional<double> of(const TimedFrame& frame) const {
    if (const auto found = trial_.find(frame.trial_index); found != trial_.end())
      return found->second;
    if (const auto found = cell_.find(frame.cell); found != cell_.end()) return found->second;
    return std::nullopt;
  }

 private:
  std::map<std::size_t, double> trial_;
  std::map<std::size_t, double> cell_;
};

/// One slow frame while it is judged.
struct Case {
  const TimedFrame* frame = nullptr;
  const SlowFrame* slow = nullptr;
  Window episode;
  double excess_s = 0;          // time lost
  double episode_excess_s = 0;  // by all frames of the episode
  Likelihood likelihood{};
  std::array<bool, hypothesis_count> shown{};  // some reading speaks for it
  bool clock_low = false;                      // and that explains the time
  bool off_processor = false;  // others had the processors for the time that was lost
  std::vector<std::pair<std::size_t, Evidence>> evidence;  // by hypothesis

  /// Multiplies the likelihood of a hypothesis.
  void weigh(std::size_t hypothesis, double ratio) { likelihood[hypothesis] *= ratio; }
};

/// Where a sensor of this resolution can see the frame: itself, or as much of its episode around it
/// as the sensor needs.
Window window_of(const Case& one, int64_t resolution_ns) {
  const int64_t length_ns = one.frame->end_ns - one.frame->begin_ns;
  if (length_ns >= resolution_ns) return {one.frame->begin_ns, one.frame->end_ns};
  const int64_t missing_ns = resolution_ns - length_ns;
  Window window{one.frame->begin_ns - missing_ns / 2, one.frame->end_ns + missing_ns / 2};
  if (one.episode.end_ns - one.episode.begin_ns <= resolution_ns) return one.episode;
  if (window.begin_ns < one.episode.begin_ns) {
    window.end_ns += one.episode.begin_ns - window.begin_ns;
    window.begin_ns = one.episode.begin_ns;
  }
  if (window.end_ns > one.episode.end_ns) {
    window.begin_ns -= window.end_ns - one.episode.end_ns;
    window.end_ns = one.episode.end_ns;
  }
  return window;
}

class Judge {
 public:
  Judge(const RunRecord& run, std::span<const TimedFrame> frames, const OutlierSearch& search,
        const Throttling& throttling)
      : run_(run),
        frames_(frames),
        throttling_(throttling),
        sleeps_(sleeps_of(run)),
        normal_(frames.size(), true) {
    std::vector<Window> episodes(search.episode_count, Window{INT64_MAX, INT64_MIN});
    for (const SlowFrame& slow : search.slow) {
      normal_[slow.frame] = false;
      Window& episode = episodes[slow.episode];
      episode.begin_ns = std::min(episode.begin_ns, frames[slow.frame].begin_ns);
      episode.end_ns = std::max(episode.end_ns, frames[slow.frame].end_ns);
    }
    for (const SlowFrame& slow : search.slow) {
      Case one;
      one.frame = &frames[slow.frame];
      one.slow = &slow;
      one.episode = episodes[slow.episode];
      one.excess_s = (one.frame->ms - slow.baseline_ms) * 1e-3;
      one.likelihood.fill(1);
      cases_.push_back(std::move(one));
    }
    std::vector<double> lost_s(search.episode_count, 0.0);
    for (const Case& one : cases_) lost_s[one.slow->episode] += one.excess_s;
    for (Case& one : cases_) one.episode_excess_s = lost_s[one.slow->episode];
    calm_.resize(frames.size());
    for (std::size_t i = 0; i < frames.size();) {
      std::size_t last = i;
      while (last + 1 < frames.size() && normal_[last + 1] == normal_[i] &&
             frames[last + 1].trial_index == frames[i].trial_index)
        ++last;
      const Window stretch{frames[i].begin_ns, frames[last].end_ns};
      for (; i <= last; ++i) calm_[i] = stretch;
    }
    trials_ = trial_spans(frames, &TimedFrame::trial_index);
    length_.assign(search.episode_count, 0);
    for (const SlowFrame& slow : search.slow) ++length_[slow.episode];
  }

  std::vector<Attribution> judge() {
    look_at_clock();
    look_after_stops();
    look_at_throttling();
    for (const Told& told : ask_channels()) {
      if (told.channel->quantity == Quantity::interference)
        look_at_interference(told);
      else
        look_at_misses(told);
    }
    merge_looks();
    look_at_work(&FrameRecord::ray_count, "frames.ray_count");
    look_at_work(&FrameRecord::node_visit_count, "frames.node_visit_count");
    return decide();
  }

 private:
  // -------------------------------------------------------------------------- clock

  /// Did the same work run at a lower clock? Work is clock x time, so the clock explains a frame
  /// whose time grew as its mean clock fell.
  void look_at_clock() {
    clock_ = device_clock(run_, frames_);
    if (!clock_) return;
    const DeviceClock* clock = &*clock_;
    std::vector<std::optional<double>> values(frames_.size());
    std::vector<std::optional<double>> own_values(frames_.size());
    for (std::size_t i = 0; i < frames_.size(); ++i) {
      // What was read during slow frames says nothing of the normal ones behind them.
      if (clock->sample_count(calm_[i].begin_ns, frames_[i].end_ns) == 0) continue;
      values[i] = clock->over(frames_[i].begin_ns, frames_[i].end_ns);
      // Many frames that share one reading are no sure level of their trial.
      if (clock->sample_count(frames_[i].begin_ns, frames_[i].end_ns) > 0)
        own_values[i] = values[i];
    }
    const Reference reference(frames_, normal_, own_values);
    Tail tail(clock->poll_ns());
    std::vector<double> steady;
    for (std::size_t i = 0; i < frames_.size(); ++i)
      if (normal_[i] && values[i]) {
        if (const auto expected = reference.of(frames_[i]))
          tail.add(frames_[i], std::log(*expected / *values[i]));
        steady.push_back(*values[i]);
      }
    tail.sort();
    if (tail.count() < min_cell_reference) return;
    // A few normal frames that straddle an event do not widen what is normal.
    const double usual = std::max(tail.quantile_of(0.9), 0.0);
    const double run_level = median(steady);
    const Channel& channel = run_.channels[clock->channels.front()];
    const double hz = clock->steady_hz.front();
    for (Case& one : cases_) {
      const Window window = window_of(one, clock->poll_ns());
      const auto seen = clock->over(window.begin_ns, window.end_ns);
      // Readings from before and after, where they agree, stand for what is in between.
      if (!seen) continue;
      const bool read = clock->sample_count(window.begin_ns, window.end_ns) > 0;
      const double expected = reference.of(*one.frame).value_or(run_level);
      const double fall = std::log(expected / *seen);
      const double needed = std::log(one.slow->ratio);
      one.evidence.emplace_back(low_clock, Evidence{channel.name, *seen * hz, expected * hz, "Hz"});
      if (fall > std::max(0.05, 1.5 * usual) && fall > 0.5 * needed) {
        one.clock_low = true;
        const double ratio = ratio_against(tail, fall);
        for (const std::size_t h : {power, thermal, other, low_clock}) one.weigh(h, ratio);
        one.shown[low_clock] = true;
        // Time that the clock explains needs no other explanation.
        for (const std::size_t h : {misses, interruption}) one.weigh(h, 0.2);
      } else if (read && fall < 0.5 * needed) {
        // Less than half of the time: the less, the more something else must have taken the rest.
        const double missing = std::min((0.5 - fall / needed) / 0.25, 1.0);
        for (const std::size_t h : {power, thermal, other, low_clock})
          one.weigh(h, std::pow(clock_denial, missing));
      } else {
        one.weigh(low_clock, denial);
      }
    }
  }

  // -------------------------------------------------------------------------- reasons

  /// What a source says of a stretch: the share in which it was set.
  static double set_share(const ThrottleSource& source, const Window& window) {
    return source.active.share(window.begin_ns, window.end_ns);
  }

  /// The same of a normal frame. Of a level that is polled less often than frames end, a reading
  /// also speaks for frames next to the one in which it was taken: then only what was read since
  /// the last slow frame counts.
  [[nodiscard]] std::optional<double> said_normally(std::size_t i,
                                                    const ThrottleSource& source) const {
    const TimedFrame& frame = frames_[i];
    const Channel& channel = run_.channels[source.channel];
    const auto found = run_.series.find(channel.id);
    if (source.inferred || !is_level(channel) || found == run_.series.end() ||
        frame.end_ns - frame.begin_ns >= source.poll_ns)
      return set_share(source, {frame.begin_ns, frame.end_ns});
    const auto& t_ns = found->second.t_ns;
    const auto next = std::lower_bound(t_ns.begin(), t_ns.end(), frame.end_ns);
    if (next == t_ns.begin() || *(next - 1) < calm_[i].begin_ns) return std::nullopt;
    return source.active.share(*(next - 1), *(next - 1) + 1) > 0 ? 1.0 : 0.0;
  }

  /// What the source that says most has to say of a case and a hypothesis.
  struct Look {
    double best = 0;  // likelihood ratio; 0: no source looked
    std::vector<Evidence> evidence;
    bool set = false;
    bool partial = false;  // a source of this kind did not look
  };
  using LooksByHypothesis = std::array<Look, hypothesis_count>;

  /// Threads that a quota lets go on may all be put on one processor: then they wait for each other
  /// while others idle, which no counter of stops tells. Sensed as own waiting, soon after a stop,
  /// that nobody else's work accounts for.
  void look_after_stops() {
    after_stops_.resize(cases_.size());
    const auto wait = counter_called("process.cpu_wait");
    const auto own = counter_called("process.cpu_time");
    const auto busy = counter_called("proc.stat.busy");
    if (!wait || !own || !busy) return;
    std::vector<std::optional<double>> waits(frames_.size());
    for (std::size_t i = 0; i < frames_.size(); ++i)
      waits[i] = said_by(*wait, {frames_[i].begin_ns, frames_[i].end_ns});
    const std::vector<bool> undisturbed = normal_without_stops(wait->resolution_ns());
    const Reference reference(frames_, undisturbed, waits);
    const Tail tail = beyond_usual(*wait, undisturbed, waits, reference);
    if (tail.count() < min_cell_reference) return;
    for (std::size_t c = 0; c < cases_.size(); ++c) {
      const Case& one = cases_[c];
      const TimedFrame& frame = *one.frame;
      const auto& rate = waits[one.slow->frame];
      // At the ends of a run less was read.
      const Window around{
          std::max({frame.begin_ns - company_ns / 2, busy->t_ns().front(), own->t_ns().front()}),
          std::min({frame.end_ns + company_ns / 2, busy->t_ns().back(), own->t_ns().back()})};
      if (around.end_ns - around.begin_ns < company_ns / 4) continue;
      const auto all_s = busy->over(around.begin_ns, around.end_ns);
      const auto own_s = own->over(around.begin_ns, around.end_ns);
      const auto stop = stop_before(frame);
      if (!rate || !all_s || !own_s || !stop) continue;
      const auto expected = reference.of(frame);
      if (!expected) continue;
      const double length_s = frame.ms * 1e-3;
      const double waited_s = (*rate - *expected) * length_s;
      if (waited_s < 0.5 * one.excess_s || (*all_s - *own_s) * length_s > 0.5 * waited_s) continue;
      after_stops_[c] = Look{ratio_against(tail, waited_s),
                             {{"process.cpu_wait", *rate, *expected, "s/s"}, *stop},
                             true};
    }
  }

  /// What a quota stopped of the period before a frame, if it did.
  [[nodiscard]] std::optional<Evidence> stop_before(const TimedFrame& frame) const {
    for (const ThrottleSource& source : throttling_.sources) {
      if (!source.quota) continue;
      const double stopped_s =
          source.active.seconds(frame.begin_ns - quota_period_ns, frame.begin_ns);
      if (stopped_s > 0)
        return Evidence{run_.channels[source.channel].name, stopped_s, std::nullopt, "s"};
    }
    return std::nullopt;
  }

  [[nodiscard]] std::optional<ChannelTrack> counter_called(std::string_view name) const {
    for (const Channel& channel : run_.channels) {
      const auto series = run_.series.find(channel.id);
      if (channel.name == name && channel.kind == Kind::cumulative && series != run_.series.end() &&
          !series->second.t_ns.empty())
        return ChannelTrack(channel, series->second, sleeps_);
    }
    return std::nullopt;
  }

  /// A quota stops the work: what it took, beyond what it takes of every normal frame, must be the
  /// time that was lost.
  void look_at_quota(const ThrottleSource& source, std::vector<LooksByHypothesis>& looks) const {
    std::vector<std::optional<double>> stopped_s(frames_.size());
    for (std::size_t i = 0; i < frames_.size(); ++i)
      if (source.known.share(frames_[i].begin_ns, frames_[i].end_ns) >= 0.5)
        stopped_s[i] = source.active.seconds(frames_[i].begin_ns, frames_[i].end_ns);
    const Reference reference(frames_, normal_, stopped_s);
    Tail tail(source.poll_ns);
    for (std::size_t i = 0; i < frames_.size(); ++i)
      if (normal_[i] && stopped_s[i])
        tail.add(frames_[i], *stopped_s[i] - reference.of(frames_[i]).value_or(0));
    tail.sort();
    for (std::size_t c = 0; c < cases_.size(); ++c) {
      const Case& one = cases_[c];
      const auto& stopped = stopped_s[one.slow->frame];
      if (!stopped) continue;
      const double expected_s = reference.of(*one.frame).value_or(0);
      const double lost_s = *stopped - expected_s;
      const bool set = lost_s > 0 && lost_s >= 0.5 * one.excess_s;
      double ratio = denial;
      if (set)
        ratio = ratio_against(tail, lost_s);
      else if (lost_s > 0.05 * one.excess_s || !seen_within(one, source))
        ratio = 0.5;
      Look said{ratio, {{run_.channels[source.channel].name, *stopped, expected_s, "s"}}, set};
      if (after_stops_[c].best > ratio) said = after_stops_[c];
      if (said.best > looks[c][quota].best) looks[c][quota] = std::move(said);
    }
  }

  void look_at_throttling() {
    std::vector<LooksByHypothesis> looks(cases_.size());
    std::vector<std::array<bool, hypothesis_count>> specific(cases_.size());
    for (auto& flags : specific) flags.fill(false);
    for (const ThrottleSource& source : throttling_.sources) {
      const auto hypothesis = hypothesis_of(source);
      if (!hypothesis) continue;
      if (source.quota) {
        look_at_quota(source, looks);
        continue;
      }
      Tail of_run(source.poll_ns);
      std::map<std::size_t, Tail> of_cells;
      for (std::size_t i = 0; i < frames_.size(); ++i) {
        const TimedFrame& frame = frames_[i];
        if (!normal_[i] || source.known.share(frame.begin_ns, frame.end_ns) <= 0.5) continue;
        const auto share = said_normally(i, source);
        if (!share) continue;
        of_run.add(frame, *share);
        of_cells.try_emplace(frame.cell, source.poll_ns).first->second.add(frame, *share);
      }
      of_run.sort();
      for (auto& [cell, of_cell] : of_cells) of_cell.sort();
      // How the machine runs; but where most frames are slow, their reason is most of the time,
      // too. Then the normal frames of the cell tell.
      const bool is_usual = source.regime && of_run.at_least(min_set_share) > 0.5;
      const Channel& channel = run_.channels[source.channel];
      for (std::size_t c = 0; c < cases_.size(); ++c) {
        Case& one = cases_[c];
        const auto of_cell = of_cells.find(one.frame->cell);
        if (is_usual &&
            (of_cell == of_cells.end() || of_cell->second.count() < min_trial_reference ||
             of_cell->second.at_least(min_set_share) > 0.5))
          continue;
        const Tail& tail = is_usual ? of_cell->second : of_run;
        const Window window = window_of(one, source.poll_ns);
        Look& look = looks[c][*hypothesis];
        std::optional<double> said;
        if (source.known.share(window.begin_ns, window.end_ns) >= 0.5)
          said = is_level(channel) && !source.inferred &&
                         one.frame->end_ns - one.frame->begin_ns < source.poll_ns
                     ? share_of_readings(one, source, window)
                     : set_share(source, window);
        if (!said) {
          look.partial = true;
          continue;
        }
        const double share = *said;
        const bool set = share >= min_set_share;
        double ratio = denial;
        if (set) {
          ratio = ratio_against(tail, share);
          if (source.inferred) ratio = std::min(ratio, 0.9 / source.chance_ratio);
        } else if (share > 0.1 * min_set_share || !seen_within(one, source)) {
          ratio = 0.5;
        }
        if (set && source.reason != ThrottleClass::none) specific[c][*hypothesis] = true;
        if (ratio > look.best) {
          look.best = ratio;
          look.set = set;
          look.evidence = {{channel.name, share,
                            tail.count() > 0 ? std::optional(tail.quantile_of(0.5)) : std::nullopt,
                            "1"}};
        }
      }
    }
    // The reasons that some frame of an episode had.
    std::vector<std::array<bool, hypothesis_count>> of_episode(length_.size());
    for (auto& flags : of_episode) flags.fill(false);
    for (std::size_t c = 0; c < cases_.size(); ++c)
      for (const std::size_t h : {power, thermal, other})
        of_episode[cases_[c].slow->episode][h] |= specific[c][h];
    for (std::size_t c = 0; c < cases_.size(); ++c) {
      Case& one = cases_[c];
      // "Throttled" and a reason are one statement. Read a moment apart, the one may be set before
      // the other: then it is the reason that the episode has. Where nothing in the episode is
      // power or heat, it is another.
      Look& held = looks[c][low_clock];
      const auto denied = [&](Hypothesis h) {
        return looks[c][h].best == denial && !looks[c][h].partial;
      };
      const auto& reasons = of_episode[one.slow->episode];
      const auto reason = std::find(reasons.begin(), reasons.end(), true);
      if (held.set && (specific[c][power] || specific[c][thermal] || specific[c][other]))
        held = {};
      else if (held.set && std::count(reasons.begin(), reasons.end(), true) == 1)
        looks[c][static_cast<std::size_t>(reason - reasons.begin())] = std::exchange(held, {});
      else if (held.set && reason == reasons.end() && denied(power) && denied(thermal))
        looks[c][other] = std::exchange(held, {});
      bool any_set = false;
      for (const std::size_t h : {power, thermal, other, quota, low_clock}) {
        Look& look = looks[c][h];
        if (look.best == 0) continue;
        one.weigh(h, look.best);
        one.shown[h] = one.shown[h] || (look.set && look.best > 1);
        any_set = any_set || (h != quota && h != low_clock && one.shown[h]);
        for (Evidence& seen : look.evidence) one.evidence.emplace_back(h, std::move(seen));
      }
      // A clock that is low while a reason is set is low for that reason.
      if (any_set) one.weigh(low_clock, 0.05);
    }
  }

  static bool is_level(const Channel& channel) { return channel.kind != Kind::cumulative; }

  /// Of a sensor that is polled less often than frames end: the share of the readings of the
  /// frame's episode that are set, of those near the frame if there are any. Only readings count at
  /// which the clock was what it was in the frame: another clock may have another reason. Where
  /// nobody looked during the episode, readings that are set on both sides of it stand for it;
  /// nullopt otherwise.
  [[nodiscard]] std::optional<double> share_of_readings(const Case& one,
                                                        const ThrottleSource& source,
                                                        const Window& near) const {
    const auto found = run_.series.find(run_.channels[source.channel].id);
    if (found == run_.series.end()) return std::nullopt;
    const SampleSeries& series = found->second;
    const auto place = [&](int64_t t_ns) {
      return std::lower_bound(series.t_ns.begin(), series.t_ns.end(), t_ns) - series.t_ns.begin();
    };
    const double clock =
        clock_ ? clock_->over(one.frame->begin_ns, one.frame->end_ns).value_or(0) : 0;
    const auto share_in = [&](const Window& window) -> std::optional<double> {
      // In a long episode the readings nearest to the frame are enough.
      const auto middle = place(one.frame->begin_ns);
      const auto first = std::max(place(window.begin_ns), middle - max_reading_count);
      const auto last = std::min(place(window.end_ns), middle + max_reading_count);
      std::size_t count = 0;
      std::size_t set = 0;
      for (auto i = first; i < last; ++i) {
        const int64_t t_ns = series.t_ns[static_cast<std::size_t>(i)];
        const auto then = clock > 0 ? clock_->over(t_ns, t_ns + 1) : std::nullopt;
        if (then && std::abs(std::log(*then / clock)) > 0.12) continue;
        ++count;
        if (source.active.share(t_ns, t_ns + 1) > 0) ++set;
      }
      if (count == 0) return std::nullopt;
      return static_cast<double>(set) / static_cast<double>(count);
    };
    if (const auto share = share_in(near)) return share;
    if (const auto share = share_in(one.episode)) return share;
    const double around = source.active.share(one.episode.begin_ns - source.poll_ns,
                                              one.episode.end_ns + source.poll_ns);
    return around > 0.99 ? std::optional(around) : std::nullopt;
  }

  /// Whether the episode is long enough for the source.
  static bool seen_within(const Case& one, const ThrottleSource& source) {
    return one.episode.end_ns - one.episode.begin_ns >= source.poll_ns;
  }

  // -------------------------------------------------------------------------- misses, interference

  /// What a channel says of a stretch: the mean of the readings inside; where there are none, what
  /// was read before; of a counter its rate. nullopt where a slow counter is as much about the idle
  /// time around a trial.
  [[nodiscard]] std::optional<double> said_by(const ChannelTrack& track,
                                              const Window& window) const {
    if (const auto inside = track.inside(window.begin_ns, window.end_ns)) return inside;
    const int64_t missing_ns =
        std::max<int64_t>(track.resolution_ns() - (window.end_ns - window.begin_ns), 0);
    if (trials_.share(window.begin_ns - missing_ns / 2, window.end_ns + missing_ns / 2) <
        min_trial_share)
      return std::nullopt;
    return track.over(window.begin_ns, window.end_ns);
  }

  /// What the channels of one kind say of a case: the strongest for, else the weakest against.
  struct Looks {
    static constexpr std::size_t max_evidence_count = 6;
    std::vector<double> best;  // by case; 0: nobody looked
    std::vector<bool> shown;
    std::vector<std::vector<Evidence>> evidence;  // best first

    void note(std::size_t count, std::size_t c, double ratio, bool is_for, Evidence seen) {
      if (best.empty()) {
        best.assign(count, 0);
        shown.assign(count, false);
        evidence.resize(count);
      }
      if (ratio > best[c]) {
        best[c] = ratio;
        shown[c] = is_for && ratio > 1;
        if (evidence[c].size() == max_evidence_count) evidence[c].pop_back();
        evidence[c].insert(evidence[c].begin(), std::move(seen));
      } else if (evidence[c].size() < max_evidence_count) {
        evidence[c].push_back(std::move(seen));
      }
    }
  };

  /// Values of ChannelTrack::over().
  static Evidence evidence_of(const Channel& channel, double value, double expected) {
    const std::string si(unit_info(channel.unit).si);
    if (channel.kind == Kind::cumulative)
      return {channel.name, value, expected, (channel.unit == Unit::none ? "count" : si) + "/s"};
    if (si == "1" && channel.kind != Kind::flag && channel.unit != Unit::none)
      return {channel.name, 100 * value, 100 * expected, "%"};
    return {channel.name, value, expected, si};
  }

  /// What a channel says of every frame.
  struct Told {
    const Channel* channel;
    ChannelTrack track;
    std::vector<std::optional<double>> rates;
  };
  [[nodiscard]] std::vector<Told> ask_channels() const {
    std::vector<Told> result;
    for (const Channel& channel : run_.channels) {
      const auto series = run_.series.find(channel.id);
      if (series == run_.series.end() || series->second.t_ns.empty() || is_quota(channel)) continue;
      if (channel.quantity == Quantity::cache_miss ||
          channel.quantity == Quantity::memory_traffic ||
          channel.quantity == Quantity::interference)
        result.push_back({&channel, ChannelTrack(channel, series->second, sleeps_), {}});
    }
    tbb::parallel_for(std::size_t{0}, result.size(), [&](std::size_t c) {
      for (const TimedFrame& frame : frames_)
        result[c].rates.push_back(said_by(result[c].track, {frame.begin_ns, frame.end_ns}));
    });
    return result;
  }

  /// Misses per ray must rise, and faster than the time: a counter that also counts what others do
  /// rises with time alone.
  void look_at_misses(const Told& told) {
    const auto& [channel, track, rates] = told;
    const Reference reference(frames_, normal_, rates);
    const auto log_ratio = [](double value, double expected) {
      return std::log(std::max(value, 1e-3 * expected) / expected);
    };
    Tail tail(track.resolution_ns());
    for (std::size_t i = 0; i < frames_.size(); ++i) {
      if (!normal_[i] || !rates[i]) continue;
      const auto expected = reference.of(frames_[i]);
      if (expected && *expected > 0) tail.add(frames_[i], log_ratio(*rates[i], *expected));
    }
    tail.sort();
    if (tail.count() < min_cell_reference) return;
    const double usual = std::max(tail.quantile_of(0.9), 0.0);
    for (std::size_t c = 0; c < cases_.size(); ++c) {
      Case& one = cases_[c];
      const Window window = window_of(one, track.resolution_ns());
      const auto rate = said_by(track, window);
      const auto expected = reference.of(*one.frame);
      if (!rate || !expected || *expected <= 0) continue;
      const double rise = log_ratio(*rate, *expected);
      // Per ray: as the frame took `ratio` times as long for its rays.
      const double per_ray = rise + std::log(one.slow->ratio);
      const bool is_for = rise > std::max(0.10, 1.5 * usual) && per_ray > 0.26;
      double ratio = 0.5;
      if (is_for)
        ratio = ratio_against(tail, rise);
      else if (rise < 0.05 && window.end_ns - window.begin_ns >= track.resolution_ns())
        ratio = denial;
      miss_looks_.note(cases_.size(), c, ratio, is_for, evidence_of(*channel, *rate, *expected));
    }
  }

  /// The smallest step of a counter, in SI units: a counter of ticks does not move for less.
  static double quantum_of(const ChannelTrack& track) {
    double least = 0;
    for (std::size_t i = 1; i < track.value().size(); ++i) {
      const double step = track.value()[i] - track.value()[i - 1];
      if (step > 0 && (least == 0 || step < least)) least = step;
    }
    return least;
  }

  /// The normal frames, without those about which a sensor of this resolution would also tell what
  /// a quota's stop just before them took; all where too few are left.
  [[nodiscard]] std::vector<bool> normal_without_stops(int64_t resolution_ns) const {
    std::vector<bool> clear = normal_;
    for (const ThrottleSource& source : throttling_.sources) {
      if (!source.quota) continue;
      for (std::size_t i = 0; i < frames_.size(); ++i)
        if (source.active.share(frames_[i].begin_ns - resolution_ns, frames_[i].end_ns) > 0)
          clear[i] = false;
    }
    const auto count = static_cast<std::size_t>(std::count(clear.begin(), clear.end(), true));
    return count >= min_trial_reference ? clear : normal_;
  }

  /// Of a share of time: the seconds by which normal frames go beyond what is usual. A frame that
  /// waited for long and a short one that waited all its time have the same rate, and only the
  /// first one is slow.
  [[nodiscard]] Tail beyond_usual(const ChannelTrack& track, const std::vector<bool>& normal,
                                  const std::vector<std::optional<double>>& rates,
                                  const Reference& reference) const {
    Tail tail(track.resolution_ns());
    for (std::size_t i = 0; i < frames_.size(); ++i)
      if (const auto expected = reference.of(frames_[i]); normal[i] && rates[i] && expected)
        tail.add(frames_[i], (*rates[i] - *expected) * frames_[i].ms * 1e-3);
    tail.sort();
    return tail;
  }

  void look_at_interference(const Told& told) {
    const auto& [channel, track, rates] = told;
    const bool is_counter = channel->kind == Kind::cumulative;
    // Time per time: that is the share of the time that others had.
    const bool is_share = unit_info(channel->unit).si == (is_counter ? "s" : "1") &&
                          (is_counter || channel->unit != Unit::none);
    const double quantum_s = is_share && is_counter ? quantum_of(track) : 0;
    const std::vector<bool> undisturbed = normal_without_stops(track.resolution_ns());
    const Reference reference(frames_, undisturbed, rates);
    Tail tail(track.resolution_ns());
    for (std::size_t i = 0; i < frames_.size(); ++i)
      if (undisturbed[i] && rates[i]) tail.add(frames_[i], *rates[i]);
    tail.sort();
    const Tail tail_s =
        is_share ? beyond_usual(track, undisturbed, rates, reference) : Tail(track.resolution_ns());
    if (tail.count() < min_cell_reference) return;
    const double usual = tail.quantile_of(0.9);
    for (std::size_t c = 0; c < cases_.size(); ++c) {
      Case& one = cases_[c];
      // What a frame lost may be less than the counter's step: then the whole episode is asked.
      const bool coarse = one.excess_s < 3 * quantum_s;
      const Window window = coarse ? one.episode : window_of(one, track.resolution_ns());
      const auto rate = said_by(track, window);
      if (!rate) continue;
      const double expected = reference.of(*one.frame).value_or(tail.quantile_of(0.5));
      const double length_s = static_cast<double>(window.end_ns - window.begin_ns) * 1e-9;
      const double excess_s = coarse ? one.episode_excess_s : one.excess_s;
      const bool resolved =
          window.end_ns - window.begin_ns >= track.resolution_ns() && excess_s >= 2 * quantum_s;
      bool is_for = false;
      double ratio = 0.5;
      if (is_share) {
        // Time that others had is time that the frame lost; several CPUs may each lose it.
        const double lost_ratio = coarse ? excess_s / length_s : 1 - 1 / one.slow->ratio;
        const double explained = (*rate - expected) / lost_ratio;
        const double beyond_s = (*rate - expected) * one.frame->ms * 1e-3;
        const bool in_seconds = !coarse && tail_s.count() >= min_cell_reference;
        is_for =
            explained > 0.3 && (in_seconds ? beyond_s > tail_s.quantile_of(0.9) : *rate > usual);
        if (is_for)
          ratio = in_seconds ? ratio_against(tail_s, beyond_s) : ratio_against(tail, *rate);
        else if (resolved && explained < 0.1)
          ratio = 0.1;
        one.off_processor = one.off_processor || (is_for && explained > 0.7);
        if (!resolved && (*rate - expected) * length_s < 0.1 * excess_s) ratio = 0.5;
      } else {
        is_for = *rate > std::max(2 * expected, 1.5 * usual) &&
                 (!is_counter || *rate - expected > 2 / length_s);
        // How often says less than for how long.
        if (is_for)
          ratio = std::min(ratio_against(tail, *rate), 50.0);
        else if (resolved)
          ratio = 0.3;
      }
      interference_looks_.note(cases_.size(), c, ratio, is_for,
                               evidence_of(*channel, *rate, expected));
    }
  }

  void merge_looks() {
    const auto merge = [&](Looks& looks, std::size_t hypothesis) {
      if (looks.best.empty()) return;
      for (std::size_t c = 0; c < cases_.size(); ++c) {
        Case& one = cases_[c];
        if (looks.best[c] == 0) continue;
        double ratio = looks.best[c];
        // A stopped group waits, is switched out, and others' misses are counted meanwhile: that is
        // the quota's doing.
        if (one.shown[quota]) ratio *= 0.02;
        // Nor does a program miss the cache while it has no processor.
        if (hypothesis == misses && one.off_processor) ratio *= 0.05;
        one.weigh(hypothesis, ratio);
        one.shown[hypothesis] = looks.shown[c];
        for (Evidence& seen : looks.evidence[c])
          one.evidence.emplace_back(hypothesis, std::move(seen));
      }
    };
    merge(interference_looks_, interruption);
    merge(miss_looks_, misses);
  }

  // -------------------------------------------------------------------------- work

  void look_at_work(std::optional<int64_t> FrameRecord::*count, const char* name) {
    std::vector<std::optional<double>> values(frames_.size());
    bool any = false;
    for (std::size_t i = 0; i < frames_.size(); ++i) {
      const auto& counted = run_.frames[frames_[i].frame_index].*count;
      if (!counted || *counted <= 0) continue;
      values[i] = static_cast<double>(*counted);
      any = true;
    }
    if (!any) return;
    const Reference reference(frames_, normal_, values);
    Tail tail(1);
    for (std::size_t i = 0; i < frames_.size(); ++i)
      if (const auto expected = reference.of(frames_[i]); normal_[i] && values[i] && expected)
        tail.add(frames_[i], std::log(*values[i] / *expected));
    tail.sort();
    if (tail.count() < min_cell_reference) return;
    for (std::size_t c = 0; c < cases_.size(); ++c) {
      Case& one = cases_[c];
      const auto& value = values[one.slow->frame];
      const auto expected = reference.of(*one.frame);
      if (!value || !expected) continue;
      const double rise = std::log(*value / *expected);
      const double needed = std::log(one.slow->ratio);
      const bool is_for = rise > 0.05 && rise > 0.5 * needed;
      one.evidence.emplace_back(work, Evidence{name, *value, *expected, "count"});
      if (is_for) {
        // Counted, not sensed: exact, and it must take its time.
        one.shown[work] = true;
        one.weigh(work, strongest * ratio_against(tail, rise));
      } else if (!one.shown[work]) {
        one.weigh(work, denial);
      }
    }
  }

  // -------------------------------------------------------------------------- decision

  std::vector<Attribution> decide() {
    // A cause that no reading speaks for is not considered; only a low clock, which is one, may be
    // due to a reason that was missed between two polls. Reasons that are inferred from the clock
    // cannot be missed where the clock was read.
    for (Case& one : cases_)
      for (std::size_t h = 0; h < nothing; ++h) {
        if (one.shown[h]) continue;
        const bool missed = throttling_.has_reason_channel && one.clock_low &&
                            (h == power || h == thermal || h == other);
        if (!missed) one.likelihood[h] = 0;
      }

    // How frequent each is in this run: expectation maximization over episodes, from a prior that
    // half an episode of each and three of no cause make. An episode does not count for itself: one
    // chance overlap must not become its own proof.
    Likelihood prior;
    prior.fill(0.5);
    prior[nothing] = 3;
    std::vector<Likelihood> posterior(cases_.size());
    std::vector<Likelihood> by_episode(length_.size(), Likelihood{});
    Likelihood total = prior;
    for (int round = 0; round < em_round_count; ++round) {
      std::vector<Likelihood> next(length_.size(), Likelihood{});
      for (std::size_t c = 0; c < cases_.size(); ++c) {
        const std::size_t episode = cases_[c].slow->episode;
        double sum = 0;
        for (std::size_t h = 0; h < hypothesis_count; ++h)
          sum += posterior[c][h] = (total[h] - by_episode[episode][h]) * cases_[c].likelihood[h];
        for (std::size_t h = 0; h < hypothesis_count; ++h) {
          posterior[c][h] /= sum;
          next[episode][h] += posterior[c][h] / static_cast<double>(length_[episode]);
        }
      }
      by_episode = std::move(next);
      total = prior;
      for (const Likelihood& one : by_episode)
        for (std::size_t h = 0; h < hypothesis_count; ++h) total[h] += one[h];
    }

    std::vector<Attribution> result;
    for (std::size_t c = 0; c < cases_.size(); ++c) result.push_back(attribute(c, posterior[c]));
    if (throttling_.has_reason_channel) inherit(result, posterior);
    return result;
  }

  Attribution attribute(std::size_t c, const Likelihood& posterior) const {
    std::array<double, cause_count> by_cause{};
    for (std::size_t h = 0; h < hypothesis_count; ++h)
      by_cause[static_cast<std::size_t>(cause_of(h))] += posterior[h];
    const auto best = static_cast<std::size_t>(std::max_element(by_cause.begin(), by_cause.end()) -
                                               by_cause.begin());
    Attribution result;
    // Named without a reading of its own, only because it is the usual reason here.
    bool is_shown = best == static_cast<std::size_t>(Cause::unexplained);
    for (std::size_t h = 0; h < nothing; ++h)
      is_shown = is_shown || (static_cast<std::size_t>(cause_of(h)) == best && cases_[c].shown[h]);
    if (by_cause[best] >= (is_shown ? min_confidence : min_habit_confidence))
      result.cause = static_cast<Cause>(best);
    result.confidence = by_cause[static_cast<std::size_t>(result.cause)];
    // What speaks for the cause first, then the rest.
    for (const bool wanted : {true, false})
      for (const auto& [h, seen] : cases_[c].evidence) {
        const bool about = h == low_clock ? is_throttle(result.cause) || cases_[c].clock_low
                                          : cause_of(h) == result.cause;
        if (about == wanted) result.evidence.push_back(seen);
      }
    return result;
  }

  static bool is_throttle(Cause cause) {
    return cause == Cause::throttle_power || cause == Cause::throttle_thermal ||
           cause == Cause::throttle_other;
  }

  /// A clock recovers after its reason is gone: frames of an episode whose clock is low and whose
  /// reason is not known have the reason that the others of the episode have, if those agree.
  void inherit(std::vector<Attribution>& result, const std::vector<Likelihood>& posterior) const {
    std::map<std::size_t, std::array<std::size_t, cause_count>> causes;  // by episode
    for (std::size_t c = 0; c < cases_.size(); ++c)
      if (is_throttle(result[c].cause) && cases_[c].clock_low)
        ++causes[cases_[c].slow->episode][static_cast<std::size_t>(result[c].cause)];
    for (std::size_t c = 0; c < cases_.size(); ++c) {
      if (result[c].cause != Cause::unexplained || !cases_[c].clock_low) continue;
      const auto found = causes.find(cases_[c].slow->episode);
      if (found == causes.end()) continue;
      const auto& counts = found->second;
      const auto best =
          static_cast<std::size_t>(std::max_element(counts.begin(), counts.end()) - counts.begin());
      std::size_t total = 0;
      for (const std::size_t count : counts) total += count;
      if (counts[best] < total) continue;
      const double confidence = posterior[c][power] + posterior[c][thermal] + posterior[c][other] +
                                posterior[c][low_clock];
      if (confidence < min_confidence) continue;
      result[c] = attribute(c, posterior[c]);
      result[c].cause = static_cast<Cause>(best);
      result[c].confidence = confidence;
    }
  }

  const RunRecord& run_;
  std::span<const TimedFrame> frames_;
  const Throttling& throttling_;
  std::vector<Sleep> sleeps_;
  std::vector<bool> normal_;
  std::vector<Window> calm_;  // by frame: the frames in a row around it that are as normal as it is
  std::vector<Case> cases_;
  std::optional<DeviceClock> clock_;
  SpanSet trials_;                   // when timed frames were traced, gaps between them included
  std::vector<std::size_t> length_;  // of episodes, in slow frames
  std::vector<Look> after_stops_;    // by case, where own threads waited after a stop
  Looks miss_looks_;
  Looks interference_looks_;
};

}  // namespace

std::string_view to_string(Cause cause) {
  switch (cause) {
    case Cause::throttle_thermal:
      return "throttle-thermal";
    case Cause::throttle_power:
      return "throttle-power";
    case Cause::throttle_other:
      return "throttle-other";
    case Cause::cache_miss:
      return "cache-miss";
    case Cause::interference:
      return "interference";
    case Cause::more_work:
      return "more-work";
    case Cause::unexplained:
      return "unexplained";
  }
  return "unexplained";
}

std::vector<Attribution> find_causes(const RunRecord& run, std::span<const TimedFrame> frames,
                                     const OutlierSearch& search, const Throttling& throttling) {
  return Judge(run, frames, search, throttling).judge();
}

}  // namespace energyprof::analysis
