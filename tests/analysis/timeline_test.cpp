#include "analysis/timeline.h"

#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>

#include "planted_run.h"

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

/// Every rule of the format that viewers rely on.
void expect_rules(const json& timeline) {
  EXPECT_EQ(timeline.at("displayTimeUnit"), "ms");
  std::set<int> named_processes;
  std::set<std::pair<int, int>> named_threads;
  for (const json& event : events_of(timeline, "M")) {
    if (event.at("name") == "process_name") named_processes.insert(event.at("pid").get<int>());
    if (event.at("name") == "thread_name")
      named_threads.emplace(event.at("pid").get<int>(), event.at("tid").get<int>());
  }
  std::map<std::string, double> last_us;
  std::map<std::string, double> slice_end_us;
  for (const json& event : timeline.at("traceEvents")) {
    const auto phase = event.at("ph").get<std::string>();
    if (phase == "M") continue;
    const int pid = event.at("pid").get<int>();
    const int tid = event.at("tid").get<int>();
    EXPECT_TRUE(named_processes.contains(pid)) << event;
    EXPECT_TRUE(named_threads.contains({pid, tid})) << event;
    const auto ts = event.at("ts").get<double>();
    EXPECT_TRUE(std::isfinite(ts) && ts >= 0) << event;
    std::string track = std::to_string(pid) + "/" + std::to_string(tid) + "/" + phase;
    if (phase == "C") {
      track += event.at("name").get<std::string>();
      EXPECT_TRUE(event.at("args").at("value").is_number()) << event;
    }
    if (last_us.contains(track)) {
      EXPECT_GE(ts, last_us[track]) << event;
    }
    last_us[track] = ts;
    if (phase != "X") continue;
    const auto dur = event.at("dur").get<double>();
    EXPECT_GE(dur, 0) << event;
    if (slice_end_us.contains(track)) {
      EXPECT_GE(ts, slice_end_us[track] - 1e-4) << event;
    }
    slice_end_us[track] = ts + dur;
  }
}

TEST(Timeline, KeepsTheRulesOfTheFormat) {
  expect_rules(timeline_of(planted::laptop_run()));
  expect_rules(timeline_of(planted::laptop_run(), {.full = true}));
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
