// report.html in a browser: its charts, its zoom, what it says of outliers, and its size.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>

#include "../end_to_end/program.h"
#include "analysis/analyze_frames.h"
#include "analysis/report_html.h"
#include "page_data.h"
#include "planted_run.h"
#include "synthetic_run.h"
#include "tests/sanitized.h"

namespace energyprof::analysis {
namespace {

using nlohmann::json;
using planted::RunBuilder;
using test::TempDir;
using testing::HasSubstr;
using testing::Not;

/// Frames of which a share is slow, in stretches, under 40 channels of 125,000 samples each.
RunRecord big_run(std::size_t frame_count, double slow_share) {
  RunBuilder builder;
  for (std::size_t trial = 0; trial < 100; ++trial) {
    std::vector<double> times_ms;
    for (std::size_t i = 0; i < frame_count / 100; ++i)
      times_ms.push_back(
          (1 + 0.02 * std::sin(static_cast<double>(i * i))) *
          (static_cast<double>(i % 20) < 20 * slow_share ? 2 + static_cast<double>(i % 13) : 1));
    builder.add_trial("m", static_cast<int64_t>(trial % 5), "A" + std::to_string(trial / 5 % 5),
                      times_ms);
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

/// Uses the charts as a reader would, and writes what it saw into the page.
constexpr const char* visitor = R"page(<script>
const chart = echarts.getInstanceByDom(document.getElementById("chart"));
const data = JSON.parse(document.getElementById("data").textContent);
const seen = { dark: matchMedia("(prefers-color-scheme: dark)").matches };
const named = (node) => node.getAttribute("aria-label");
seen.wide = [...document.querySelectorAll(".scroll")].filter((node) => node.scrollWidth > node.clientWidth + 1).map(named);
seen.page_is_wide = document.documentElement.scrollWidth > window.innerWidth;
const node = document.getElementById("chart");
// As the browser tells of a mouse at that place of the chart.
const mouse = (type, x, y, more) => {
  const { left, top } = node.getBoundingClientRect();
  const event = new (type === "wheel" ? WheelEvent : MouseEvent)(type,
    { bubbles: true, cancelable: true, view: window, clientX: left + x, clientY: top + y, ...more });
  node.querySelector("canvas").dispatchEvent(event);
  return event.defaultPrevented;
};
const width_of_zoom = () => { const { start, end } = chart.getOption().dataZoom[0]; return end - start; };
if (chart) {
  const option = chart.getOption();
  seen.series = option.series.map((series) => ({ name: series.name, points: series.data.length,
    bands: series.markArea ? series.markArea.data.length : 0,
    hatched: Boolean(series.markArea && series.markArea.itemStyle.color.image) }));
  seen.titles = option.title.map((title) => title.text);
  seen.whole = chart.getModel().getComponent("xAxis", 0).axis.scale.getExtent();
  chart.dispatchAction({ type: "dataZoom", start: 25, end: 50 });
  seen.zoomed = chart.getModel().getComponent("xAxis", 0).axis.scale.getExtent();
  seen.track = chart.getModel().getComponent("xAxis", 1).axis.scale.getExtent();
  document.getElementById("zoom_all").click();
  seen.again = chart.getModel().getComponent("xAxis", 0).axis.scale.getExtent();
  document.getElementById("zoom_in").click();
  seen.half = width_of_zoom();
  document.getElementById("zoom_all").click();
  seen.wheel = { taken: mouse("wheel", 400, 120, { deltaY: -300 }), width: width_of_zoom() };
  seen.ctrl_wheel_taken = mouse("wheel", 400, 120, { deltaY: -300, ctrlKey: true });
  const slow = option.series.find((series) => series.type === "scatter" && series.data.length > 0);
  if (slow) {
    seen.cause = slow.name;
    seen.channels = data.evidence.channels;
    document.getElementById("zoom_all").click();
    mouse("mousemove", ...chart.convertToPixel({ xAxisIndex: 0, yAxisIndex: 0 }, slow.data[0]));
    seen.tip = document.getElementById("chart").lastElementChild.textContent;
    document.getElementById("outlier_next").click();
    seen.walk = document.getElementById("outlier_text").textContent;
  }
  window.dispatchEvent(new Event("beforeprint"));
  seen.ink = chart.getOption().legend[0].textStyle.color;
  seen.paper = [...document.querySelectorAll(".paper")].map((piece) => ({ section: piece.closest("section").id,
    height: piece.height / piece.width, label: named(piece) }));
  seen.closed_on_paper = document.querySelectorAll("main details:not([open])").length;
  window.dispatchEvent(new Event("afterprint"));
  seen.paper_left = document.querySelectorAll(".paper").length + document.querySelectorAll("main details[open]").length;
  seen.charts = ["scatter_chart", "pareto", "theory_chart"].filter((id) =>
    document.getElementById(id).querySelector("canvas"));
}
document.body.append(Object.assign(document.createElement("pre"), { id: "seen", textContent:
  btoa(String.fromCharCode(...new TextEncoder().encode(JSON.stringify(seen)))) }));
</script></body>)page";

/// Opens the page in a browser; `visited` is what the visitor saw.
class Browser : public testing::Test {
 protected:
  void SetUp() override {
    if (test::run({"chromium", "--version"}).code != 0) GTEST_SKIP() << "chromium is not installed";
  }

  /// `scheme`: what the reader's system prefers.
  json visit(const std::string& page, const std::string& scheme = "light") {
    std::string visited = page;
    const std::size_t end = visited.rfind("</body>");
    visited.replace(end, 7, visitor);
    std::ofstream(dir_ / "report.html") << visited;
    const test::Output output = test::run(
        {"timeout", "60", "chromium", "--headless", "--no-sandbox", "--disable-gpu",
         "--disable-quic", "--no-first-run", "--disable-background-networking",
         "--disable-component-update", "--disable-sync",
         "--user-data-dir=" + (dir_ / "browser").string(), "--enable-logging=stderr",
         "--window-size=1280,1200",
         std::string("--blink-settings=preferredColorScheme=") + (scheme == "dark" ? "0" : "1"),
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
  EXPECT_EQ(seen.at("wide"), json::array()) << "tables fit into 1280 pixels";
  EXPECT_EQ(seen.at("page_is_wide"), false);
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
  const auto said = [&](const json& channel) {
    return seen.at("tip").get<std::string>().find(channel) != std::string::npos;
  };
  EXPECT_TRUE(std::any_of(seen.at("channels").begin(), seen.at("channels").end(), said))
      << seen.at("tip");
  EXPECT_THAT(dom_, HasSubstr("Outliers and throttling"));
  EXPECT_THAT(seen.at("charts").dump(), HasSubstr("scatter_chart"));
}

TEST_F(Browser, LeavesTheWheelToThePageAndTakesItWithCtrl) {
  const RunRecord run = planted::laptop_run();
  const json seen = visit(report_html(run, analyze(run)));
  ASSERT_TRUE(seen.contains("half")) << "the page's script stopped";
  EXPECT_EQ(seen.at("wheel").at("taken"), false);
  EXPECT_EQ(seen.at("wheel").at("width"), 100);
  EXPECT_EQ(seen.at("ctrl_wheel_taken"), true);
}

TEST_F(Browser, PrintsChartsInPiecesThatFitAPageDarkOnLight) {
  const RunRecord run = planted::laptop_run();
  const std::string page = report_html(run, analyze(run));
  const json light = visit(page);
  const json dark = visit(page, "dark");
  EXPECT_EQ(dark.at("dark"), true);
  for (const json& seen : {light, dark}) {
    ASSERT_TRUE(seen.contains("half")) << "the page's script stopped";
    EXPECT_EQ(seen.at("ink"), "#1b2127") << "of the text on paper";
    std::size_t pieces_over_time = 0;
    for (const json& piece : seen.at("paper")) {
      if (piece.at("section") == "time") ++pieces_over_time;
      // A4 without margins of 1 cm is 1.46 times as high as wide.
      EXPECT_LT(piece.at("height").get<double>(), 1.2) << piece;
      EXPECT_FALSE(piece.at("label").get<std::string>().empty());
    }
    EXPECT_GT(pieces_over_time, 3u) << "one with the frames, and one for each track of sensors";
    EXPECT_EQ(seen.at("closed_on_paper"), 0);
    EXPECT_EQ(seen.at("paper_left"), 0);
  }
}

TEST_F(Browser, TellsInferredThrottlingWithoutColours) {
  synthetic::Options options;
  options.seed = 3;
  options.effects = {synthetic::Effect::power};
  for (const bool has_flags : {true, false}) {
    options.reason_flags = has_flags;
    const RunRecord run = synthetic::make_run(options).run;
    const json seen = visit(report_html(run, analyze(run)));
    ASSERT_TRUE(seen.contains("half")) << "the page's script stopped";
    std::set<bool> hatched;
    for (const json& series : seen.at("series"))
      if (series.at("bands") > 0) {
        EXPECT_EQ(series.at("hatched"),
                  series.at("name").get<std::string>().ends_with("(inferred)"));
        hatched.insert(series.at("hatched").get<bool>());
      }
    EXPECT_TRUE(hatched.contains(!has_flags));
    // Each class has a lane that says what it is and who tells of it.
    EXPECT_THAT(seen.at("titles").dump(), HasSubstr(has_flags ? ", by " : "(inferred), by "));
  }
}

TEST_F(Browser, DrawsARunWhereMostFramesAreSlow) {
  const RunRecord run = big_run(test::is_sanitized ? 2'000 : 20'000, 0.6);
  const Analysis analysis = analyze(run);
  const json seen = visit(report_html(run, analysis));
  ASSERT_TRUE(seen.contains("half")) << "the page's script stopped";
  std::size_t outlier_count = 0;
  for (const json& series : seen.at("series"))
    for (std::size_t k = 0; k < cause_count; ++k)
      if (series.at("name") == to_string(static_cast<Cause>(k)))
        outlier_count += series.at("points").get<std::size_t>();
  EXPECT_EQ(outlier_count, analysis.outliers.size());
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
  EXPECT_FALSE(seen.contains("series")) << "there is no chart to visit";
  EXPECT_THAT(dom_, HasSubstr("No timed frame was recorded"));
  EXPECT_THAT(dom_, HasSubstr("There is nothing to draw"));
}

class ReportSize : public testing::TestWithParam<double> {};

TEST_P(ReportSize, StaysBelow3MegabytesAndKeepsEveryOutlier) {
  const RunRecord run = big_run(test::is_sanitized ? 10'000 : 100'000, GetParam());
  const Analysis analysis = analyze(run);
  ASSERT_GT(static_cast<double>(analysis.outliers.size()),
            0.9 * GetParam() * static_cast<double>(run.frames.size()));
  const std::string picture(1024 * 1024, 'x');
  const std::string page =
      report_html(run, analysis, {{"m_view0_reference", picture}, {"m_view0_A0_heat", picture}});
  EXPECT_LT(page.size(), 3'000'000u);
  const json data = data_of(page);
  EXPECT_EQ(data.at("outlier_count"), analysis.outliers.size());
  EXPECT_EQ(drawn_outlier_count(data), analysis.outliers.size());
}

INSTANTIATE_TEST_SUITE_P(ShareOfSlowFrames, ReportSize, testing::Values(0.05, 0.6));

/// The analysis as if every frame were an outlier with all the evidence there is.
Analysis all_slow(const RunRecord& run, Analysis analysis) {
  analysis.outliers.clear();
  for (std::size_t c = 0; c < analysis.cells.size(); ++c)
    for (std::size_t i = 0; i < analysis.cells[c].frame_index.size(); ++i) {
      Outlier outlier;
      outlier.cell = c;
      outlier.frame_index = analysis.cells[c].frame_index[i];
      outlier.frame_ms = analysis.cells[c].frame_ms[i];
      outlier.excess_ms = outlier.frame_ms * (0.3 + 0.1 * std::sin(static_cast<double>(i)));
      outlier.baseline_ms = outlier.frame_ms - outlier.excess_ms;
      outlier.attribution.cause = static_cast<Cause>(i % cause_count);
      outlier.attribution.confidence = 0.9;
      for (std::size_t k = 0; k < 4; ++k)
        outlier.attribution.evidence.push_back(
            {run.channels[(i + k) % run.channels.size()].name, 1234.567, 2345.678, "Hz"});
      analysis.outliers.push_back(outlier);
    }
  return analysis;
}

TEST(ReportPage, HoldsEveryFrameWhereAllAreOutliers) {
  const std::size_t frame_count = test::is_sanitized ? 10'000 : 100'000;
  const RunRecord run = big_run(frame_count, 0.05);
  const std::string page = report_html(run, all_slow(run, analyze(run)));
  EXPECT_LT(page.size(), 3'000'000u);
  EXPECT_EQ(drawn_outlier_count(data_of(page)), frame_count);
}

TEST(ReportPage, SaysWhichOutliersItLeavesOut) {
  if (test::is_sanitized) GTEST_SKIP() << "takes minutes, and other tests run the same code";
  const RunRecord run = big_run(120'000, 0.05);
  const std::string page = report_html(run, all_slow(run, analyze_frames(run)));
  EXPECT_LT(page.size(), 3'000'000u);
  const json data = data_of(page);
  EXPECT_EQ(data.at("outlier_count"), 120'000);
  EXPECT_EQ(drawn_outlier_count(data), 100'000u);
}

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
