#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <png.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <random>
#include <sstream>

#include "analysis/report_html.h"
#include "analysis/report_json.h"
#include "analysis/report_md.h"
#include "analysis/report_text.h"
#include "page_data.h"
#include "planted_run.h"
#include "tests/sanitized.h"

namespace energyprof::analysis {
namespace {

using nlohmann::json;
using planted::RunBuilder;
using testing::HasSubstr;
using testing::Not;

json json_of(const RunRecord& run) { return report_json(run, analyze(run)); }
std::string md_of(const RunRecord& run) { return report_md(run, analyze(run)); }
std::string html_of(const RunRecord& run, const std::vector<ReportImage>& images = {}) {
  return report_html(run, analyze(run), images);
}

std::size_t count_of(const std::string& text, const std::string& part) {
  std::size_t count = 0;
  for (std::size_t at = text.find(part); at != text.npos; at = text.find(part, at + 1)) ++count;
  return count;
}

void expect_fields(const json& object, const std::vector<const char*>& names) {
  ASSERT_TRUE(object.is_object()) << object;
  for (const char* name : names) EXPECT_TRUE(object.contains(name)) << name << " in " << object;
}

TEST(ReportJson, HasEveryPromisedField) {
  const json report = json_of(planted::laptop_run());
  EXPECT_EQ(report.at("schema_version"), 1);
  EXPECT_TRUE(report.at("run").is_object());
  EXPECT_EQ(report.at("device").at("name"), "Iris Xe, planted");
  expect_fields(report.at("sensors").at(0),
                {"name", "quantity", "unit", "period_ns", "samples", "status"});
  expect_fields(report.at("ranking").at(0),
                {"algorithm", "score_ms", "normalized", "rank", "truncated_mean_ms", "stddev_ms"});
  expect_fields(report.at("cells").at(0),
                {"model", "view", "algorithm", "frames", "median_ms", "truncated_mean_ms",
                 "stddev_ms", "outlier_count", "mrays_per_s"});
  expect_fields(report.at("energy").at(0),
                {"algorithm", "model", "frames", "joules_per_frame", "nj_per_ray", "edp_js",
                 "idle_w", "gross_joules_per_frame", "channel", "refused"});
  expect_fields(report.at("energy").at(0).at("joules_per_frame"), {"value", "low", "high"});
  expect_fields(report.at("outliers").at(0), {"frame_id", "model", "view", "algorithm", "ratio",
                                              "excess_ms", "cause", "confidence", "evidence"});
  EXPECT_TRUE(report.at("warnings").is_array());
  expect_fields(report.at("correlations").at(0), {"x", "y", "method", "lag_ms", "coefficient",
                                                  "low", "high", "p", "q", "n", "verdict"});
  expect_fields(report.at("factors").at(0),
                {"name", "share_of_energy_variance", "share_of_time_variance"});
  expect_fields(report.at("coincidence"),
                {"outliers", "throttled_outliers", "exposure_ratio", "odds_ratio", "p", "verdict"});
  expect_fields(report.at("coincidence").at("odds_ratio"), {"value", "low", "high"});
}

TEST(ReportJson, NumbersAreThoseOfTheAnalysis) {
  const RunRecord run = planted::laptop_run();
  const Analysis analysis = analyze(run);
  const json report = report_json(run, analysis);
  EXPECT_EQ(report.at("cells").size(), 12u);
  EXPECT_EQ(report.at("ranking").at(1).at("normalized"), analysis.ranking[1].normalized);
  EXPECT_EQ(report.at("outliers").size(), analysis.outliers.size());
  EXPECT_EQ(report.at("missing_sensors").at(0).at("fix"), "sysctl kernel.perf_event_paranoid=1");
  EXPECT_TRUE(report.at("missing_sensors").at(1).at("fix").is_null());
}

TEST(ReportJson, UnknownIsNull) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", {1});
  builder.run.frames[0].ray_count.reset();
  const json report = json_of(builder.run);
  const json& cell = report.at("cells").at(0);
  for (const char* name :
       {"stddev_ms", "mrays_per_s", "hit_ratio", "median_low_ms", "checksums_agree"})
    EXPECT_TRUE(cell.at(name).is_null()) << name;
  EXPECT_TRUE(report.at("run").at("name").is_null());
  EXPECT_TRUE(report.at("energy").at(0).at("joules_per_frame").at("value").is_null());
}

/// A run whose only cell has all of its work known.
RunRecord worked_run() {
  RunBuilder builder;
  Trial& trial = builder.add_trial("m", 0, "GRID", {1, 2, 3});
  trial.build_ns = 12'000'000;
  trial.build_cached = true;
  trial.build_config = R"({"lambda":3.0})";
  trial.blob_bytes = 3 << 19;
  trial.ref_count = 77;
  trial.bytes_per_pixel = 641;
  trial.l1_misses_per_ray = 3.25;
  trial.llc_misses_per_ray = 0.0;
  trial.footprint_bytes = 4096;
  trial.cache_model =
      R"({"modelled":true,"l1":{"size_bytes":49152,"ways":12,"line_bytes":64,"source":"host"},
          "llc":{"size_bytes":8388608,"ways":16,"line_bytes":64,"source":"assumed"}})";
  FrameRecord counted = builder.run.frames.back();
  counted.phase = Phase::counted;
  counted.node_visit_count = 50'500;
  counted.loop_step_count = 61'250;
  counted.simd_efficiency = 0.875;
  builder.run.frames.push_back(counted);
  Event idle;
  idle.t_ns = planted::begin_ns;
  idle.end_ns = planted::begin_ns + 2'500'000'000;
  idle.kind = "idle";
  idle.text = "nothing was submitted";
  builder.run.events.push_back(idle);
  builder.close();
  return builder.run;
}

TEST(ReportJson, GivesTheWorkOfACellAndItsStructure) {
  const json report = json_of(worked_run());
  const json& work = report.at("cells").at(0).at("work");
  EXPECT_EQ(work.at("node_visits_per_ray"), 50.5);
  EXPECT_EQ(work.at("loop_steps_per_ray"), 61.25);
  EXPECT_EQ(work.at("simd_efficiency"), 0.875);
  EXPECT_TRUE(work.at("box_tests_per_ray").is_null());
  EXPECT_TRUE(work.at("prim_tests_per_ray").is_null());
  EXPECT_EQ(work.at("bytes_per_pixel_modelled"), 641.0);
  EXPECT_EQ(work.at("l1_misses_per_ray_modelled"), 3.25);
  EXPECT_EQ(work.at("llc_misses_per_ray_modelled"), 0.0) << "known to be none";
  EXPECT_EQ(work.at("cache_model").at("l1").at("ways"), 12);
  const json& structure = report.at("structures").at(0);
  expect_fields(structure, {"model", "algorithm", "parameters", "build_ms", "cached", "blob_mib",
                            "node_count", "leaf_count", "ref_count", "max_depth", "sah_cost"});
  EXPECT_EQ(structure.at("parameters").at("lambda"), 3.0);
  EXPECT_EQ(structure.at("cached"), true);
  EXPECT_EQ(structure.at("blob_mib"), 1.5);
  EXPECT_TRUE(structure.at("node_count").is_null());
  EXPECT_EQ(report.at("images"), json::array());
}

TEST(ReportMd, SaysWhatIsModelledAndOfWhich) {
  const std::string page = md_of(worked_run());
  EXPECT_THAT(page, HasSubstr("L1 misses, *modelled*"));
  EXPECT_THAT(page,
              HasSubstr("| m | 0 | GRID | 50.5 | - | - | 61.2 | 0.875 | 3.25 | 0.000 | 641 |"));
  EXPECT_THAT(page, HasSubstr("modelled, not measured"));
  EXPECT_THAT(page, HasSubstr("48 KiB (12 ways, lines of 64 bytes, as the host's CPU has it)"));
  EXPECT_THAT(page, HasSubstr("8 MiB (16 ways, lines of 64 bytes, assumed)"));
  EXPECT_THAT(page, HasSubstr("| m | GRID | 12.0 (cached) | 1.50 | - | - | - | 77 | - | - |"));
  EXPECT_THAT(page, HasSubstr("1 idle period, 2.50 s together"));
  EXPECT_THAT(page, Not(HasSubstr("nothing was submitted |")));
}

TEST(ReportMd, LinksToMontagesOnly) {
  const RunRecord run = worked_run();
  const std::string page = report_md(run, analyze(run),
                                     {"images/a b_view0_montage.png", "images/m_GRID_heat.png",
                                      "images/m_BVH_STACKLESS_DF_views.png"});
  EXPECT_THAT(page, HasSubstr("- [images/a b_view0_montage.png](images/a%20b_view0_montage.png)"));
  EXPECT_THAT(page, HasSubstr("(images/m_BVH_STACKLESS_DF_views.png)"));
  EXPECT_THAT(page, Not(HasSubstr("m_GRID_heat")));
}

TEST(ReportHtml, NamesPicturesWithoutBytes) {
  const json data = data_of(html_of({}, {{"m_view0_montage", ""}, {"m_view0_reference", "foo"}}));
  EXPECT_EQ(data.at("named_images"), json({"images/m_view0_montage.png"}));
  EXPECT_EQ(data.at("images").size(), 1u);
  EXPECT_EQ(data.at("report").at("images").size(), 2u);
  EXPECT_EQ(data_of(html_of(worked_run()))
                .at("cache_text")
                .get<std::string>()
                .find("Bytes and misses are modelled"),
            0u);
}

TEST(ReportJson, SaysWhatSamplingCosts) {
  RunRecord run = planted::laptop_run();
  EXPECT_TRUE(report_json(run, analyze(run), {})["sampler"]["self_check"].is_null());
  int64_t t_ns = planted::begin_ns;
  for (int64_t block = 0; block < 16; ++block)
    for (int i = 0; i < 3; ++i) {
      // 1 ms longer where the sampler is on; a little noise, or there is nothing to be sure of.
      const bool on = block % 4 == 0 || block % 4 == 3;
      const int64_t end_ns = t_ns + (on ? 11'000'000 : 10'000'000) + (block % 5) * 1'000;
      run.self_check.push_back({block, on, t_ns, end_ns});
      t_ns = end_ns;
    }
  run.meta["sampler_scheduling"] = "SCHED_FIFO, priority 10";
  run.meta["sampler_lateness_p50_ns"] = "30000";
  const json sampler = report_json(run, analyze(run), {})["sampler"];
  const json& check = sampler["self_check"];
  EXPECT_NEAR(check["difference_pct"]["value"].get<double>(), 10, 0.1);
  EXPECT_LT(check["difference_pct"]["low"], check["difference_pct"]["high"]);
  EXPECT_EQ(check["watts"]["channel"], "rapl.package-0.energy");
  EXPECT_EQ(check["blocks"], 16);
  EXPECT_EQ(check["frames"], 48);
  EXPECT_THAT(check["note"], HasSubstr("4 rounds"));
  EXPECT_EQ(sampler["scheduling"], "SCHED_FIFO, priority 10");
  EXPECT_EQ(sampler["lateness_p50_ns"], 30000);
  const std::string page = md_of(run);
  EXPECT_THAT(page, HasSubstr("Frame time with the sampler on, against off: +10.0"));
  EXPECT_THAT(page, HasSubstr("It ran under SCHED_FIFO, priority 10."));
}

TEST(ReportMd, ARecordedProgramHasReadingsAndNoFrames) {
  RunRecord run = planted::laptop_run();
  run.trials.clear();
  run.frames.clear();
  run.meta["command"] = "sleep <1>";
  const std::string page = md_of(run);
  EXPECT_THAT(page, HasSubstr("| command | sleep &lt;1&gt; |"));
  EXPECT_THAT(page, HasSubstr("## What the sensors showed"));
  EXPECT_THAT(page, HasSubstr("| energy | rapl.package-0.energy | 28."));
  EXPECT_THAT(page, HasSubstr("| throttle | i915.gt0.throttle.pl1 | set 24.9 % of the time |"));
  EXPECT_THAT(page, HasSubstr("| temperature | hwmon.coretemp.package_id_0.temp | 52.0 °C / "));
  EXPECT_THAT(page, Not(HasSubstr("## Ranking")));
  EXPECT_THAT(page, Not(HasSubstr("## Outliers")));
}

TEST(ReportMd, SaysWhatAReaderNeeds) {
  const std::string page = md_of(planted::laptop_run());
  EXPECT_THAT(page, HasSubstr("# energyprof: dragon"));
  EXPECT_THAT(page, HasSubstr("> **SIMULATED**"));
  EXPECT_THAT(page, HasSubstr("| 1 | GRID |"));
  EXPECT_THAT(page, HasSubstr("perf_event_paranoid is 3"));
  EXPECT_THAT(page, HasSubstr("W on average"));
  EXPECT_THAT(page, HasSubstr("of one core"));
  EXPECT_THAT(page, HasSubstr("No energy per frame is given, because "));
}

TEST(ReportMd, BeginsWithTheAnswer) {
  const std::string page = md_of(planted::laptop_run());
  EXPECT_LT(page.find("**GRID is best"), page.find("> **SIMULATED**"));
}

/// What stands there before anything is unfolded.
std::string unfolded(std::string page) {
  for (std::size_t begin; (begin = page.find("<details>")) != page.npos;) {
    const std::size_t end = page.find("</details>", begin);
    if (end == page.npos) return "a fold without end";
    page.erase(begin, end + 10 - begin);
  }
  return page;
}

TEST(ReportMd, FoldsWhatIsNotPartOfTheAnswer) {
  const std::string page = md_of(planted::laptop_run());
  const std::string shown = unfolded(page);
  EXPECT_THAT(shown, HasSubstr("## Ranking"));
  EXPECT_THAT(shown, HasSubstr("## Cost of measuring"));
  for (const char* folded : {"Frame times", "Work per ray", "What could not be seen", "Sensors"}) {
    EXPECT_THAT(page, HasSubstr(std::string("<summary>") + folded));
    EXPECT_THAT(shown, Not(HasSubstr(folded)));
  }
}

TEST(ReportMd, TablesKeepTheirColumns) {
  const std::string page = md_of(planted::laptop_run());
  std::istringstream lines(page);
  std::string line;
  long columns = 0;
  while (std::getline(lines, line)) {
    if (line.empty() || line[0] != '|') {
      columns = 0;
      continue;
    }
    long bars = 0;
    for (std::size_t i = 0; i < line.size(); ++i)
      bars += line[i] == '|' && line[i - (i > 0)] != '\\';
    if (columns != 0) {
      EXPECT_EQ(bars, columns) << line;
    }
    columns = bars;
  }
}

TEST(ReportMd, TextFromOutsideIsNeverMarkup) {
  EXPECT_THAT(md_of(planted::laptop_run()), Not(HasSubstr("<b>")));
}

TEST(ReportHtml, LoadsNothing) {
  const std::string page = html_of(planted::laptop_run());
  for (const char* load :
       {"src=\"http", "src='http", "src=http", "href=\"http", "href='http", "src=\"//", "href=\"//",
        "url(http", "url(\"http", "@import", "<link rel=\"stylesheet"})
    EXPECT_THAT(page, Not(HasSubstr(load)));
  EXPECT_THAT(page, HasSubstr("default-src 'none'"));
}

TEST(ReportHtml, HoldsTheReport) {
  const RunRecord run = planted::laptop_run();
  const json data = data_of(html_of(run));
  // What the page holds in a shorter form is left out.
  json report = json_of(run);
  EXPECT_EQ(data.at("outlier_count"), report.at("outliers").size());
  EXPECT_EQ(drawn_outlier_count(data), report.at("outliers").size());
  json shown = data.at("report");
  for (const char* name :
       {"outliers", "throttling", "events", "event_count", "regimes", "regime_count"}) {
    report.erase(name);
    shown.erase(name);
  }
  EXPECT_EQ(shown, report);
  EXPECT_EQ(data.at("answer"), answer_text(analyze(run)));
  ASSERT_EQ(data.at("frames").size(), 12u);
  EXPECT_EQ(drawn_frames(data, 0).size(), 40u);
  EXPECT_EQ(data.at("sensor_rows").size(), 6u);
  EXPECT_EQ(data.at("tracks").size(), 4u) << "power, frequency, temperature, throttle";
  EXPECT_EQ(data.at("not_drawn").at("constant"), json({"rapl.package-0.limit.long_term"}));
}

TEST(ReportHtml, PacksFramesWithoutLosingThem) {
  RunBuilder builder;
  // A kernel of 20 us and one of 40 s: both keep four digits.
  for (const double base_ms : {0.02, 40'000.0})
    for (int repetition = 0; repetition < 2; ++repetition) {
      std::vector<double> times_ms;
      for (int i = 0; i < 50; ++i)
        times_ms.push_back(base_ms * (i == 31 ? 7.5 : 1 + 0.001 * (i % 7)));
      builder.add_trial(base_ms < 1 ? "fast" : "slow", 0, "A", times_ms);
    }
  builder.close();
  const Analysis analysis = analyze(builder.run);
  ASSERT_EQ(analysis.outliers.size(), 4u);
  const json data = data_of(report_html(builder.run, analysis));
  for (std::size_t c = 0; c < 2; ++c) {
    const Cell& cell = analysis.cells[c];
    const std::vector<DrawnFrame> frames = drawn_frames(data, c);
    ASSERT_EQ(frames.size(), 100u);
    for (std::size_t i = 0; i < frames.size(); ++i) {
      const FrameRecord& frame = builder.run.frames[cell.frame_index[i]];
      EXPECT_NEAR(frames[i].ms, cell.frame_ms[i], 1e-4 * cell.frame_ms[i]);
      EXPECT_NEAR(frames[i].t_s, static_cast<double>(frame.begin_ns - planted::begin_ns) * 1e-9,
                  1e-5);
      EXPECT_EQ(frames[i].frame, frame.frame);
      EXPECT_EQ(frames[i].begins_trial, i % 50 == 0);
      EXPECT_EQ(frames[i].is_outlier, i % 50 == 31);
    }
  }
  const Outlier& outlier = analysis.outliers[0];
  const DrawnFrame slow = drawn_frames(data, outlier.cell).at(31);
  EXPECT_EQ(slow.cause, static_cast<int64_t>(outlier.attribution.cause));
  EXPECT_EQ(slow.is_stretch, outlier.shape == OutlierShape::stretch);
  EXPECT_NEAR(slow.excess_ms, outlier.excess_ms, 1e-4 * outlier.excess_ms);
  EXPECT_EQ(slow.confidence_percent, std::lround(100 * outlier.attribution.confidence));
}

TEST(ReportHtml, FillsTheWholePage) {
  const std::string page = html_of(planted::laptop_run());
  for (const char* name : {"{{title}}", "{{answer}}", "{{style}}", "{{data}}", "{{echarts}}",
                           "{{script}}", "{{licences}}"})
    EXPECT_THAT(page, Not(HasSubstr(name)));
  EXPECT_THAT(page, HasSubstr("Licensed to the Apache Software Foundation"));
  EXPECT_THAT(page, HasSubstr("Baidu Inc."));
}

TEST(ReportHtml, HostileNamesStayText) {
  RunRecord run = planted::laptop_run();
  run.meta["name"] = "<img src=x onerror=alert(1)> {{data}}";
  const std::string page = html_of(run);
  EXPECT_THAT(page, Not(HasSubstr("<img src=x")));
  EXPECT_THAT(page, Not(HasSubstr("</script><b>")));
  EXPECT_EQ(count_of(page, "</script>"), 3u) << "data, ECharts and our own script";
  EXPECT_EQ(data_of(page).at("report").at("cells").at(6).at("model"), "teapot </script><b>");
}

TEST(ReportHtml, GivesTheAnswerWithoutScripts) {
  const RunRecord run = planted::laptop_run();
  const std::string page = html_of(run);
  std::size_t at = 0;
  for (const std::string& sentence : answer_text(analyze(run))) {
    const std::size_t found = page.find("<p>" + sentence + "</p>");
    ASSERT_NE(found, page.npos) << sentence;
    EXPECT_GT(found, at);
    at = found;
  }
  EXPECT_LT(at, page.find("<nav"));
}

TEST(ReportHtml, ImagesAreEmbedded) {
  // RFC 4648, section 10: "foobar" is Zm9vYmFy, "fooba" is Zm9vYmE=, "foob" is Zm9vYg==.
  const json data = data_of(html_of({}, {{"a", "foobar"}, {"b", "fooba"}, {"c", "foob"}}));
  ASSERT_EQ(data.at("images").size(), 3u);
  EXPECT_EQ(data.at("images").at(0).at("src"), "data:image/png;base64,Zm9vYmFy");
  EXPECT_EQ(data.at("images").at(1).at("src"), "data:image/png;base64,Zm9vYmE=");
  EXPECT_EQ(data.at("images").at(2).at("src"), "data:image/png;base64,Zm9vYg==");
  EXPECT_EQ(data.at("images").at(0).at("title"), "a");
}

TEST(ReportHtml, ImagesThatDoNotFitAreNamed) {
  const std::string big(1024 * 1024, 'x');
  const json data = data_of(html_of(
      {}, {{"m_view0_GRID_heat", big}, {"m_view0_reference", big}, {"m_view1_reference", "foo"}}));
  ASSERT_EQ(data.at("images").size(), 2u);
  EXPECT_EQ(data.at("images").at(0).at("title"), "m_view0_reference") << "before heat maps";
  EXPECT_EQ(data.at("images_left_out"), json({"images/m_view0_GRID_heat.png"}));
}

TEST(ReportHtml, ShowsEveryPictureOfAFullStudy) {
  // 3 models, 3 views, 6 algorithms and the reference: noise, which packs worse than any heat map.
  std::mt19937 random(1);
  std::vector<uint8_t> rgb;
  const uint32_t width = test::is_sanitized ? 160 : 640;
  const uint32_t height = width * 9 / 16;
  for (uint32_t i = 0; i < 3 * width * height; ++i)
    rgb.push_back(static_cast<uint8_t>(random() % 64));
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  image.width = width;
  image.height = height;
  image.format = PNG_FORMAT_RGB;
  png_alloc_size_t bytes = 0;
  png_image_write_to_memory(&image, nullptr, &bytes, 0, rgb.data(), 0, nullptr);
  std::string picture(bytes, '\0');
  png_image_write_to_memory(&image, picture.data(), &bytes, 0, rgb.data(), 0, nullptr);
  std::vector<ReportImage> images;
  for (int i = 0; i < 63; ++i)
    images.push_back({fmt::format("m{}_view{}_A{}_heat", i / 21, i / 7 % 3, i % 7), picture});
  const std::string page = html_of(planted::laptop_run(), images);
  EXPECT_LT(page.size(), 3'000'000u);
  const json data = data_of(page);
  EXPECT_EQ(data.at("images").size(), 63u);
  EXPECT_EQ(data.at("images_left_out"), json::array());
  EXPECT_EQ(data.at("images").at(8).at("file"), "images/m0_view1_A1_heat.png");
}

TEST(ReportHtml, HeatMapsStandBesideTheirReferenceImage) {
  const json data = data_of(html_of({}, {{"a_b_view12_BVH_FTB_BF_heat", "foo"},
                                         {"a_b_view12_reference", "foo"},
                                         {"a_b_viewer", "foo"}}));
  const json& images = data.at("images");
  ASSERT_EQ(images.size(), 3u);
  EXPECT_EQ(images.at(0).at("what"), "reference");
  EXPECT_EQ(images.at(1).at("what"), "BVH_FTB_BF");
  EXPECT_EQ(images.at(1).at("place"), "a_b, view 12");
  EXPECT_EQ(images.at(2).at("place"), "");
}

TEST(ReportHtml, ABigRunStaysSmallAndKeepsItsPeaks) {
  RunBuilder builder;
  std::vector<double> times_ms(60'000, 1.0);
  times_ms[55'555] = 300;
  builder.add_trial("m", 0, "A", times_ms);
  for (int channel = 0; channel < 20; ++channel)
    builder.add_channel(
        "x.power" + std::to_string(channel), Quantity::power, Unit::milliwatt, Kind::gauge,
        1'000'000, 50'000, [channel](std::size_t i) {
          return i == 12'345
                     ? 987'654.0
                     : static_cast<double>((i * 37 + static_cast<std::size_t>(channel)) % 1000);
        });
  builder.close();
  const std::string page = html_of(builder.run);
  EXPECT_LT(page.size(), 3'000'000u);
  const json data = data_of(page);
  const std::vector<DrawnFrame> frames = drawn_frames(data, 0);
  EXPECT_LE(frames.size(), 20'000u);
  std::vector<double> slow_ms;
  for (const DrawnFrame& frame : frames)
    if (frame.is_outlier) slow_ms.push_back(frame.ms);
  ASSERT_EQ(slow_ms.size(), 1u);
  EXPECT_NEAR(slow_ms[0], 300, 1e-3);
  const json& channels = data.at("tracks").at(0).at("channels");
  ASSERT_EQ(channels.size(), 20u);
  for (const json& channel : channels) {
    EXPECT_LE(channel.at("value").size(), 2'000u);
    // 987,654 mW on an axis in W.
    EXPECT_NEAR(*std::max_element(channel.at("value").begin(), channel.at("value").end()), 987.654,
                1e-3);
  }
}

TEST(Reports, AnswerInThreeSentences) {
  const std::vector<std::string> answer = answer_text(analyze(planted::laptop_run()));
  ASSERT_EQ(answer.size(), 3u);
  EXPECT_THAT(answer[0], HasSubstr("GRID"));
  EXPECT_THAT(answer[0], HasSubstr("energy: not told, because "));
  EXPECT_THAT(answer[1], HasSubstr("timed frames were outliers, which lost "));
  EXPECT_THAT(answer[2], HasSubstr("Not seen: cache misses and other work on the machine"));
  EXPECT_THAT(answer[2], HasSubstr("not readable: perf and nvml."));
  EXPECT_THAT(md_of(planted::laptop_run()), HasSubstr("not readable: perf and nvml."));
}

TEST(Reports, SayWhoNeedsLeastEnergy) {
  Analysis analysis = analyze(planted::laptop_run());
  const auto row = [](const char* algorithm, const char* model, double nj) {
    EnergyRow made;
    made.algorithm = algorithm;
    made.model = model;
    made.nj_per_ray = Estimate{nj, {0.9 * nj, 1.1 * nj}};
    return made;
  };
  analysis.energy = {row("A", "m", 10), row("B", "m", 20)};
  EXPECT_THAT(answer_text(analysis)[0],
              HasSubstr("least energy: A with 10.0 nJ (9.0 to 11.0) a ray, before B at 20.0 nJ"));
  EXPECT_EQ(energy_of_text(analysis, "A"), "10.0 nJ (9.0 to 11.0)");
  analysis.energy.push_back(row("A", "n", 11));
  analysis.energy.push_back(row("B", "n", 10.5));
  EXPECT_THAT(answer_text(analysis)[0],
              HasSubstr("n: B with 10.5 nJ (9.5 to 11.6) a ray, not beyond doubt before A"));
  // Means over models: (10 + 11) / 2, and of their bounds.
  EXPECT_EQ(energy_of_text(analysis, "A"), "10.5 nJ (9.4 to 11.6)");
  analysis.energy.back().nj_per_ray.reset();
  analysis.energy.back().refused = "the counter is too slow";
  EXPECT_EQ(energy_of_text(analysis, "B"), "-");
  EXPECT_THAT(answer_text(analysis)[0],
              HasSubstr("not told for 1 of 4, because the counter is too slow"));
}

TEST(Reports, SayWhatDecidedOnACause) {
  EXPECT_EQ(evidence_text(Evidence{"x.freq", 650e6, 1.3e9, "Hz"}),
            "x.freq 650 MHz instead of 1.30 GHz");
  EXPECT_EQ(evidence_text(Evidence{"x.freq", 1.301e9, 1.3e9, "Hz"}), "x.freq 1.30 GHz, as usual");
  EXPECT_EQ(evidence_text(Evidence{"x.psi", 51.0, 2.5, "%"}), "x.psi 51 % instead of 2.5 %");
  EXPECT_EQ(evidence_text(Evidence{"x.pl1", 0.98, 0.0, "1"}),
            "x.pl1 set 98 % of the time instead of 0 %");
  EXPECT_EQ(evidence_text(Evidence{"x.pl1", 0.0, 0.0, "1"}), "x.pl1 not set, as usual");
  EXPECT_EQ(evidence_text(Evidence{"x.pl1", 0.0, std::nullopt, "1"}), "x.pl1 not set");
}

TEST(Reports, CountRatesHaveNoMilli) {
  RunBuilder builder;
  builder.add_channel("x.faults", Quantity::interference, Unit::count, Kind::cumulative,
                      1'000'000'000, 601,
                      [](std::size_t i) { return std::floor(static_cast<double>(i) / 100.0); });
  builder.add_channel("x.misses", Quantity::cache_miss, Unit::count, Kind::cumulative,
                      1'000'000'000, 601,
                      [](std::size_t i) { return 5e6 * static_cast<double>(i); });
  const Analysis analysis = analyze(builder.run);
  EXPECT_EQ(values_text(analysis.sensors.at(0)), "6, 0.01/s");
  EXPECT_EQ(values_text(analysis.sensors.at(1)), "3.00 G, 5.00 M/s");
}

TEST(Reports, IntervalsShareTheirPrefixAndDecimals) {
  const auto text = [](double value, double low, double high) {
    return estimate_text(Estimate{value, {low, high}}, 1e-3, "J");
  };
  EXPECT_EQ(text(22.2e-6, 21.34e-6, 23.1e-6), "22.2 nJ (21.3 to 23.1)");
  EXPECT_EQ(text(0.98, 0.9, 1.06), "0.98 mJ (0.90 to 1.06)");
  EXPECT_EQ(text(100, -500, 700), "100 mJ (-500 to 700)");
  EXPECT_EQ(text(0, 0, 0), "0.00 J (0.00 to 0.00)");
}

TEST(Reports, NeverRoundToCertainty) {
  EXPECT_EQ(confidence_text(0.931), "0.93");
  EXPECT_EQ(confidence_text(0.9961), "> 0.99");
  EXPECT_EQ(confidence_text(0.001), "< 0.01");
  EXPECT_EQ(confidence_text(0), "0.00");
}

/// Two studies of one shape: 6 algorithms on 3 models from 3 views, 40 channels, hundreds of
/// outliers and of events.
TEST(ReportMd, OfABigStudyFitsAPullRequest) {
  RunBuilder builder;
  for (const char* model : {"dragon", "bunny", "teapot"})
    for (int64_t view = 1; view <= 3; ++view)
      for (const char* algorithm :
           {"BVH_FTB_DF", "BVH_FTB_BF", "BVH_STACKLESS_DF", "KD_TREE", "KD_STACK", "GRID"}) {
        std::vector<double> times_ms;
        for (int i = 0; i < 60; ++i)
          times_ms.push_back(20 + 0.1 * std::sin(i * i) + (i % 10 == 3 ? 25 : 0));
        Trial& trial = builder.add_trial(model, view, algorithm, times_ms);
        trial.build_ns = 12'000'000;
        trial.triangle_count = 871'306;
        FrameRecord counted = builder.run.frames.back();
        counted.id += 1'000'000;
        counted.phase = Phase::counted;
        counted.node_visit_count = 50'500;
        builder.run.frames.push_back(counted);
      }
  for (int channel = 0; channel < 40; ++channel)
    builder.add_channel("hwmon.coretemp.package_id_0.temp" + std::to_string(channel),
                        Quantity::temperature, Unit::millicelsius, Kind::gauge, 10'000'000, 5'000,
                        [](std::size_t i) { return 50'000 + 100.0 * std::floor(std::sin(i) * 9); });
  for (int i = 0; i < 300; ++i) {
    Event event;
    event.t_ns = planted::begin_ns + i * 1'000'000;
    event.kind = "missed-ticks";
    event.text = "the sampler missed 3 ticks";
    builder.run.events.push_back(event);
  }
  builder.close();
  json missing = json::array();
  for (int i = 0; i < 60; ++i)
    missing.push_back({{"source", "source" + std::to_string(i)},
                       {"reason", "perf_event_paranoid is 3, and this needs 0 or CAP_PERFMON"},
                       {"fix", "sysctl kernel.perf_event_paranoid=0"}});
  builder.run.meta["missing_sensors"] = missing.dump();
  const std::string page = md_of(builder.run);
  EXPECT_LT(page.size(), 20'000u);
  EXPECT_LT(unfolded(page).size(), 6'000u);
  EXPECT_THAT(page, HasSubstr("more are in report.html and report.json"));
  EXPECT_THAT(page, HasSubstr("| dragon | 3 | "));
  std::istringstream lines(page);
  for (std::string line; std::getline(lines, line);)
    if (line.starts_with("| ")) {
      EXPECT_LE(std::count(line.begin(), line.end(), '|'), 13) << line;
    }
  EXPECT_EQ(count_of(page, "<details>"), count_of(page, "</details>"));
}

TEST(Reports, SayWhatKindOfRunItIs) {
  RunBuilder builder;
  builder.add_trial("m", 0, "A", {1, 2, 3});
  builder.close();
  builder.run.meta["interrupted"] = "1";
  builder.run.meta["quick"] = "1";
  EXPECT_EQ(json_of(builder.run).at("run").at("ending"), "interrupted");
  EXPECT_THAT(md_of(builder.run), HasSubstr("> **INTERRUPTED**"));
  EXPECT_THAT(md_of(builder.run), HasSubstr("> **QUICK**"));
  const json flags = data_of(html_of(builder.run)).at("report").at("run").at("flags");
  ASSERT_EQ(flags.size(), 2u);
  EXPECT_EQ(flags.at(0).at("label"), "QUICK");
}

TEST(Reports, OfAnEmptyRunExist) {
  EXPECT_EQ(json_of({}).at("cells"), json::array());
  EXPECT_THAT(md_of({}), HasSubstr("No timed frame was recorded"));
  EXPECT_EQ(data_of(html_of({})).at("tracks"), json::array());
}

TEST(Reports, OfAForeignRunExist) {
  // Another tool: frames without rays, an unknown unit, no meta at all.
  RunBuilder builder;
  builder.run.meta.clear();
  builder.add_trial("scene", 0, "tracer", {5, 6, 7, 8});
  for (FrameRecord& frame : builder.run.frames) {
    frame.ray_count.reset();
    frame.hit_count.reset();
    frame.clock_error_ns.reset();
    frame.hit_checksum.clear();
  }
  Channel& channel =
      builder.add_channel("meter.current", Quantity::power, Unit::none, Kind::gauge, 1'000'000, 5,
                          [](std::size_t i) { return 0.5 + static_cast<double>(i); });
  channel.unit_text = "furlong";
  const json report = json_of(builder.run);
  EXPECT_EQ(report.at("sensors").at(0).at("unit"), "furlong");
  EXPECT_EQ(report.at("device"), json::object());
  EXPECT_THAT(md_of(builder.run), HasSubstr("furlong"));
  EXPECT_EQ(data_of(html_of(builder.run)).at("tracks").at(0).at("unit"), "furlong");
}

}  // namespace
}  // namespace energyprof::analysis
