// The program from outside: its outputs, its exit codes, the exact line for each kind of bad input.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <png.h>

#include <chrono>
#include <nlohmann/json.hpp>
#include <set>
#include <thread>
#include <tuple>

#include "core/run_db.h"
#include "tests/end_to_end/program.h"

namespace energyprof {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using test::Output;
using test::Process;
using test::read_text;
using testing::EndsWith;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

using Arguments = std::vector<std::string>;
using Environment = std::map<std::string, std::string>;

class Program : public testing::Test {
 protected:
  static Arguments command(Arguments arguments) {
    arguments.insert(arguments.begin(), ENERGYPROF_PROGRAM);
    return arguments;
  }
  /// `env`, and what keeps a test to itself: structures are kept in its own folder.
  [[nodiscard]] Environment environment(Environment env = {}) const {
    env.insert({"XDG_CACHE_HOME", (dir_ / "cache").string()});
    env.insert({"MESA_SHADER_CACHE_DIR", fs::temp_directory_path().string()});
    return env;
  }
  /// Runs the program with Vulkan validation, whose messages fail it, unless `env` says otherwise.
  [[nodiscard]] Output program(const Arguments& arguments, Environment env = {}) const {
    env.insert({"ENERGYPROF_VALIDATION", "1"});
    return test::run(command(arguments), environment(env));
  }

  /// A study of the teapot that takes a second, with `more` arguments.
  [[nodiscard]] Arguments small_study(const Arguments& more = {}) const {
    Arguments arguments{"--config", config_, "--out", out().string()};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return arguments;
  }
  [[nodiscard]] fs::path out() const { return dir_ / "run"; }

  [[nodiscard]] std::string write(const std::string& name, const std::string& content) const {
    std::ofstream(dir_ / name, std::ios::binary) << content;
    return (dir_ / name).string();
  }

  static constexpr const char* small_config = R"({
    // Comments are allowed.
    "name": "small", "models": ["teapot:2"], "algorithms": ["BVH_FTB_DF"],
    "image": {"width": 64, "height": 36}, "frames": {"warmup": 1, "timed": 8},
    "sampler": {"self_check": false},
    "idle": {"before_s": 0, "between_s": 0, "after_s": 0}
  })";

  test::TempDir dir_;
  std::string config_ = write("small.json", small_config);
};

/// No device, no test of tracing.
class Tracing : public Program {
 protected:
  void SetUp() override {
    const json probe = json::parse(program({"probe", "--json"}).out);
    for (const json& device : probe.at("devices"))
      if (device.at("refused").is_null()) return;
    GTEST_SKIP() << "no Vulkan device";
  }
};

json read_json(const fs::path& file) { return json::parse(read_text(file)); }

// ---------------------------------------------------------------------------- the study

TEST_F(Tracing, LeavesEverythingItPromises) {
  const Output output = program(small_study());
  ASSERT_EQ(output.code, 0) << output.err;
  for (const char* name :
       {"run.sqlite", "timeline.json", "report.json", "report.md", "report.html",
        "images/teapot_2_view0_reference.png", "images/teapot_2_view0_BVH_FTB_DF_heat.png",
        "images/teapot_2_view0_montage.png"}) {
    EXPECT_TRUE(fs::exists(out() / name)) << name;
  }
  EXPECT_FALSE(fs::exists(out() / "run.sqlite-wal"));
  EXPECT_THAT(output.out, HasSubstr("BVH_FTB_DF"));
  EXPECT_THAT(output.out, HasSubstr((out() / "report.html").string()));
  // The answer comes last: what could not be seen is its end.
  const std::string last = output.out.substr(output.out.rfind('\n', output.out.size() - 2) + 1);
  EXPECT_TRUE(last.starts_with("Not seen: ") || last.starts_with("Every kind of sensor delivered"))
      << last;
  EXPECT_THAT(output.err, Not(HasSubstr("\033")));  // no terminal, no control codes
  EXPECT_THAT(output.err, HasSubstr("[1/3] teapot:2 view "));

  const RunRecord run = read_run(out());
  EXPECT_EQ(run.trials.size(), 3u);
  EXPECT_EQ(run.frames.size(), 3u * (1 + 8 + 1));
  for (const FrameRecord& frame : run.frames) {
    EXPECT_GT(frame.end_ns, frame.begin_ns);
    EXPECT_GE(frame.begin_ns + frame.clock_error_ns.value_or(0), frame.submit_ns);
    EXPECT_EQ(frame.hit_checksum.size(), 16u);
    EXPECT_GE(frame.ray_count, 64 * 36);
    EXPECT_EQ(frame.node_visit_count.has_value(), frame.phase == Phase::counted);
    EXPECT_EQ(frame.loop_step_count.has_value(), frame.phase == Phase::counted);
    EXPECT_EQ(frame.simd_efficiency.has_value(), frame.phase == Phase::counted);
    if (frame.simd_efficiency) {
      EXPECT_GT(*frame.simd_efficiency, 0.0);
      EXPECT_LE(*frame.simd_efficiency, 1.0);
    }
  }
  for (const Trial& trial : run.trials) {
    EXPECT_EQ(json::parse(trial.build_config).at("buckets"), 12);
    EXPECT_EQ(trial.build_cached, false);
    EXPECT_EQ(trial.ref_count, trial.triangle_count);
    EXPECT_GT(trial.bytes_per_pixel, 0.0);
    EXPECT_GT(trial.l1_misses_per_ray, 0.0);
    EXPECT_GE(trial.l1_misses_per_ray, trial.llc_misses_per_ray);
    EXPECT_GT(trial.footprint_bytes, 0);
    EXPECT_EQ(json::parse(trial.cache_model).at("modelled"), true);
    for (const FrameRecord& frame : run.frames)
      if (frame.trial_id == trial.id) {
        EXPECT_LE(frame.end_ns, trial.end_ns);
      }
  }
  EXPECT_FALSE(run.channels.empty());
  EXPECT_FALSE(run.series.empty());
  for (const char* key : {"schema_version", "config", "host", "device", "driver", "code_version",
                          "begin_ns", "end_ns", "interrupted", "simulated"}) {
    EXPECT_TRUE(run.meta.contains(key)) << key;
  }
  EXPECT_EQ(run.meta.at("interrupted"), "0");
  EXPECT_EQ(run.meta.at("simulated"), "0");

  const json report = read_json(out() / "report.json");
  EXPECT_EQ(report["cells"].size(), 3u);
  EXPECT_EQ(report["ranking"][0]["algorithm"], "BVH_FTB_DF");
  EXPECT_FALSE(read_json(out() / "timeline.json")["traceEvents"].empty());
}

TEST_F(Tracing, TwoRunsHitTheSame) {
  ASSERT_EQ(program(small_study({"--quiet"})).code, 0);
  const RunRecord first = read_run(out());
  fs::remove_all(out());
  ASSERT_EQ(program(small_study({"--quiet"})).code, 0);
  const RunRecord second = read_run(out());
  ASSERT_EQ(first.frames.size(), second.frames.size());
  for (size_t i = 0; i < first.frames.size(); ++i)
    EXPECT_EQ(first.frames[i].hit_checksum, second.frames[i].hit_checksum);
}

// ---------------------------------------------------------------------------- algorithms

constexpr const char* all_algorithms =
    R"(algorithms=["BVH_FTB_DF","BVH_FTB_BF","BVH_STACKLESS_DF","KD_TREE","KD_STACK","GRID"])";

/// Whether a PNG has pixels of more than one colour.
bool has_colours(const fs::path& file) {
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  if (png_image_begin_read_from_file(&image, file.c_str()) == 0) return false;
  image.format = PNG_FORMAT_RGB;
  std::vector<uint8_t> rgb(PNG_IMAGE_SIZE(image));
  if (png_image_finish_read(&image, nullptr, rgb.data(), 0, nullptr) == 0) return false;
  for (size_t i = 3; i < rgb.size(); ++i)
    if (rgb[i] != rgb[i % 3]) return true;
  return false;
}

TEST_F(Tracing, AllAlgorithmsHitTheSameAndGetTheirPictures) {
  const Output output =
      program(small_study({"--set", all_algorithms, "--set", "frames.timed=2", "--set",
                           R"(models=["teapot:3","teapot:2"])", "--set", "views=[0,2]"}));
  ASSERT_EQ(output.code, 0) << output.err;
  const RunRecord run = read_run(out());
  ASSERT_EQ(run.trials.size(), 2u * 2 * 6);
  std::map<int64_t, const Trial*> trials;
  for (const Trial& trial : run.trials) {
    EXPECT_EQ(trial.skip_reason, "") << trial.algorithm;
    trials[trial.id] = &trial;
  }
  std::map<std::tuple<std::string, int64_t, int64_t>, std::set<std::string>> found;
  for (const FrameRecord& frame : run.frames) {
    const Trial& trial = *trials.at(frame.trial_id);
    found[{trial.model, trial.view, frame.frame}].insert(frame.hit_checksum);
  }
  EXPECT_EQ(found.size(), 2u * 2 * 4);
  for (const auto& [frame, checksums] : found) EXPECT_EQ(checksums.size(), 1u);

  // KD_TREE and KD_STACK traverse one structure; the three BVHs are three files.
  size_t kept_count = 0;
  for ([[maybe_unused]] const auto& entry :
       fs::directory_iterator(dir_ / "cache/energyprof/structures"))
    ++kept_count;
  EXPECT_EQ(kept_count, 2u * 5);

  const json report = read_json(out() / "report.json");
  for (const json& cell : report["cells"]) {
    EXPECT_EQ(cell["checksums_agree"], true);
    const std::string model = cell["model"] == "teapot:3" ? "teapot_3" : "teapot_2";
    const fs::path heat = out() / "images" /
                          (model + "_view" + cell["view"].dump() + "_" +
                           cell["algorithm"].get<std::string>() + "_heat.png");
    EXPECT_TRUE(has_colours(heat)) << heat;
  }
  EXPECT_EQ(report["structures"].size(), 2u * 6);
  EXPECT_TRUE(has_colours(out() / "images/teapot_2_BVH_STACKLESS_DF_views.png"));
  EXPECT_TRUE(has_colours(out() / "images/teapot_3_view2_montage.png"));
  EXPECT_THAT(read_text(out() / "report.md"), HasSubstr("](images/teapot_2_view0_montage.png)"));
}

TEST_F(Tracing, KeptStructuresAreUsedAndNeverTrusted) {
  const auto study = [&] {
    fs::remove_all(out());
    return program(small_study({"--set", "views=[0]"}));
  };
  ASSERT_EQ(study().code, 0);
  const RunRecord first = read_run(out());
  ASSERT_EQ(study().code, 0);
  const RunRecord second = read_run(out());
  ASSERT_EQ(first.trials.size(), 1u);
  ASSERT_EQ(second.trials.size(), 1u);
  EXPECT_EQ(first.trials[0].build_cached, false);
  EXPECT_EQ(second.trials[0].build_cached, true);
  EXPECT_EQ(second.trials[0].build_ns, first.trials[0].build_ns);

  fs::path kept;
  for (const auto& entry : fs::directory_iterator(dir_ / "cache/energyprof/structures"))
    kept = entry.path();
  std::string bytes = read_text(kept);
  bytes[bytes.size() / 2] = static_cast<char>(bytes[bytes.size() / 2] ^ 1);
  std::ofstream(kept, std::ios::binary) << bytes;
  const Output output = study();
  EXPECT_EQ(output.code, 0) << output.err;
  EXPECT_THAT(output.err, HasSubstr(kept.string()));
  const RunRecord third = read_run(out());
  EXPECT_EQ(third.trials[0].build_cached, false);
  EXPECT_EQ(std::count_if(third.events.begin(), third.events.end(),
                          [](const Event& event) {
                            return event.kind == "cache" && event.severity == Severity::warning;
                          }),
            1);
  ASSERT_EQ(third.frames.size(), first.frames.size());
  for (size_t i = 0; i < third.frames.size(); ++i) {
    EXPECT_EQ(second.frames[i].hit_checksum, first.frames[i].hit_checksum);
    EXPECT_EQ(third.frames[i].hit_checksum, first.frames[i].hit_checksum);
  }
}

TEST_F(Tracing, WithoutTheStructureCacheNothingIsKept) {
  ASSERT_EQ(program(small_study({"--quiet", "--set", "structure_cache=false"})).code, 0);
  EXPECT_FALSE(fs::exists(dir_ / "cache/energyprof"));
}

TEST_F(Tracing, ACacheThatCannotBeWrittenCostsAnEvent) {
  const Output output = program(small_study(), {{"XDG_CACHE_HOME", "/proc/nowhere"}});
  EXPECT_EQ(output.code, 0) << output.err;
  const RunRecord run = read_run(out());
  for (const Trial& trial : run.trials) EXPECT_EQ(trial.skip_reason, "");
  EXPECT_EQ(std::count_if(run.events.begin(), run.events.end(),
                          [](const Event& event) { return event.kind == "cache"; }),
            1);
}

TEST_F(Tracing, AModelThatCannotBeHadCostsItsTrials) {
  const Output output = program(small_study({"--set", R"(models=["/nowhere/x.ply","teapot:2"])"}));
  EXPECT_EQ(output.code, 0) << output.err;
  EXPECT_THAT(output.err, HasSubstr("without /nowhere/x.ply: cannot read '/nowhere/x.ply'"));
  const RunRecord run = read_run(out());
  ASSERT_EQ(run.trials.size(), 6u);
  for (const Trial& trial : run.trials)
    EXPECT_EQ(trial.skip_reason, trial.model == "teapot:2"
                                     ? ""
                                     : "cannot read '/nowhere/x.ply': No such file or directory.");
  const json report = read_json(out() / "report.json");
  EXPECT_EQ(report["cells"].size(), 3u);
  EXPECT_EQ(report["ranking"].size(), 1u);
}

TEST_F(Tracing, IdlePeriodsAreRecordedAndLieOutsideTheTrials) {
  const Output output = program(small_study(
      {"--set", R"(idle={"before_s":0.3,"between_s":0.1,"after_s":0.2})", "--set", "views=[0,1]"}));
  ASSERT_EQ(output.code, 0) << output.err;
  const RunRecord run = read_run(out());
  std::vector<Event> idle;
  std::copy_if(run.events.begin(), run.events.end(), std::back_inserter(idle),
               [](const Event& event) { return event.kind == "idle"; });
  ASSERT_EQ(idle.size(), 3u);
  const int64_t least_ns[] = {300'000'000, 100'000'000, 200'000'000};
  for (size_t i = 0; i < idle.size(); ++i) {
    EXPECT_EQ(idle[i].severity, Severity::info);
    ASSERT_TRUE(idle[i].end_ns);
    EXPECT_GE(*idle[i].end_ns - idle[i].t_ns, least_ns[i]);
    for (const FrameRecord& frame : run.frames)
      EXPECT_TRUE(frame.end_ns <= idle[i].t_ns || frame.submit_ns >= *idle[i].end_ns);
    for (const Trial& trial : run.trials)
      EXPECT_TRUE(*trial.end_ns <= idle[i].t_ns || trial.begin_ns >= *idle[i].end_ns);
  }
  EXPECT_THAT(read_text(out() / "report.md"), HasSubstr("3 idle periods"));
}

TEST_F(Tracing, MeasuresWhatSamplingCosts) {
  const Output output =
      program(small_study({"--quick", "--set", "sampler.self_check=true", "--set", "views=[0]"}));
  ASSERT_EQ(output.code, 0) << output.err;
  const RunRecord run = read_run(out());
  ASSERT_EQ(run.frames.size(), 10u);  // the study's own
  std::map<int64_t, std::vector<const SelfCheckFrame*>> blocks;
  for (const SelfCheckFrame& frame : run.self_check) blocks[frame.block].push_back(&frame);
  ASSERT_GE(blocks.size(), 16u);
  for (const auto& [block, frames] : blocks) {
    EXPECT_GE(frames.size(), 5u);
    for (const SelfCheckFrame* frame : frames)
      EXPECT_EQ(frame->sampler_on, block % 4 == 0 || block % 4 == 3);
  }
  // While it is off nothing is sampled.
  size_t off_count = 0;
  for (const Event& event : run.events) {
    if (event.kind != "sampler-off") continue;
    ++off_count;
    for (const auto& [id, series] : run.series)
      for (const int64_t t_ns : series.t_ns)
        EXPECT_TRUE(t_ns <= event.t_ns || t_ns >= *event.end_ns);
  }
  EXPECT_EQ(off_count, blocks.size() / 4);
  const json sampler = read_json(out() / "report.json")["sampler"];
  EXPECT_EQ(sampler["self_check"]["blocks"], blocks.size());
  EXPECT_EQ(sampler["self_check"]["frames"], run.self_check.size());
  EXPECT_LE(sampler["self_check"]["difference_pct"]["low"],
            sampler["self_check"]["difference_pct"]["high"]);
  EXPECT_TRUE(sampler["scheduling"].is_string());
  EXPECT_THAT(output.out, HasSubstr("Frame time with the sampler on, against off: "));
}

TEST_F(Tracing, SourcesArePolledAsOftenAsTheConfigSays) {
  ASSERT_EQ(program(small_study({"--quiet", "--set", "sampler.sources=[\"proc_stat\",\"psi\"]",
                                 "--set", "sampler.periods_ms={\"proc_stat\":100}"}))
                .code,
            0);
  for (const Channel& channel : read_run(out()).channels)
    if (channel.source == "proc_stat") {
      EXPECT_NEAR(static_cast<double>(channel.period_ns), 1e8, 1e6) << channel.name;
    }
}

TEST_F(Tracing, TheConfigsCachesAreModelled) {
  const Output output = program(small_study(
      {"--set",
       R"(cache_model={"l1_kib":4,"l1_ways":4,"llc_kib":64,"llc_ways":8,"line_bytes":128})",
       "--set", "views=[0]"}));
  ASSERT_EQ(output.code, 0) << output.err;
  const json model = json::parse(read_run(out()).trials.at(0).cache_model);
  EXPECT_EQ(model["l1"],
            (json{{"size_bytes", 4096}, {"ways", 4}, {"line_bytes", 128}, {"source", "config"}}));
  EXPECT_EQ(model["llc"]["size_bytes"], 65536);
  EXPECT_THAT(read_text(out() / "report.md"),
              HasSubstr("4 KiB (4 ways, lines of 128 bytes, from the config)"));
}

TEST_F(Tracing, QuietMeansNothingOnStderr) {
  EXPECT_THAT(program(small_study({"--quiet"})).err, IsEmpty());
}

TEST_F(Tracing, QuickSaysSoInEveryOutput) {
  const Output output = program(small_study({"--quick", "--set", "frames.timed=99"}));
  ASSERT_EQ(output.code, 0) << output.err;
  EXPECT_THAT(output.out, HasSubstr("QUICK: "));
  EXPECT_THAT(output.out, HasSubstr("timed frames 16 instead of 99"));
  EXPECT_THAT(read_text(out() / "report.md"), HasSubstr("timed frames 16 instead of 99"));
  EXPECT_THAT(read_text(out() / "report.html"), HasSubstr("timed frames 16 instead of 99"));
  EXPECT_EQ(read_json(out() / "report.json")["run"]["quick"], true);
}

TEST_F(Tracing, AFixtureMachineIsMarkedSimulated) {
  const std::string root = ENERGYPROF_TEST_DATA "/sysfs/intel-rplp-i915-laptop";
  const Output output = program(small_study({"--root", root}));
  ASSERT_EQ(output.code, 0) << output.err;
  EXPECT_THAT(output.out, HasSubstr("SIMULATED"));
  EXPECT_THAT(read_text(out() / "report.md"), HasSubstr("SIMULATED"));
  EXPECT_THAT(read_text(out() / "timeline.json"), HasSubstr("SIMULATED"));
  const RunRecord run = read_run(out());
  EXPECT_EQ(run.meta.at("simulated"), "1");
  const auto energy = std::find_if(run.channels.begin(), run.channels.end(), [](const Channel& c) {
    return c.name == "rapl.package-0.energy";
  });
  ASSERT_NE(energy, run.channels.end());
  EXPECT_TRUE(run.series.contains(energy->id));
}

TEST_F(Tracing, TheReportOpensInABrowserWithoutAnError) {
  if (test::run({"chromium", "--version"}).code != 0) GTEST_SKIP() << "chromium is not installed";
  ASSERT_EQ(program(small_study({"--quiet"})).code, 0);
  const Output page = test::run({"timeout", "60", "chromium", "--headless", "--no-sandbox",
                                 "--disable-gpu", "--disable-quic", "--no-first-run",
                                 "--disable-background-networking", "--disable-component-update",
                                 "--disable-sync", "--user-data-dir=" + (dir_ / "browser").string(),
                                 "--enable-logging=stderr", "--virtual-time-budget=5000",
                                 "--dump-dom", "file://" + (out() / "report.html").string()});
  ASSERT_EQ(page.code, 0) << page.err;
  // The browser's own pages may complain too, of a missing network for example.
  std::istringstream log(page.err);
  for (std::string line; std::getline(log, line);)
    EXPECT_FALSE(line.find("CONSOLE") != std::string::npos &&
                 line.find("source: file:") != std::string::npos)
        << line;
  EXPECT_THAT(page.out, HasSubstr("<canvas"));  // the charts were drawn
  EXPECT_THAT(page.out, HasSubstr("BVH_FTB_DF"));
}

TEST_F(Tracing, AnalyzeGivesTheSameNumbersAgain) {
  ASSERT_EQ(program(small_study({"--quiet"})).code, 0);
  const std::string before = read_text(out() / "report.json");
  fs::remove(out() / "report.json");
  ASSERT_EQ(program({"analyze", out().string()}).code, 0);
  EXPECT_EQ(read_text(out() / "report.json"), before);
  ASSERT_EQ(program({"analyze", (out() / "run.sqlite").string()}).code, 0);
  EXPECT_EQ(read_text(out() / "report.json"), before);
}

TEST_F(Tracing, ComparesTwoRuns) {
  const Arguments study = small_study({"--quiet", "--set", "frames.timed=12"});
  ASSERT_EQ(program(study).code, 0);
  const std::string run = out().string();
  const Output same = program({"compare", run, run, "--json", "--fail-if-slower", "0"});
  EXPECT_EQ(same.code, 0) << same.err;
  const json report = json::parse(same.out);
  ASSERT_FALSE(report.at("cells").empty());
  EXPECT_EQ(report.at("cells").at(0).at("time_ratio").at("value"), 1);
  EXPECT_FALSE(report.at("fail_if_slower").at("slower"));
  EXPECT_THAT(program({"compare", run, run}).out, HasSubstr("No difference in"));

  // Every frame of a copy takes three times as long; what the clock did is forgotten.
  const fs::path slower = out() / "slower.sqlite";
  {
    const RunRecord record = read_run(run);
    RunWriter writer(slower);
    for (const Trial& trial : record.trials) writer.put_trial(trial);
    for (FrameRecord frame : record.frames) {
      frame.end_ns += 2 * (frame.end_ns - frame.begin_ns);
      writer.add_frame(frame);
    }
    writer.close();
  }
  const Output failed = program({"compare", run, slower.string(), "--fail-if-slower", "50"});
  EXPECT_EQ(failed.code, 3);
  EXPECT_THAT(failed.out, HasSubstr("in time, as the clock is not known throughout"));
  EXPECT_EQ(program({"compare", run, slower.string()}).code, 0);
  EXPECT_EQ(program({"compare", slower.string(), run, "--fail-if-slower", "50"}).code, 0);
  EXPECT_EQ(program({"compare", run}).code, 2);
  EXPECT_EQ(program({"compare", run, "/nowhere"}).code, 1);
}

TEST_F(Tracing, ExportsCsvAndTimeline) {
  ASSERT_EQ(program(small_study({"--quiet"})).code, 0);
  ASSERT_EQ(
      program({"export", out().string(), "--format", "csv", "--out", (dir_ / "csv").string()}).code,
      0);
  const std::string frames = read_text(dir_ / "csv/frames.csv");
  EXPECT_EQ(std::count(frames.begin(), frames.end(), '\n'), 1 + 30);
  EXPECT_GT(fs::file_size(dir_ / "csv/samples.csv"), 100u);
  EXPECT_THAT(read_text(dir_ / "csv/meta.csv"), HasSubstr("\nsimulated,0\r\n"));
  const std::string timeline = (dir_ / "t.json").string();
  ASSERT_EQ(
      program({"export", out().string(), "--format", "timeline", "--full", "--out", timeline}).code,
      0);
  EXPECT_FALSE(read_json(timeline)["traceEvents"].empty());
}

TEST_F(Tracing, PaceSpreadsTheFrames) {
  ASSERT_EQ(
      program(small_study({"--quiet", "--set", "frames.pace=fps:50", "--set", "views=[0]"})).code,
      0);
  const RunRecord run = read_run(out());
  ASSERT_EQ(run.frames.size(), 10u);
  // Nine gaps of 20 ms: no frame may come early, so at least 170 ms pass.
  EXPECT_GE(run.frames.back().submit_ns - run.frames.front().submit_ns, 170'000'000);
}

TEST_F(Tracing, ViewsOfTheConfigAreCountedBehindTheModelsOwn) {
  const Output output = program(small_study(
      {"--set",
       R"(views=[1,{"phi":0,"theta":0,"distance":9},{"phi":1.5,"theta":3,"distance":8,"target":[0,1,0]}])"}));
  ASSERT_EQ(output.code, 0) << output.err;  // straight down is a view like any other
  std::vector<int64_t> views;
  for (const Trial& trial : read_run(out()).trials) views.push_back(trial.view);
  EXPECT_THAT(views, testing::UnorderedElementsAre(1, 3, 4));
}

TEST_F(Tracing, TwoFilesOfOneNameAreTwoModels) {
  const std::string obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
  fs::create_directory(dir_ / "a");
  fs::create_directory(dir_ / "b");
  const std::string a = write("a/m.obj", obj);
  const std::string b = write("b/m.obj", obj + "v 0 0 1\nf 1 2 4\n");
  const Output output = program(
      small_study({"--set", R"(models=[")" + a + R"(",")" + b + R"("])", "--set", "views=[0]"}));
  ASSERT_EQ(output.code, 0) << output.err;
  const json report = read_json(out() / "report.json");
  ASSERT_EQ(report["cells"].size(), 2u);
  EXPECT_NE(report["cells"][0]["model"], report["cells"][1]["model"]);
}

// ---------------------------------------------------------------------------- the end of a run

/// Waits until the program's stderr says `text`.
void wait_for(const Process& process, const std::string& text) {
  for (int i = 0; i < 600; ++i) {
    if (process.err_so_far().find(text) != std::string::npos) return;
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
  FAIL() << "never said: " << text;
}

TEST_F(Tracing, CtrlCEndsAnIdlePeriodAtOnce) {
  Process process(command(small_study({"--set", "idle.before_s=600"})), environment());
  for (int i = 0; i < 200 && !fs::exists(out() / "run.sqlite"); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  std::this_thread::sleep_for(std::chrono::milliseconds(500));
  process.send(SIGINT);
  EXPECT_EQ(process.wait().code, 130);
  const RunRecord run = read_run(out());
  EXPECT_TRUE(run.frames.empty());
  EXPECT_TRUE(std::any_of(run.events.begin(), run.events.end(),
                          [](const Event& event) { return event.kind == "idle"; }));
}

class Ending : public Tracing {
 protected:
  /// A study of 300 trials: it will not end by itself in time.
  [[nodiscard]] Arguments long_study() const {
    return command(small_study({"--set", "order.repetitions=100", "--set", "frames.timed=50"}));
  }
};

TEST_F(Ending, CtrlCKeepsAndAnalysesWhatWasMeasured) {
  Process process(long_study(), environment());
  wait_for(process, "[2/300]");
  process.send(SIGINT);
  const Output output = process.wait();
  EXPECT_EQ(output.code, 130) << output.err;
  EXPECT_THAT(output.out, HasSubstr("INTERRUPTED"));
  const RunRecord run = read_run(out());
  EXPECT_EQ(run.meta.at("interrupted"), "1");
  EXPECT_GE(run.trials.size(), 2u);
  EXPECT_TRUE(fs::exists(out() / "report.html"));
}

TEST_F(Ending, CtrlCTwiceEndsAtOnce) {
  Arguments arguments = small_study({"--set", "image={\"width\":2300,\"height\":2300}"});
  Process process(command(arguments), environment({{"ENERGYPROF_VALIDATION", "0"}}));
  for (int i = 0; i < 200 && !fs::exists(out() / "run.sqlite"); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  std::this_thread::sleep_for(std::chrono::seconds(1));  // now inside a frame of several seconds
  // Signals that arrive together are one: on a busy machine two may not be enough.
  for (int i = 0; i < 5; ++i) {
    process.send(SIGINT);
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  EXPECT_EQ(process.wait().code, 130);
  EXPECT_FALSE(fs::exists(out() / "report.html"));
  EXPECT_EQ(program({"analyze", out().string()}).code, 0);
}

TEST_F(Ending, KilledRunOpensAndCanBeAnalysed) {
  Process process(long_study(), environment());
  wait_for(process, "[4/300]");
  process.send(SIGKILL);
  EXPECT_EQ(process.wait().code, 128 + SIGKILL);
  const RunRecord run = read_run(out());
  EXPECT_FALSE(run.frames.empty());
  EXPECT_FALSE(run.series.empty());
  EXPECT_FALSE(run.meta.contains("end_ns"));
  const Output output = program({"analyze", out().string()});
  EXPECT_EQ(output.code, 0) << output.err;
  EXPECT_TRUE(fs::exists(out() / "report.html"));
}

TEST_F(Ending, FullDiskIsOneLineAndKeepsWhatWasRecorded) {
  // A 1 MiB disk in a mount namespace of its own; the run directory is looked at from inside.
  const std::string script =
      "mount -t tmpfs -o size=1m none \"$1\" || exit 99; shift\n"
      "\"$@\"; code=$?\n"
      "sqlite3 \"$RUN/run.sqlite\" 'select count(*) > 0 from samples' >&2; exit $code";
  fs::create_directory(dir_ / "disk");
  Arguments study = command({"--config", config_, "--out", (dir_ / "disk/run").string(), "--quiet",
                             "--set", "order.repetitions=1000", "--set", "sampler.rate_hz=5000"});
  Arguments all{"unshare", "--map-root-user",       "--mount", "bash", "-c", script,
                "bash",    (dir_ / "disk").string()};
  all.insert(all.end(), study.begin(), study.end());
  const Output output = test::run(all, environment({{"RUN", (dir_ / "disk/run").string()}}));
  if (output.code == 99 || output.err.find("unshare") != std::string::npos)
    GTEST_SKIP() << "cannot mount a small disk here: " << output.err;
  EXPECT_EQ(output.code, 1);
  EXPECT_THAT(output.err,
              HasSubstr("energyprof: cannot record to '" + (dir_ / "disk/run/run.sqlite").string() +
                        "': database or disk is full."));
  EXPECT_THAT(output.err, HasSubstr("What was recorded until then is readable."));
  EXPECT_THAT(output.err, HasSubstr("\n1\n"));
}

TEST_F(Tracing, APictureThatCannotBeWrittenCostsAnEventOnly) {
  Process process(command(small_study({"--set", "frames.timed=200"})), environment());
  for (int i = 0; i < 200 && !fs::exists(out() / "run.sqlite"); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  fs::remove_all(out() / "images");
  std::ofstream(out() / "images") << "in the way";
  const Output output = process.wait();
  EXPECT_EQ(output.code, 0) << output.err;
  const RunRecord run = read_run(out());
  for (const Trial& trial : run.trials) EXPECT_EQ(trial.skip_reason, "");
  EXPECT_TRUE(std::any_of(run.events.begin(), run.events.end(),
                          [](const Event& event) { return event.kind == "image"; }));
}

// ---------------------------------------------------------------------------- what can be sensed

size_t columns_of(const std::string& line) {
  return static_cast<size_t>(
      std::count_if(line.begin(), line.end(), [](char c) { return (c & 0xC0) != 0x80; }));
}

TEST_F(Program, ProbeFitsAPageAndFoldsCores) {
  for (const auto& machine : fs::directory_iterator(ENERGYPROF_TEST_DATA "/sysfs")) {
    if (!machine.is_directory()) continue;
    SCOPED_TRACE(machine.path());
    const Output output = program({"probe", "--root", machine.path().string()});
    ASSERT_EQ(output.code, 0);
    std::istringstream table(output.out.substr(0, output.out.find("\nnot seen")));
    for (std::string line; std::getline(table, line);) EXPECT_LE(columns_of(line), 120u) << line;
  }
  const std::string laptop = ENERGYPROF_TEST_DATA "/sysfs/intel-rplp-i915-laptop";
  EXPECT_THAT(program({"probe", "--root", laptop}).out,
              HasSubstr("hwmon.coretemp.core_*.temp (14)"));
  EXPECT_THAT(program({"probe", "--all", "--root", laptop}).out,
              HasSubstr("hwmon.coretemp.core_27.temp"));
}

TEST_F(Program, ProbeSaysWhichReadsWakeAGpu) {
  const auto probe = [&](const std::string& machine) {
    return program({"probe", "--root", ENERGYPROF_TEST_DATA "/sysfs/" + machine}).out;
  };
  EXPECT_THAT(probe("intel-rplp-i915-laptop"),
              HasSubstr("10 channels of i915 of 0000:00:02.0: to read them may wake that GPU"));
  EXPECT_THAT(probe("vm-no-sensors"), Not(HasSubstr("wake")));
}

TEST_F(Program, ProbeFoldsNoTwoDevicesIntoOneLine) {
  const fs::path root = out() / "tree";
  for (const std::string chip : {"0", "1"}) {
    const fs::path device = root / "sys/devices" / ("coretemp." + chip);
    const fs::path files = device / "hwmon" / ("hwmon" + chip);
    fs::create_directories(files);
    std::ofstream(files / "name") << "coretemp\n";
    for (int i = 1; i <= 4; ++i)
      std::ofstream(files / ("temp" + std::to_string(i) + "_input")) << "50000\n";
    fs::create_directories(root / "sys/class/hwmon");
    fs::create_directory_symlink("../../devices/coretemp." + chip + "/hwmon/hwmon" + chip,
                                 root / "sys/class/hwmon" / ("hwmon" + chip));
  }
  EXPECT_THAT(program({"probe", "--root", root.string()}).out,
              AllOf(HasSubstr("hwmon.coretemp@coretemp_0.temp*.temp (4)"),
                    HasSubstr("hwmon.coretemp@coretemp_1.temp*.temp (4)")));
}

// ---------------------------------------------------------------------------- failing devices

Environment fault(const std::string& what) {
  return {{"VK_ADD_LAYER_PATH", ENERGYPROF_FAULT_LAYER_DIR},
          {"VK_INSTANCE_LAYERS", "VK_LAYER_ENERGYPROF_fault"},
          {"EP_FAULT", what},
          {"ENERGYPROF_VALIDATION", "0"}};
}

TEST_F(Tracing, ALostDeviceCostsOneTrial) {
  const Output output = program(small_study(), fault("device-lost:8"));
  ASSERT_EQ(output.code, 0) << output.err;
  const RunRecord run = read_run(out());
  ASSERT_EQ(run.trials.size(), 3u);
  EXPECT_THAT(run.trials[0].skip_reason, HasSubstr("VK_ERROR_DEVICE_LOST"));
  EXPECT_EQ(run.trials[1].skip_reason, "");
  EXPECT_EQ(run.trials[2].skip_reason, "");
  EXPECT_THAT(output.err, HasSubstr("skipped: "));
  EXPECT_EQ(read_json(out() / "report.json")["cells"].size(), 2u);
}

TEST_F(Tracing, OutOfMemoryCostsOneTrial) {
  const Output output = program(small_study(), fault("out-of-memory:1"));
  ASSERT_EQ(output.code, 0) << output.err;
  const RunRecord run = read_run(out());
  ASSERT_EQ(run.trials.size(), 3u);
  EXPECT_THAT(run.trials[0].skip_reason, HasSubstr("memory"));
  EXPECT_EQ(run.trials[1].skip_reason, "");
}

TEST_F(Tracing, WithoutCalibratedTimestampsTheMetaSaysSo) {
  ASSERT_EQ(program(small_study({"--quiet"}), fault("no-calibrated")).code, 0);
  const RunRecord run = read_run(out());
  EXPECT_THAT(run.meta.at("clock_method"), HasSubstr("calibrated_timestamps"));
  for (const FrameRecord& frame : run.frames) {
    ASSERT_TRUE(frame.clock_error_ns);
    EXPECT_GT(*frame.clock_error_ns, 0);
  }
}

TEST_F(Tracing, TheGpusOwnCountersHaveASampleForEachTrial) {
  const Output output = program(small_study(), fault("counters:2"));
  ASSERT_EQ(output.code, 0) << output.err;
  const RunRecord run = read_run(out());
  const auto misses = std::find_if(run.channels.begin(), run.channels.end(),
                                   [](const Channel& c) { return c.name == "vkperf.l3_misses"; });
  ASSERT_NE(misses, run.channels.end());
  EXPECT_EQ(misses->source, "vkperf");
  EXPECT_EQ(misses->quantity, Quantity::cache_miss);
  const SampleSeries& series = run.series.at(misses->id);
  ASSERT_EQ(series.t_ns.size(), run.trials.size());
  std::vector<const Event*> spans;
  for (const Event& event : run.events)
    if (event.kind == "performance-query") spans.push_back(&event);
  ASSERT_EQ(spans.size(), run.trials.size());
  for (size_t i = 0; i < spans.size(); ++i) {
    EXPECT_EQ(series.value[i], 4e9);
    EXPECT_EQ(series.t_ns[i], spans[i]->end_ns);
    EXPECT_GE(spans[i]->t_ns, run.trials[i].end_ns);  // no timed frame has anything of it
  }
}

TEST_F(Tracing, CountersInUseElsewhereCostAnEventOnly) {
  ASSERT_EQ(program(small_study(), fault("counters:1,counters-busy")).code, 0);
  const RunRecord run = read_run(out());
  for (const Trial& trial : run.trials) EXPECT_EQ(trial.skip_reason, "");
  EXPECT_TRUE(std::any_of(run.events.begin(), run.events.end(), [](const Event& event) {
    return event.kind == "performance-query" && event.severity == Severity::warning;
  }));
}

TEST_F(Tracing, ABufferTooLargeForTheDeviceIsRefusedByNumber) {
  const Output output = program(small_study({"--set", "models.0=teapot:40"}), fault("small-range"));
  EXPECT_EQ(output.code, 1);
  EXPECT_THAT(output.err,
              HasSubstr("energyprof: no trial could be traced: no Vulkan device fits: "));
  EXPECT_THAT(output.err,
              EndsWith("maxStorageBufferRange is 1 MiB, the node buffer needs 6.24 MiB.\n"));
}

TEST_F(Program, NoDeviceIsOneLine) {
  const Output output = program(small_study(), {{"VK_DRIVER_FILES", "/nonexistent.json"}});
  EXPECT_EQ(output.code, 1);
  EXPECT_EQ(
      output.err,
      "energyprof: cannot use Vulkan: no driver was found (VK_ERROR_INCOMPATIBLE_DRIVER). Install "
      "a driver (mesa-vulkan-drivers has one that runs on the CPU), and unset VK_DRIVER_FILES "
      "and VK_ICD_FILENAMES if they name a file that does not exist.\n");
  EXPECT_FALSE(fs::exists(out()));
}

TEST_F(Program, NoLoaderIsOneLine) {
  fs::create_directory(dir_ / "lib");
  std::ofstream(dir_ / "lib/libvulkan.so.1") << "";  // found first, and no library
  const Output output = program(small_study(), {{"LD_LIBRARY_PATH", (dir_ / "lib").string()}});
  EXPECT_EQ(output.code, 1);
  EXPECT_EQ(output.err, "energyprof: cannot load the Vulkan loader 'libvulkan.so.1': " +
                            (dir_ / "lib/libvulkan.so.1").string() +
                            ": file too short. Install libvulkan1, and a driver such as "
                            "mesa-vulkan-drivers.\n");
  EXPECT_EQ(program({"probe"}, {{"LD_LIBRARY_PATH", (dir_ / "lib").string()}}).code, 0);
}

TEST_F(Tracing, AnUnknownDeviceNameListsWhatThereIs) {
  const Output output = program(small_study({"--device", "Voodoo 2"}));
  EXPECT_EQ(output.code, 1);
  EXPECT_THAT(output.err, HasSubstr("energyprof: no Vulkan device fits: "));
  EXPECT_THAT(output.err, HasSubstr("name does not contain 'Voodoo 2'"));
}

// ---------------------------------------------------------------------------- bad input

struct BadMesh {
  const char* name;
  const char* extension;
  std::string content;
  const char* line;  ///< after "energyprof: cannot read mesh 'FILE': "
};
void PrintTo(const BadMesh& bad, std::ostream* out) { *out << bad.name; }

const std::string ply_head =
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float "
    "z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n";

class BadMeshes : public Program, public testing::WithParamInterface<BadMesh> {};

TEST_P(BadMeshes, AreOneLineThatNamesThePlace) {
  const BadMesh& bad = GetParam();
  const std::string file = write(std::string("bad") + bad.extension, bad.content);
  const Output output = program(small_study({"--set", "models.0=" + file}));
  EXPECT_EQ(output.code, 1);
  EXPECT_EQ(output.err, "energyprof: cannot read mesh '" + file + "': " + bad.line + "\n");
  EXPECT_FALSE(fs::exists(out()));
}

INSTANTIATE_TEST_SUITE_P(
    Program, BadMeshes,
    testing::Values(
        BadMesh{"empty", ".ply", "", "it is empty."},
        BadMesh{"garbage", ".ply", "\x01\x02\xff\xfe garbage",
                "line 1: a PLY file begins with 'ply', not with '\\x01\\x02\\xff\\xfe garbage'."},
        BadMesh{
            "truncated", ".ply", ply_head + "0 0 0\n1 0 0\n",
            "its header promises 3 'vertex' elements, of 6 bytes or more each, and 13 bytes are "
            "left; the file is cut off or its header is wrong."},
        BadMesh{
            "huge_count", ".ply",
            "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\n"
            "property float y\nproperty float z\nend_header\n",
            "line 3: 4000000000 vertex elements are too many; at most 2147483646 fit."},
        BadMesh{
            "nan", ".ply", ply_head + "0 0 0\n1 nan 0\n0 1 0\n3 0 1 2\n",
            "line 11: element 'vertex', 1 of 3: 'nan' is not a coordinate: it must be finite and "
            "no larger than 3.4e38."},
        BadMesh{
            "index", ".ply", ply_head + "0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n",
            "line 13: element 'face', 0 of 1: there is no vertex 3; the file has 3, counted from "
            "0."},
        BadMesh{"obj_index", ".obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n",
                "line 4: there is no vertex 4; the file has 3, counted from 1."}),
    [](const auto& test) { return test.param.name; });

struct BadConfig {
  const char* name;
  Arguments arguments;
  const char* line;  ///< after "energyprof: "; CONFIG stands for the file
};
void PrintTo(const BadConfig& bad, std::ostream* out) { *out << bad.name; }

class BadConfigs : public Program, public testing::WithParamInterface<BadConfig> {};

TEST_P(BadConfigs, AreOneExactLineAndExitTwo) {
  std::string line = GetParam().line;
  if (const size_t at = line.find("CONFIG"); at != std::string::npos) line.replace(at, 6, config_);
  const Output output = program(small_study(GetParam().arguments));
  EXPECT_EQ(output.err, "energyprof: " + line + "\n");
  EXPECT_EQ(output.code, 2);
  EXPECT_THAT(output.out, IsEmpty());
  EXPECT_FALSE(fs::exists(out()));
}

INSTANTIATE_TEST_SUITE_P(
    Program, BadConfigs,
    testing::Values(
        BadConfig{"unknown_key",
                  {"--set", "image.widht=7"},
                  "CONFIG: /image: unknown key 'widht'; expected height, width"},
        BadConfig{"unknown_top_key",
                  {"--set", "modles=[]"},
                  "CONFIG: /: unknown key 'modles'; expected algorithms, analysis, bounces, "
                  "cache_model, cooldown, frames, idle, image, models, name, order, question, "
                  "sampler, structure_cache, structures, views"},
        BadConfig{
            "wrong_type",
            {"--set", "image.width=big"},
            "CONFIG: /image/width: \"big\" is not allowed; expected an integer from 1 to 16384"},
        BadConfig{"out_of_range",
                  {"--set", "image.height=0"},
                  "CONFIG: /image/height: 0 is not allowed; expected an integer from 1 to 16384"},
        BadConfig{"unknown_algorithm",
                  {"--set", "algorithms.0=BHV"},
                  "CONFIG: /algorithms/0: \"BHV\" is not allowed; expected BVH_FTB_DF, BVH_FTB_BF, "
                  "BVH_STACKLESS_DF, KD_TREE, KD_STACK, GRID"},
        BadConfig{"preset",
                  {"--set", "structures.bvh.preset=best"},
                  "CONFIG: /structures/bvh/preset: \"best\" is not allowed; expected paper, tuned"},
        BadConfig{"lambda",
                  {"--set", "structures.grid.lambda=64.5"},
                  "CONFIG: /structures/grid/lambda: 64.5 is not allowed; expected a number above "
                  "0, up to 64: cells per triangle"},
        BadConfig{"unknown_parameter",
                  {"--set", "structures.grid.cells=7"},
                  "CONFIG: /structures/grid: unknown key 'cells'; expected exact_overlap, lambda, "
                  "preset"},
        BadConfig{"cache_line",
                  {"--set", "cache_model.line_bytes=48"},
                  "CONFIG: /cache_model/line_bytes: 48 is not allowed; expected 32, 64, 128, 256"},
        BadConfig{"view_7",
                  {"--set", "views=[7]"},
                  "CONFIG: /views/0: 7 is not allowed; expected a view number 0, 1 or 2, or an "
                  "object {phi, theta, distance, target}"},
        BadConfig{"view_without_theta",
                  {"--set", "views=[{\"phi\":1,\"distance\":2}]"},
                  "CONFIG: /views/0: key 'theta' is missing"},
        BadConfig{"unknown_model",
                  {"--set", "models.0=dragoon"},
                  "CONFIG: /models/0: 'dragoon' is not a model; expected teapot, bunny, dragon, "
                  "teapot:N (N from 1 to 256) or a path to .ply, .ply.gz or .obj"},
        BadConfig{"teapot_of_none",
                  {"--set", "models.0=teapot:0"},
                  "CONFIG: /models/0: 'teapot:0' is not a model; expected teapot, bunny, dragon, "
                  "teapot:N (N from 1 to 256) or a path to .ply, .ply.gz or .obj"},
        BadConfig{
            "unknown_source",
            {"--set", "sampler.sources=[\"rapl\"]"},
            "CONFIG: /sampler/sources/0: 'rapl' is not a source; expected perf_rapl, "
            "powercap, msr, i915, i915_pmu, xe, xe_pmu, amdgpu, nvml, hwmon, thermal, cpufreq, "
            "thermal_throttle, devfreq, v3d, raspberrypi, battery, proc_stat, psi, cgroup, "
            "schedstat, perf, "
            "uncore"},
        BadConfig{"period_of_an_unknown_source",
                  {"--set", "sampler.periods_ms={\"rapl\":10}"},
                  "CONFIG: /sampler/periods_ms: 'rapl' is not a source; expected perf_rapl, "
                  "powercap, msr, i915, i915_pmu, xe, xe_pmu, amdgpu, nvml, hwmon, thermal, "
                  "cpufreq, thermal_throttle, devfreq, v3d, raspberrypi, battery, proc_stat, psi, "
                  "cgroup, schedstat, perf, uncore"},
        BadConfig{"period_of_nothing",
                  {"--set", "sampler.periods_ms.hwmon=0"},
                  "CONFIG: /sampler/periods_ms/hwmon: 0 is not allowed; expected a number from 0.1 "
                  "to 3600000: milliseconds from poll to poll"},
        BadConfig{"self_check_of_words",
                  {"--set", "sampler.self_check=maybe"},
                  "CONFIG: /sampler/self_check: \"maybe\" is not allowed; expected a boolean"},
        BadConfig{"no_models",
                  {"--set", "models=[]"},
                  "CONFIG: /models: [] is not allowed; expected a list of different models"},
        BadConfig{"pace",
                  {"--set", "frames.pace=fast"},
                  "CONFIG: /frames/pace: \"fast\" is not allowed; expected \"back-to-back\" or "
                  "\"fps:N\", frames per second"},
        BadConfig{"pace_zero",
                  {"--set", "frames.pace=fps:0"},
                  "CONFIG: /frames/pace: \"fps:0\" is not allowed; expected more than 0 frames per "
                  "second"},
        BadConfig{"setting_without_value",
                  {"--set", "image"},
                  "--set 'image': expected key.path=value, as in --set image.width=640"},
        BadConfig{"setting_of_no_index",
                  {"--set", "models.5=teapot"},
                  "--set 'models.5=teapot': '5' is not an index below 1"}),
    [](const auto& test) { return test.param.name; });

TEST_F(Program, BadJsonNamesLineAndColumn) {
  const std::string file = write("broken.json", "{\n  \"models\": [\"teapot\",\n}\n");
  const Output output = program({"--config", file});
  EXPECT_EQ(output.code, 2);
  EXPECT_THAT(output.err, HasSubstr(file + ": not JSON: parse error at line 3, column 1"));
  const std::string list = write("list.json", "[]");
  EXPECT_EQ(program({"--config", list}).err,
            "energyprof: " + list +
                ": /: [] is not allowed; expected an object with the keys models, "
                "algorithms and more: what to trace, how often, what to record\n");
  const std::string huge = write("huge.json", R"({"bounces": 1e400})");
  EXPECT_EQ(program({"--config", huge}).err,
            "energyprof: " + huge + ": not JSON: number overflow parsing '1e400'\n");
  const std::string twice = write("twice.json", R"({"models": ["teapot"], "models": ["bunny"]})");
  EXPECT_EQ(program({"--config", twice}).err,
            "energyprof: " + twice + ": key 'models' is given twice\n");
}

TEST_F(Program, MissingFilesAreNamed) {
  EXPECT_EQ(
      program({"--config", "/nowhere/x.json"}).err,
      "energyprof: cannot read config '/nowhere/x.json': there is no such file, and no shipped "
      "config of that name.\n");
  const Output mesh = program(small_study({"--set", "models.0=/nowhere/x.ply"}));
  EXPECT_EQ(mesh.code, 1);
  EXPECT_EQ(mesh.err, "energyprof: cannot read '/nowhere/x.ply': No such file or directory.\n");
  EXPECT_EQ(
      program({"analyze", "/nowhere"}).err,
      "energyprof: cannot read run '/nowhere': there is no such file. Give a run directory or "
      "the run.sqlite inside it.\n");
}

TEST_F(Program, UnwritableOutIsNamed) {
  const std::string file = write("a_file", "x");
  const Output output = program({"--config", config_, "--out", file + "/run"});
  EXPECT_EQ(output.code, 1);
  EXPECT_EQ(output.err, "energyprof: cannot create run directory '" + file +
                            "/run': Not a directory. Give another with --out.\n");
}

TEST_F(Program, AnotherRunIsNeverOverwritten) {
  fs::create_directory(out());
  std::ofstream(out() / "run.sqlite") << "precious";
  const Output output = program(small_study());
  EXPECT_EQ(output.code, 1);
  EXPECT_EQ(output.err,
            "energyprof: cannot record to '" + out().string() +
                "': it already holds 'run.sqlite', and a run is never overwritten. Give "
                "another directory with --out.\n");
  EXPECT_EQ(read_text(out() / "run.sqlite"), "precious");
}

TEST_F(Program, ARequiredQuantityThatIsMissingRefusesTheRun) {
  const std::string root = ENERGYPROF_TEST_DATA "/sysfs/vm-no-sensors";
  const Output output =
      program(small_study({"--root", root, "--set", "sampler.require=[\"energy\"]"}));
  EXPECT_EQ(output.code, 1);
  EXPECT_THAT(output.err, HasSubstr("cannot run '" + config_ + "': it requires energy"));
}

// ---------------------------------------------------------------------------- other commands

TEST_F(Program, EveryCommandHasHelpWithAnExample) {
  for (const Arguments& arguments : {Arguments{"--help"},
                                     {"probe", "--help"},
                                     {"analyze", "--help"},
                                     {"export", "--help"},
                                     {"compare", "--help"},
                                     {"models", "--help"},
                                     {"models", "fetch", "--help"}}) {
    const Output output = program(arguments);
    EXPECT_EQ(output.code, 0);
    EXPECT_THAT(output.out, HasSubstr("Example: energyprof ")) << arguments.front();
  }
  EXPECT_THAT(program({"--version"}).out, HasSubstr("energyprof "));
}

TEST_F(Program, WrongUsageIsExitTwo) {
  EXPECT_EQ(program({}).code, 2);
  EXPECT_EQ(program({"--bogus"}).code, 2);
  EXPECT_EQ(program({"export", "x", "--format", "pdf"}).code, 2);
  EXPECT_EQ(program({"models", "fetch", "suzanne"}).err,
            "energyprof: models fetch: 'suzanne' is not a model; expected teapot, bunny, dragon\n");
}

TEST_F(Program, ProbeJsonHasTheContractsFields) {
  const Output output =
      program({"probe", "--json", "--root", ENERGYPROF_TEST_DATA "/sysfs/intel-rplp-i915-laptop"});
  ASSERT_EQ(output.code, 0) << output.err;
  const json probe = json::parse(output.out);
  EXPECT_TRUE(probe["verdict"].is_string());
  ASSERT_FALSE(probe["channels"].empty());
  for (const json& channel : probe["channels"])
    for (const char* key : {"name", "source", "quantity", "unit", "kind", "value", "period_ns",
                            "read_cost_ns", "origin"})
      EXPECT_TRUE(channel.contains(key)) << channel;
  const auto package =
      std::find_if(probe["channels"].begin(), probe["channels"].end(),
                   [](const json& channel) { return channel["name"] == "rapl.package-0.energy"; });
  ASSERT_NE(package, probe["channels"].end());
  EXPECT_EQ((*package)["wrap_at"], 262'143'328'850);
  for (const json& missing : probe["missing"])
    for (const char* key : {"source", "reason", "fix"})
      EXPECT_TRUE(missing.contains(key)) << missing;
  EXPECT_EQ(json::parse(program({"probe", "--json"}).out)["simulated"], false);
}

TEST_F(Program, ProbeOfATreeSaysThatItIsNotThisMachine) {
  const std::string root = ENERGYPROF_TEST_DATA "/sysfs/intel-rplp-i915-laptop";
  EXPECT_TRUE(program({"probe", "--root", root}).out.starts_with("Simulated: what '"));
  const json probe = json::parse(program({"probe", "--json", "--root", root}).out);
  EXPECT_EQ(probe["simulated"], true);
  EXPECT_EQ(fs::path(probe["root"].get<std::string>()), fs::canonical(root));
  EXPECT_TRUE(probe["devices"].empty());  // they would be this machine's
  EXPECT_THAT(probe["no_devices_reason"].get<std::string>(), HasSubstr("not under --root"));
}

TEST_F(Program, ShippedConfigsAreFoundByName) {
  // From any directory: the program looks beside itself. The wrong device keeps it short.
  const Output output = program({"--config", "dragon.json", "--set", "algorithms=[]"});
  EXPECT_THAT(output.err, HasSubstr("dragon.json: /algorithms"));
}

}  // namespace
}  // namespace energyprof
