// report.html in a browser: its charts, its zoom, what it says of outliers, and its size.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "../end_to_end/program.h"
#include "analysis/report_html.h"
#include "planted_run.h"
#include "synthetic_run.h"

namespace energyprof::analysis {
namespace {

using nlohmann::json;
using planted::RunBuilder;
using test::TempDir;
using testing::HasSubstr;
using testing::Not;

json data_of(const std::string& page) {
  const std::string open = R"(<script type="application/json" id="data">)";
  const std::size_t begin = page.find(open) + open.size();
  return json::parse(page.substr(begin, page.find("</script>", begin) - begin));
}

/// Uses the charts as a reader would, and writes what it saw into the page.
constexpr const char* visitor = R"(<script>
const chart = echarts.getInstanceByDom(document.getElementById("chart"));
const data = JSON.parse(document.getElementById("data").textContent);
const seen = {};
if (chart) {
  const option = chart.getOption();
  seen.series = option.series.map((series) => ({ name: series.name, points: series.data.length,
    bands: series.markArea ? series.markArea.data.length : 0 }));
  seen.whole = chart.getModel().getComponent("xAxis", 0).axis.scale.getExtent();
  chart.dispatchAction({ type: "dataZoom", start: 25, end: 50 });
  seen.zoomed = chart.getModel().getComponent("xAxis", 0).axis.scale.getExtent();
  seen.track = chart.getModel().getComponent("xAxis", 1).axis.scale.getExtent();
  document.getElementById("zoom_all").click();
  seen.again = chart.getModel().getComponent("xAxis", 0).axis.scale.getExtent();
  document.getElementById("zoom_in").click();
  const zoom = chart.getOption().dataZoom[0];
  seen.half = zoom.end - zoom.start;
  const first = data.outliers.evidence.findIndex((evidence) => evidence && evidence.length > 0);
  if (first >= 0) {
    seen.cause = data.causes[data.outliers.cause[first]];
    seen.channel = data.outliers.channels[data.outliers.evidence[first][0][0]];
    seen.tip = option.tooltip[0].formatter([{ axisValue: data.outliers.t_s[first] }]).textContent;
    document.getElementById("outlier_next").click();
    seen.walk = document.getElementById("outlier_text").textContent;
  }
  seen.charts = ["scatter_chart", "pareto", "theory_chart"].filter((id) =>
    document.getElementById(id).querySelector("canvas"));
}
document.body.append(Object.assign(document.createElement("pre"), { id: "seen", textContent:
  btoa(String.fromCharCode(...new TextEncoder().encode(JSON.stringify(seen)))) }));
</script></body>)";

std::string base64_decoded(const std::string& text) {
  constexpr std::string_view digits =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string bytes;
  uint32_t group = 0;
  int bits = 0;
  for (const char c : text) {
    const std::size_t digit = digits.find(c);
    if (digit == digits.npos) break;
    group = group << 6 | static_cast<uint32_t>(digit);
    bits += 6;
    if (bits < 8) continue;
    bits -= 8;
    bytes += static_cast<char>(group >> bits & 0xFFu);
  }
  return bytes;
}

/// Opens the page in a browser; `visited` is what the visitor saw.
class Browser : public testing::Test {
 protected:
  void SetUp() override {
    if (test::run({"chromium", "--version"}).code != 0) GTEST_SKIP() << "chromium is not installed";
  }

  json visit(const std::string& page) {
    std::string visited = page;
    const std::size_t end = visited.rfind("</body>");
    visited.replace(end, 7, visitor);
    std::ofstream(dir_ / "report.html") << visited;
    const test::Output output = test::run(
        {"timeout", "60", "chromium", "--headless", "--no-sandbox", "--disable-gpu",
         "--disable-quic", "--no-first-run", "--disable-background-networking",
         "--disable-component-update", "--disable-sync",
         "--user-data-dir=" + (dir_ / "browser").string(), "--enable-logging=stderr",
         "--virtual-time-budget=8000", "--dump-dom", "file://" + (dir_ / "report.html").string()});
    EXPECT_EQ(output.code, 0) << output.err;
    std::istringstream log(output.err);
    for (std::string line; std::getline(log, line);)
      EXPECT_FALSE(line.find("CONSOLE") != std::string::npos &&
                   line.find("source: file:") != std::string::npos)
          << line;
    dom_ = output.out;
    const std::string open = R"(<pre id="seen">)";
    const std::size_t begin = dom_.find(open);
    if (begin == dom_.npos) return json::object();
    return json::parse(base64_decoded(dom_.substr(begin + open.size())));
  }

  TempDir dir_;
  std::string dom_;
};

TEST_F(Browser, ShowsOutliersByCauseOverThrottling) {
  synthetic::Options options;
  options.seed = 3;
  options.effects = {synthetic::Effect::power, synthetic::Effect::preemption};
  const RunRecord run = synthetic::make_run(options).run;
  const Analysis analysis = analyze(run);
  ASSERT_FALSE(analysis.outliers.empty());
  const json seen = visit(report_html(run, analysis));
  ASSERT_TRUE(seen.contains("half")) << "the page's script stopped";
  std::size_t outlier_count = 0;
  std::size_t band_count = 0;
  std::size_t frame_count = 0;
  for (const json& series : seen.at("series")) {
    const std::string name = series.at("name");
    const std::size_t points = series.at("points");
    if (name.starts_with("throttled: ")) band_count += series.at("bands").get<std::size_t>();
    for (std::size_t k = 0; k < cause_count; ++k)
      if (name == to_string(static_cast<Cause>(k))) outlier_count += points;
    for (const RankingRow& row : analysis.ranking)
      if (name == row.algorithm) frame_count += points;
  }
  EXPECT_EQ(outlier_count, analysis.outliers.size());
  EXPECT_GT(band_count, 0u);
  EXPECT_GT(frame_count, 0u);
  const double duration =
      seen.at("whole").at(1).get<double>() - seen.at("whole").at(0).get<double>();
  EXPECT_NEAR(seen.at("zoomed").at(0).get<double>(), duration / 4, duration / 100);
  EXPECT_NEAR(seen.at("zoomed").at(1).get<double>(), duration / 2, duration / 100);
  EXPECT_EQ(seen.at("track"), seen.at("zoomed")) << "the tracks follow";
  EXPECT_EQ(seen.at("again"), seen.at("whole"));
  EXPECT_NEAR(seen.at("half").get<double>(), 50, 0.1);
  for (const char* text : {"tip", "walk"}) {
    EXPECT_THAT(seen.at(text).get<std::string>(), HasSubstr("onfidence"));
    EXPECT_THAT(seen.at(text).get<std::string>(), HasSubstr("vidence"));
  }
  EXPECT_THAT(seen.at("tip").get<std::string>(), HasSubstr(seen.at("cause").get<std::string>()));
  EXPECT_THAT(seen.at("tip").get<std::string>(), HasSubstr(seen.at("channel").get<std::string>()));
  EXPECT_THAT(dom_, HasSubstr("Outliers and throttling"));
  EXPECT_THAT(seen.at("charts").dump(), HasSubstr("scatter_chart"));
}

TEST_F(Browser, DrawsTheoryForModelsOfDifferentSize) {
  RunRecord run = planted::laptop_run();
  for (Trial& trial : run.trials)
    if (trial.model == "dragon") trial.triangle_count = 12'000;
  const json seen = visit(report_html(run, analyze(run)));
  EXPECT_THAT(seen.at("charts").dump(), HasSubstr("theory_chart"));
  EXPECT_THAT(dom_, HasSubstr("n^(1/3)"));
  EXPECT_THAT(dom_, Not(HasSubstr("<b></")));
}

TEST_F(Browser, SaysWhatIsMissingOfAnEmptyRun) {
  const json seen = visit(report_html({}, analyze({})));
  EXPECT_TRUE(seen.empty()) << "there is no chart to visit";
  EXPECT_THAT(dom_, HasSubstr("No timed frame was recorded"));
  EXPECT_THAT(dom_, HasSubstr("There is nothing to draw"));
}

/// 100,000 frames of which one in `slow_every` is slow, under 40 channels of 125,000 samples each.
RunRecord big_run(std::size_t slow_every) {
  RunBuilder builder;
  for (int trial = 0; trial < 100; ++trial) {
    std::vector<double> times_ms;
    for (std::size_t i = 0; i < 1'000; ++i)
      times_ms.push_back((1 + 0.02 * std::sin(static_cast<double>(i * i))) *
                         (i % slow_every == 0 ? 2 : 1));
    builder.add_trial("m", trial % 5, "A" + std::to_string(trial / 5 % 5), times_ms);
  }
  const int64_t period_ns = (builder.now_ns - planted::begin_ns) / 125'000;
  for (std::size_t channel = 0; channel < 40; ++channel)
    builder.add_channel(
        "x.gauge" + std::to_string(channel),
        channel % 2 == 0 ? Quantity::power : Quantity::frequency,
        channel % 2 == 0 ? Unit::milliwatt : Unit::megahertz, Kind::gauge, period_ns, 125'000,
        [channel](std::size_t i) {
          return 1'000 + std::floor(300 * std::sin(static_cast<double>(i * i % 10'007 + channel)));
        });
  builder.close();
  return builder.run;
}

class ReportSize : public testing::TestWithParam<std::size_t> {};

TEST_P(ReportSize, StaysBelow3MegabytesAndKeepsEveryOutlier) {
  const RunRecord run = big_run(GetParam());
  const Analysis analysis = analyze(run);
  ASSERT_GT(analysis.outliers.size(), 90'000 / GetParam());
  const std::string picture(1024 * 1024, 'x');
  const std::string page =
      report_html(run, analysis, {{"m_view0_reference", picture}, {"m_view0_A0_heat", picture}});
  EXPECT_LT(page.size(), 3'000'000u);
  const json data = data_of(page);
  EXPECT_EQ(data.at("outliers").at("ms").size(), analysis.outliers.size());
  std::size_t drawn = 0;
  for (const json& cell : data.at("frames"))
    for (const json& point : cell) drawn += point.is_number();
  EXPECT_EQ(drawn, analysis.outliers.size());
}

INSTANTIATE_TEST_SUITE_P(OneFrameIn, ReportSize, testing::Values(4, 25));

TEST(ReportPage, ClosesTheShortestGapsOfTooManyBands) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", std::vector<double>(12'000, 1.0));
  // On and off in turn; after each 1,000 a long pause.
  builder.add_channel("x.throttle.pl1", Quantity::throttle, Unit::none, Kind::flag, 1'000'000,
                      12'000, [](std::size_t i) { return i % 1'000 < 900 && i % 2 == 0 ? 1 : 0; });
  builder.close();
  const json bands = data_of(report_html(builder.run, analyze(builder.run))).at("bands");
  ASSERT_EQ(bands.size(), 1u);
  EXPECT_EQ(bands.at(0).at("spans").size(), 12u);
  EXPECT_EQ(bands.at(0).at("closed"), "1.00 ms");
  EXPECT_EQ(bands.at(0).at("channels"), json({"x.throttle.pl1"}));
}

}  // namespace
}  // namespace energyprof::analysis
