#include "analysis/timeline.h"

#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>

#include "analysis/analyze_frames.h"
#include "planted_run.h"
#include "tests/sanitized.h"

namespace energyprof::analysis {
namespace {

using nlohmann::json;
using planted::RunBuilder;

/// The timeline with what the analysis found.
json judged_timeline_of(const RunRecord& run) {
  const Analysis analysis = analyze(run);
  std::ostringstream out;
  write_timeline(run, out, {}, &analysis);
  return json::parse(out.str());
}

json timeline_of(const RunRecord& run, const TimelineConfig& config = {}) {
  std::ostringstream out;
  write_timeline(run, out, config);
  return json::parse(out.str());
}

std::vector<json> events_of(const json& timeline, const std::string& phase) {
  std::vector<json> events;
  for (const json& event : timeline.at("traceEvents"))
    if (event.at("ph") == phase) events.push_back(event);
  return events;
}

/// Every rule of the format that viewers rely on, event by event in the order of the file.
class Rules {
 public:
  void check(const json& event) {
    const auto phase = event.at("ph").get<std::string>();
    const auto name = event.at("name").get<std::string>();
    ASSERT_FALSE(name.empty()) << event;
    ASSERT_TRUE(event.at("pid").is_number_unsigned() && event.at("tid").is_number_unsigned());
    ASSERT_TRUE(event.at("args").is_object()) << event;
    const std::pair<int, int> thread(event.at("pid").get<int>(), event.at("tid").get<int>());
    if (phase == "M") return check_name(event, name, thread);
    ASSERT_TRUE(processes_.contains(thread.first)) << "named before it is used: " << event;
    ASSERT_TRUE(threads_.contains(thread)) << "named before it is used: " << event;
    const auto ts = event.at("ts").get<double>();
    ASSERT_TRUE(std::isfinite(ts) && ts >= 0) << event;
    std::string track = phase + std::to_string(thread.first) + "/" + std::to_string(thread.second);
    std::set<std::string> keys{"ph", "name", "pid", "tid", "args", "ts"};
    if (phase == "C") {
      track += name;
      ASSERT_EQ(event.at("args").size(), 1u) << event;
      ASSERT_TRUE(event.at("args").at("value").is_number()) << event;
      ASSERT_TRUE(name.ends_with("]")) << "counters carry their unit: " << event;
    } else if (phase == "X") {
      keys.insert({"dur", "cat"});
      const auto dur = event.at("dur").get<double>();
      ASSERT_TRUE(std::isfinite(dur) && dur >= 0) << event;
      // Slices of a track follow each other: none overlaps, so none needs to be nested.
      ASSERT_GE(ts, slice_end_us_[track] - 1e-4) << event;
      slice_end_us_[track] = ts + dur;
      if (event.at("args").contains("outlier")) check_outlier(event.at("args"), name);
    } else {
      ASSERT_EQ(phase, "i") << event;
      keys.insert({"s", "cat"});
      // Of the thread "events": Perfetto puts those of the whole trace into a track without a name.
      ASSERT_EQ(event.at("s"), "t") << event;
    }
    std::set<std::string> found;
    for (const auto& [key, value] : event.items()) found.insert(key);
    ASSERT_EQ(found, keys) << event;
    ASSERT_GE(ts, last_us_[track]) << event;
    last_us_[track] = ts;
    ++counts_[phase];
    if (event.contains("cat")) ++counts_[event.at("cat").get<std::string>()];
    if (event.at("args").contains("outlier")) ++counts_["outlier"];
  }
  /// Of a phase or category, or of "outlier".
  std::size_t count(const std::string& what) { return counts_[what]; }

 private:
  void check_name(const json& event, const std::string& name, std::pair<int, int> thread) {
    const bool is_index = name.ends_with("_sort_index");
    ASSERT_TRUE(is_index || name == "process_name" || name == "thread_name") << event;
    const json& value = event.at("args").at(is_index ? "sort_index" : "name");
    ASSERT_TRUE(is_index ? value.is_number_unsigned() : value.is_string()) << event;
    if (name == "process_name") {
      ASSERT_TRUE(processes_.insert(thread.first).second) << "a second name: " << event;
    }
    if (name == "thread_name") {
      ASSERT_TRUE(threads_.insert(thread).second) << "a second name: " << event;
    }
  }
  static void check_outlier(const json& args, const std::string& name) {
    ASSERT_TRUE(name.ends_with(", outlier: " + args.at("cause").get<std::string>())) << name;
    const double confidence = args.at("confidence");
    ASSERT_TRUE(confidence >= 0 && confidence <= 1) << args;
  }

  std::set<int> processes_;
  std::set<std::pair<int, int>> threads_;
  std::map<std::string, double> last_us_;
  std::map<std::string, double> slice_end_us_;
  std::map<std::string, std::size_t> counts_;
};

Rules expect_rules(const json& timeline) {
  EXPECT_TRUE(timeline.at("otherData").is_object());
  Rules rules;
  for (const json& event : timeline.at("traceEvents")) rules.check(event);
  return rules;
}

TEST(Timeline, KeepsTheRulesOfTheFormat) {
  expect_rules(timeline_of(planted::laptop_run()));
  expect_rules(timeline_of(planted::laptop_run(), {.full = true}));
}

TEST(Timeline, GivesTheTimeBeforeAnyTextFromOutside) {
  RunBuilder builder;
  builder.add_trial("m\x1b[0m", 0, "A\x7f", {2, 3});
  builder.add_channel("x\x1b", Quantity::power, Unit::milliwatt, Kind::gauge, 1'000'000, 3,
                      [](std::size_t i) { return static_cast<double>(i); });
  builder.close();
  std::ostringstream out;
  write_timeline(builder.run, out);
  std::istringstream lines(out.str());
  std::size_t event_count = 0;
  for (std::string line; std::getline(lines, line);) {
    const std::size_t ts = line.find("\"ts\":");
    if (ts == line.npos || !line.starts_with("{\"ph\"")) continue;
    ++event_count;
    EXPECT_LT(ts, line.find("\"name\":")) << line;
  }
  EXPECT_EQ(event_count, 1u + 2u + 3u);
}

TEST(Timeline, OfAnEmptyRunIsValid) {
  const json timeline = timeline_of({});
  expect_rules(timeline);
  EXPECT_TRUE(events_of(timeline, "X").empty());
}

TEST(Timeline, TimesAreMicrosecondsSinceTheBegin) {
  RunBuilder builder;
  builder.now_ns += 1'234'567;
  builder.add_trial("m", 0, "A", {2, 3});
  builder.close();
  for (const json& slice : events_of(timeline_of(builder.run), "X")) {
    if (slice.at("cat") != "frame" || slice.at("args").at("frame") != 1) continue;
    EXPECT_DOUBLE_EQ(slice.at("ts").get<double>(), 3234.567);
    EXPECT_DOUBLE_EQ(slice.at("dur").get<double>(), 3000);
    EXPECT_EQ(slice.at("name"), "A");
    EXPECT_EQ(slice.at("args").at("phase"), "timed");
    EXPECT_EQ(slice.at("args").at("ray_count"), 1000);
    EXPECT_DOUBLE_EQ(slice.at("args").at("clock_error_us").get<double>(), 2);
    // 1000 rays in 3 ms.
    EXPECT_NEAR(slice.at("args").at("mrays_per_s").get<double>(), 1.0 / 3, 1e-9);
    return;
  }
  FAIL() << "frame 1 is not in the timeline";
}

TEST(Timeline, HoldsEveryFrameAndTrial) {
  const RunRecord run = planted::laptop_run();
  std::size_t frame_count = 0;
  std::size_t trial_count = 0;
  bool skipped = false;
  for (const json& slice : events_of(timeline_of(run), "X")) {
    (slice.at("cat") == "frame" ? frame_count : trial_count) += 1;
    skipped |= slice.at("args").value("skip_reason", "") == "device lost | and found again";
  }
  EXPECT_EQ(frame_count, run.frames.size());
  EXPECT_EQ(trial_count, run.trials.size());
  EXPECT_TRUE(skipped);
  EXPECT_EQ(events_of(timeline_of(run), "i").size(), 1u);
}

TEST(Timeline, CutsFramesThatClockErrorsMakeOverlap) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", {2, 2});
  builder.run.frames[1].begin_ns -= 5'000;
  builder.close();
  const json timeline = timeline_of(builder.run);
  expect_rules(timeline);
  bool said = false;
  for (const json& slice : events_of(timeline, "X"))
    said |= slice.at("args").value("moved_by_us", 0.0) == 5.0;
  EXPECT_TRUE(said);
}

TEST(Timeline, ATimeBeforeTheBeginMovesTheOrigin) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", {2});
  builder.close();
  builder.run.frames[0].begin_ns -= 7'000;
  const json timeline = timeline_of(builder.run);
  expect_rules(timeline);
  EXPECT_EQ(timeline.at("otherData").at("origin_ns"), planted::begin_ns - 7'000);
}

TEST(Timeline, AnOpenTrialEndsWhereTheRunDoes) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", {2, 2}).end_ns.reset();
  for (const json& slice : events_of(timeline_of(builder.run), "X"))
    if (slice.at("cat") == "trial") {
      EXPECT_DOUBLE_EQ(slice.at("dur").get<double>(), 4000);
    }
}

TEST(Timeline, CountersCarryTheirUnit) {
  std::set<std::string> names;
  for (const json& counter : events_of(timeline_of(planted::laptop_run()), "C"))
    names.insert(counter.at("name").get<std::string>());
  EXPECT_TRUE(names.contains("rapl.package-0.energy [uJ]"));
  EXPECT_TRUE(names.contains("rapl.package-0.energy as power [W]"));
  EXPECT_TRUE(names.contains("i915.gt0.act_freq [MHz]"));
  EXPECT_TRUE(names.contains("i915.gt0.throttle.pl1 [1]"));
}

TEST(Timeline, PowerIsThatOfTheCounter) {
  for (const json& counter : events_of(timeline_of(planted::laptop_run()), "C")) {
    if (counter.at("name") != "rapl.package-0.energy as power [W]") continue;
    EXPECT_GE(counter.at("args").at("value").get<double>(), 9 - 1e-6);
    EXPECT_LE(counter.at("args").at("value").get<double>(), 15 + 1e-6);
  }
}

TEST(Timeline, ThinsUnlessFullAndSaysSo) {
  RunBuilder builder;
  builder.add_channel("x.power", Quantity::power, Unit::watt, Kind::gauge, 1'000'000, 10'000,
                      [](std::size_t i) { return i == 777 ? 500.0 : static_cast<double>(i % 2); });
  const json thin = timeline_of(builder.run, {.max_point_count = 100});
  const json full = timeline_of(builder.run, {.full = true});
  const auto counters = events_of(thin, "C");
  EXPECT_LE(counters.size(), 100u);
  EXPECT_EQ(events_of(full, "C").size(), 10'000u);
  bool peak = false;
  for (const json& counter : counters) peak |= counter.at("args").at("value") == 500;
  EXPECT_TRUE(peak) << "a single high sample was lost";
  EXPECT_NE(thin.at("otherData").at("samples"), full.at("otherData").at("samples"));
}

/// `frame_count` frames, every tenth slow, and most of as many throttle intervals and pauses.
RunRecord restless_run(std::size_t frame_count, std::size_t channel_count,
                       std::size_t sample_count) {
  RunBuilder builder;
  for (std::size_t trial = 0; trial < 10; ++trial) {
    std::vector<double> times_ms;
    for (std::size_t i = 0; i < frame_count / 10; ++i) times_ms.push_back(i % 10 == 7 ? 3 : 1);
    builder.add_trial("m", 0, trial % 2 == 0 ? "A" : "B", times_ms);
  }
  const int64_t run_ns = builder.now_ns - planted::begin_ns;
  const auto steps = static_cast<std::size_t>(run_ns / 200'000);
  builder.add_channel("x.throttle.pl1", Quantity::throttle, Unit::none, Kind::flag, 200'000, steps,
                      [](std::size_t i) { return i % (5 + i / 50 % 7) < 2 ? 1.0 : 0.0; });
  for (std::size_t channel = 1; channel < channel_count; ++channel)
    builder.add_channel("x.energy" + std::to_string(channel), Quantity::energy, Unit::microjoule,
                        Kind::cumulative, run_ns / static_cast<int64_t>(sample_count), sample_count,
                        [](std::size_t i) { return static_cast<double>(i * 10); });
  for (std::size_t i = 0; i < frame_count; ++i) {
    Event event;
    event.t_ns = planted::begin_ns + static_cast<int64_t>(i) * 1'000'000;
    event.severity = i % 1'000 == 500 ? Severity::error : Severity::info;
    event.kind = "missed-ticks";
    builder.run.events.push_back(event);
  }
  builder.close();
  return builder.run;
}

TEST(Timeline, OfAHugeRunStaysBelowAMillionEventsAndKeepsOutliers) {
  if (test::is_sanitized) GTEST_SKIP() << "takes minutes, and the next test runs the same code";
  const RunRecord run = restless_run(100'000, 40, 125'000);
  const Analysis analysis = analyze_frames(run);
  ASSERT_GT(analysis.outliers.size(), 9'000u);
  ASSERT_GT(analysis.throttling.sources.at(0).active.spans().size(), 60'000u);
  std::ostringstream out;
  write_timeline(run, out, {}, &analysis);
  // An event a line: the whole would need much memory at once.
  std::istringstream lines(std::move(out).str());
  Rules rules;
  std::size_t event_count = 0;
  for (std::string line; std::getline(lines, line);) {
    if (!line.starts_with("{\"ph\"")) continue;
    if (line.ends_with(",")) line.pop_back();
    rules.check(json::parse(line));
    ++event_count;
  }
  EXPECT_LE(event_count, 1'000'000u);
  EXPECT_EQ(rules.count("frame"), run.frames.size());
  EXPECT_EQ(rules.count("outlier"), analysis.outliers.size());
  EXPECT_GT(rules.count("throttle"), 60'000u);
  EXPECT_GT(rules.count("C"), 250'000u);
}

TEST(Timeline, SharesFewEventsAndSaysWhatIsLeftOut) {
  const RunRecord run = restless_run(2'000, 6, 3'000);
  const Analysis analysis = analyze_frames(run);
  std::ostringstream out;
  write_timeline(run, out, {.max_event_count = 1'500}, &analysis);
  const json timeline = json::parse(out.str());
  Rules rules = expect_rules(timeline);
  EXPECT_LE(timeline.at("traceEvents").size(), 1'500u);
  EXPECT_EQ(rules.count("outlier"), analysis.outliers.size());
  EXPECT_GT(rules.count("frame"), rules.count("outlier"));
  EXPECT_GT(rules.count("throttle"), 20u);
  EXPECT_GT(rules.count("C"), 300u);
  std::size_t error_count = 0;
  for (const json& event : events_of(timeline, "i"))
    error_count += event.at("args").at("severity") == "error" ? 1 : 0;
  EXPECT_EQ(error_count, 2u) << "the gravest first";
  const json& said = timeline.at("otherData");
  EXPECT_NE(said.at("frames").get<std::string>().find(" of 2000: every outlier"),
            std::string::npos);
  EXPECT_NE(said.at("throttling").get<std::string>().find("gaps up to "), std::string::npos);
  EXPECT_NE(said.at("events").get<std::string>().find("75 of 2000"), std::string::npos);
}

TEST(Timeline, OfTooManyOutliersKeepsThoseThatLostMost) {
  planted::RunBuilder builder;
  std::vector<double> times_ms(3'000);
  for (std::size_t i = 0; i < times_ms.size(); ++i)
    times_ms[i] = (i % 3 == 0 ? 30 : 10) + 0.01 * static_cast<double>(i % 7);
  builder.add_trial("m", 0, "A", times_ms);
  builder.close();
  const Analysis analysis = analyze_frames(builder.run);
  ASSERT_GT(analysis.outliers.size(), 900u);
  std::ostringstream out;
  write_timeline(builder.run, out, {.max_event_count = 1'000}, &analysis);
  const json timeline = json::parse(out.str());
  EXPECT_LE(timeline.at("traceEvents").size(), 1'000u);
  double least_ms = 1e9;
  std::size_t count = 0;
  for (const json& frame : events_of(timeline, "X"))
    if (frame.at("args").contains("outlier")) {
      least_ms = std::min(least_ms, 1e-3 * frame.at("dur").get<double>());
      ++count;
    }
  EXPECT_GT(count, 500u);
  std::size_t longer_count = 0;
  for (const Outlier& outlier : analysis.outliers)
    longer_count += outlier.frame_ms > least_ms + 1e-6 ? 1 : 0;
  EXPECT_LT(longer_count, count);
  EXPECT_NE(
      timeline.at("otherData").at("frames").get<std::string>().find("outliers that lost most"),
      std::string::npos);
}

TEST(Timeline, InFullHoldsEverything) {
  const RunRecord run = restless_run(2'000, 6, 3'000);
  const Analysis analysis = analyze_frames(run);
  std::ostringstream out;
  write_timeline(run, out, {.full = true, .max_event_count = 1'500}, &analysis);
  Rules rules = expect_rules(json::parse(out.str()));
  std::size_t sample_count = 0;
  for (const auto& [id, series] : run.series) sample_count += series.t_ns.size();
  EXPECT_EQ(rules.count("frame"), run.frames.size());
  EXPECT_EQ(rules.count("throttle"), analysis.throttling.sources.at(0).active.spans().size());
  EXPECT_EQ(rules.count("i"), run.events.size());
  EXPECT_GE(rules.count("C"), sample_count) << "and the power of energy counters";
}

TEST(Timeline, BeginsWithThrottlingThatBeganBeforeTheRun) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", std::vector<double>(30, 1.0));
  builder.close();
  Analysis analysis = analyze_frames(builder.run);
  builder.add_channel("x.throttle", Quantity::throttle, Unit::none, Kind::flag, 1'000'000, 30,
                      [](std::size_t) { return 1.0; });
  ThrottleSource source;
  source.active = SpanSet({{planted::begin_ns - 1'500, planted::begin_ns + 1'000'000}});
  analysis.throttling.sources.push_back(source);
  std::ostringstream out;
  write_timeline(builder.run, out, {}, &analysis);
  Rules rules = expect_rules(json::parse(out.str()));
  EXPECT_EQ(rules.count("throttle"), 1u);
}

TEST(Timeline, ConstantCountersNeedTwoPoints) {
  RunBuilder builder;
  builder.add_channel("x.limit", Quantity::limit, Unit::watt, Kind::gauge, 1'000'000, 1000,
                      [](std::size_t) { return 15.0; });
  EXPECT_EQ(events_of(timeline_of(builder.run), "C").size(), 2u);
}

TEST(Timeline, SurvivesNamesThatAreNotText) {
  RunBuilder builder;
  builder.add_trial("a \"quoted\"\n\xff name", 0, "A", {1});
  const json timeline = timeline_of(builder.run);
  EXPECT_FALSE(events_of(timeline, "X").empty());
}

TEST(Timeline, NamesOutliersAndShowsWhenTheyWereThrottled) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", {10, 10, 10, 10, 10, 30, 10, 10, 10, 10});
  builder.add_channel("i915.gt0.throttle.pl1", Quantity::throttle, Unit::count, Kind::flag,
                      1'000'000, 200, [](std::size_t i) { return i >= 50 && i < 80 ? 1.0 : 0.0; });
  const json timeline = judged_timeline_of(builder.run);
  std::size_t outlier_count = 0;
  std::size_t throttle_count = 0;
  for (const json& slice : events_of(timeline, "X")) {
    if (slice.at("args").contains("outlier")) {
      ++outlier_count;
      EXPECT_EQ(slice.at("args").at("frame"), builder.run.frames[5].frame);
      EXPECT_TRUE(slice.at("args").contains("cause"));
    }
    if (slice.at("cat") == "throttle") {
      ++throttle_count;
      EXPECT_EQ(slice.at("name"), "power_sustained");
      EXPECT_NEAR(slice.at("dur").get<double>(), 30'000, 1'100);
    }
  }
  EXPECT_EQ(outlier_count, 1u);
  EXPECT_EQ(throttle_count, 1u);
}

}  // namespace
}  // namespace energyprof::analysis
