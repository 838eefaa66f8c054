#include "analysis/csv.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <sstream>

#include "planted_run.h"

namespace energyprof::analysis {
namespace {

using planted::RunBuilder;

/// Fields of an RFC 4180 text, record by record.
std::vector<std::vector<std::string>> parse(const std::string& text) {
  std::vector<std::vector<std::string>> records(1, {""});
  bool quoted = false;
  for (std::size_t i = 0; i < text.size(); ++i) {
    std::string& field = records.back().back();
    if (quoted && text[i] == '"' && i + 1 < text.size() && text[i + 1] == '"')
      field += text[++i];
    else if (text[i] == '"')
      quoted = !quoted;
    else if (!quoted && text[i] == ',')
      records.back().emplace_back();
    else if (!quoted && text.compare(i, 2, "\r\n") == 0)
      records.push_back({""}), ++i;
    else
      field += text[i];
  }
  records.pop_back();
  return records;
}

TEST(Csv, FramesHaveOneRecordEach) {
  RunBuilder builder;
  builder.add_trial("a, \"b\"\nc", 2, "A", {1, 2});
  builder.run.frames[0].loop_step_count = 7;
  builder.run.frames[0].simd_efficiency = 0.75;
  builder.run.frames[1].ray_count.reset();
  builder.run.frames[1].trial_id = 99;
  std::ostringstream out;
  write_frames_csv(builder.run, out);
  const auto records = parse(out.str());
  ASSERT_EQ(records.size(), 3u);
  for (const auto& record : records) EXPECT_EQ(record.size(), records[0].size());
  const auto column = [&](std::size_t row, const std::string& name) {
    const auto at = std::find(records[0].begin(), records[0].end(), name);
    return records[row].at(static_cast<std::size_t>(at - records[0].begin()));
  };
  EXPECT_EQ(column(1, "model"), "a, \"b\"\nc");
  EXPECT_EQ(column(1, "view"), "2");
  EXPECT_EQ(column(1, "phase"), "timed");
  EXPECT_EQ(column(1, "end_ns"), std::to_string(planted::begin_ns + 1'000'000));
  EXPECT_EQ(column(1, "hit_checksum"), "h0");
  EXPECT_EQ(column(1, "loop_step_count"), "7");
  EXPECT_EQ(column(1, "simd_efficiency"), "0.75");
  EXPECT_EQ(column(2, "simd_efficiency"), "");
  EXPECT_EQ(column(2, "ray_count"), "") << "unknown is empty";
  EXPECT_EQ(column(2, "model"), "") << "a frame of no trial";
}

TEST(Csv, SamplesKeepTheirValueAndUnit) {
  RunBuilder builder;
  builder.add_channel("rapl.package-0.energy", Quantity::energy, Unit::microjoule, Kind::cumulative,
                      1'000'000, 2,
                      [](std::size_t i) { return 262'143'328'850.0 + static_cast<double>(i); });
  std::ostringstream out;
  write_samples_csv(builder.run, out);
  const auto records = parse(out.str());
  ASSERT_EQ(records.size(), 3u);
  EXPECT_EQ(records[2],
            (std::vector<std::string>{std::to_string(planted::begin_ns + 1'000'000),
                                      "rapl.package-0.energy", "energy", "uJ", "262143328851"}));
}

TEST(Csv, MetaSaysWhatTheRunWas) {
  RunBuilder builder;
  builder.run.meta = {{"config", "{\"name\": \"a, b\"}"}, {"simulated", "1"}};
  std::ostringstream out;
  write_meta_csv(builder.run, out);
  EXPECT_EQ(parse(out.str()),
            (std::vector<std::vector<std::string>>{
                {"key", "value"}, {"config", "{\"name\": \"a, b\"}"}, {"simulated", "1"}}));
}

}  // namespace
}  // namespace energyprof::analysis
