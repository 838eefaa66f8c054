// run.sqlite: what goes in comes out; kills, full disks, foreign and broken files.
#include "core/run_db.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sqlite3.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <fstream>
#include <thread>

#include "core/clock.h"

namespace energyprof {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

class RunDb : public testing::Test {
 protected:
  RunDb() {
    std::string pattern = (fs::temp_directory_path() / "energyprof_run_db_XXXXXX").string();
    dir_ = mkdtemp(pattern.data());
  }
  ~RunDb() override { fs::remove_all(dir_); }

  [[nodiscard]] fs::path file() const { return dir_ / "run.sqlite"; }

  void execute(const std::string& sql) const {
    sqlite3* db = nullptr;
    ASSERT_EQ(sqlite3_open(file().c_str(), &db), SQLITE_OK);
    char* why = nullptr;
    EXPECT_EQ(sqlite3_exec(db, sql.c_str(), nullptr, nullptr, &why), SQLITE_OK) << why;
    sqlite3_close(db);
  }

  [[nodiscard]] std::string read_error() const {
    try {
      read_run(dir_);
    } catch (const std::runtime_error& error) {
      return error.what();
    }
    return "no error";
  }

  fs::path dir_;
};

Channel example_channel() {
  Channel c;
  c.id = 1;
  c.name = "rapl.package-0.energy";
  c.source = "powercap";
  c.quantity = Quantity::energy;
  c.unit = Unit::microjoule;
  c.kind = Kind::cumulative;
  c.wrap_at = 262143328850;
  c.period_ns = 1'000'000;
  c.read_cost_ns = 700;
  c.origin = "/sys/class/powercap/intel-rapl:0/energy_uj";
  return c;
}

TEST_F(RunDb, WhatGoesInComesOut) {
  {
    RunWriter writer(file());
    writer.set_meta("config", "{}");
    writer.add_channel(example_channel());
    const Sample samples[] = {{1, 100, 262143328850}, {1, 200, 5}};
    writer.add_samples(samples);
    Trial trial;
    trial.id = 1;
    trial.model = "teapot";
    trial.view = 2;
    trial.algorithm = "BVH_FTB_DF";
    trial.begin_ns = 50;
    writer.put_trial(trial);
    trial.end_ns = 500;
    trial.skip_reason = "device lost";
    trial.sah_cost = 12.5;
    trial.ref_count = 31;
    trial.build_config = R"({"preset":"paper"})";
    trial.build_cached = true;
    trial.bytes_per_pixel = 640.5;
    trial.l1_misses_per_ray = 1.25;
    trial.llc_misses_per_ray = 0.0;  // known to be none
    trial.footprint_bytes = 4096;
    trial.cache_model = R"({"modelled":true})";
    writer.put_trial(trial);  // replaces
    FrameRecord frame;
    frame.id = 7;
    frame.trial_id = 1;
    frame.frame = 3;
    frame.phase = Phase::counted;
    frame.submit_ns = 99;
    frame.begin_ns = 100;
    frame.end_ns = 200;
    frame.ray_count = 4;
    frame.hit_checksum = "00ff00ff00ff00ff";
    frame.node_visit_count = 17;
    frame.loop_step_count = 19;
    frame.simd_efficiency = 0.75;
    writer.add_frame(frame);
    writer.add_event({150, std::nullopt, Severity::warning, "sensor-gone", 1, "went away"});
    writer.close();
  }
  EXPECT_FALSE(fs::exists(dir_ / "run.sqlite-wal"));
  const RunRecord run = read_run(dir_);
  EXPECT_EQ(run.meta.at("config"), "{}");
  EXPECT_EQ(run.meta.at("schema_version"), std::to_string(schema_version));
  ASSERT_EQ(run.channels.size(), 1u);
  EXPECT_EQ(run.channels[0].unit, Unit::microjoule);
  EXPECT_EQ(run.channels[0].unit_text, "uJ");
  EXPECT_EQ(run.channels[0].wrap_at, 262143328850);
  EXPECT_EQ(run.series.at(1).t_ns, (std::vector<int64_t>{100, 200}));
  EXPECT_EQ(run.series.at(1).value, (std::vector<double>{262143328850.0, 5.0}));
  ASSERT_EQ(run.trials.size(), 1u);
  EXPECT_EQ(run.trials[0].end_ns, 500);
  EXPECT_EQ(run.trials[0].skip_reason, "device lost");
  EXPECT_EQ(run.trials[0].sah_cost, 12.5);
  EXPECT_EQ(run.trials[0].build_ns, std::nullopt);
  EXPECT_EQ(run.trials[0].ref_count, 31);
  EXPECT_EQ(run.trials[0].build_config, R"({"preset":"paper"})");
  EXPECT_EQ(run.trials[0].build_cached, true);
  EXPECT_EQ(run.trials[0].bytes_per_pixel, 640.5);
  EXPECT_EQ(run.trials[0].l1_misses_per_ray, 1.25);
  EXPECT_EQ(run.trials[0].llc_misses_per_ray, 0.0);
  EXPECT_EQ(run.trials[0].footprint_bytes, 4096);
  EXPECT_EQ(run.trials[0].cache_model, R"({"modelled":true})");
  ASSERT_EQ(run.frames.size(), 1u);
  EXPECT_EQ(run.frames[0].phase, Phase::counted);
  EXPECT_EQ(run.frames[0].hit_checksum, "00ff00ff00ff00ff");
  EXPECT_EQ(run.frames[0].hit_count, std::nullopt);
  EXPECT_EQ(run.frames[0].node_visit_count, 17);
  EXPECT_EQ(run.frames[0].loop_step_count, 19);
  EXPECT_EQ(run.frames[0].simd_efficiency, 0.75);
  ASSERT_EQ(run.events.size(), 1u);
  EXPECT_EQ(run.events[0].channel_id, 1);
  EXPECT_EQ(run.events[0].severity, Severity::warning);
}

TEST_F(RunDb, WhatIsKnownOfChannelsAndReadsComesOut) {
  Channel known = example_channel();
  known.limit = 35'000'000;
  known.read_cost_p99_ns = 1'900;
  known.update_period_ns = 976'000;
  known.quantum = 61;
  known.wakes_device = true;
  known.gpu = "0000:00:02.0";
  known.stands_still = true;
  Channel unknown = example_channel();
  unknown.id = 2;
  unknown.name = "rapl.core.energy";
  {
    RunWriter writer(file());
    writer.add_channel(known);
    writer.add_channel(unknown);
    const Sample samples[] = {{1, 100, 7, 0}, {1, 200, 8, 60'000}, {2, 150, 9, 70'000}};
    writer.add_samples(samples);
    writer.add_self_check_frame({3, false, 40, 50});
    writer.add_self_check_frame({2, true, 20, 30});
    writer.close();
  }
  const RunRecord run = read_run(dir_);
  ASSERT_EQ(run.channels.size(), 2u);
  EXPECT_EQ(run.channels[0].limit, 35'000'000);
  EXPECT_EQ(run.channels[0].read_cost_ns, 700);
  EXPECT_EQ(run.channels[0].read_cost_p99_ns, 1'900);
  EXPECT_EQ(run.channels[0].update_period_ns, 976'000);
  EXPECT_EQ(run.channels[0].quantum, 61);
  EXPECT_TRUE(run.channels[0].wakes_device);
  EXPECT_TRUE(run.channels[0].stands_still);
  EXPECT_EQ(run.channels[0].gpu, "0000:00:02.0");
  EXPECT_EQ(run.channels[1].limit, std::nullopt);
  EXPECT_FALSE(run.channels[1].wakes_device);
  EXPECT_EQ(run.channels[1].gpu, "");
  ASSERT_EQ(run.wide_reads.at(1).size(), 1u);
  EXPECT_EQ(run.wide_reads.at(1)[0].t_ns, 200);
  EXPECT_EQ(run.wide_reads.at(1)[0].width_ns, 60'000);
  EXPECT_EQ(run.wide_reads.at(2)[0].width_ns, 70'000);
  ASSERT_EQ(run.self_check.size(), 2u);
  EXPECT_EQ(run.self_check[0].block, 2);
  EXPECT_TRUE(run.self_check[0].sampler_on);
  EXPECT_EQ(run.self_check[1].begin_ns, 40);
  EXPECT_FALSE(run.self_check[1].sampler_on);
}

TEST_F(RunDb, CarriesItsApplicationId) {
  RunWriter(file()).close();
  std::ifstream in(file(), std::ios::binary);
  in.seekg(68);  // application_id in SQLite's file header, big-endian
  char id[4];
  in.read(id, 4);
  EXPECT_EQ(std::string(id, 4), "EPrf");
}

TEST_F(RunDb, NeverOverwrites) {
  RunWriter(file()).close();
  EXPECT_THROW(RunWriter{file()}, std::runtime_error);
}

TEST_F(RunDb, UnwritableFolderIsNamed) {
  try {
    RunWriter writer(dir_ / "not" / "there" / "run.sqlite");
    FAIL() << "was created";
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), HasSubstr("not/there/run.sqlite"));
    EXPECT_THAT(error.what(), HasSubstr("unable to open"));
  }
}

TEST_F(RunDb, FlushMakesItVisibleToReaders) {
  RunWriter writer(file());
  writer.add_channel(example_channel());
  writer.flush();
  EXPECT_EQ(read_run(dir_).channels.size(), 1u);
}

TEST_F(RunDb, KilledRecorderLosesAtMostTheLastSecond) {
  // The child records one sample per millisecond, stamped with the clock, until it is killed.
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    RunWriter writer(file());
    writer.add_channel(example_channel());
    for (;;) {
      const Sample sample{1, now_ns(), 1};
      writer.add_samples({&sample, 1});
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  }
  std::this_thread::sleep_for(std::chrono::milliseconds(2500));
  const int64_t killed_ns = now_ns();
  kill(child, SIGKILL);
  waitpid(child, nullptr, 0);

  const RunRecord run = read_run(dir_);
  ASSERT_EQ(run.channels.size(), 1u);
  ASSERT_TRUE(run.series.contains(1));
  EXPECT_GT(run.series.at(1).t_ns.back(), killed_ns - ns_per_s);
}

TEST_F(RunDb, FullDiskKeepsWhatWasRecorded) {
  RunWriter::Config config;
  config.max_page_count = 40;  // 160 KiB
  RunWriter writer(file(), config);
  writer.add_channel(example_channel());
  writer.flush();
  ASSERT_EQ(writer.failure(), "");
  std::vector<Sample> many(50'000, Sample{1, 1'000'000'000'000, 262143328850});
  writer.add_samples(many);
  writer.flush();
  EXPECT_THAT(writer.failure(), HasSubstr("database or disk is full"));
  writer.add_samples(many);  // ignored
  EXPECT_THROW(writer.close(), std::runtime_error);

  const RunRecord run = read_run(dir_);
  EXPECT_EQ(run.channels.size(), 1u);
  EXPECT_TRUE(run.series.empty());
}

TEST_F(RunDb, PulledSamplesAreRecordedUntilTheEnd) {
  int pulls = 0;
  RunWriter::Config config;
  config.commit_period_ns = 1'000'000;
  config.pull_samples = [&](std::vector<Sample>& out) { out.push_back({1, ++pulls, pulls}); };
  RunWriter writer(file(), std::move(config));
  std::this_thread::sleep_for(std::chrono::milliseconds(20));
  writer.close();
  EXPECT_EQ(static_cast<int>(read_run(dir_).series.at(1).t_ns.size()), pulls);
  EXPECT_GT(pulls, 1);
}

// A database as another tool may write it: the contract's columns, and nothing else.
constexpr const char* foreign_run = R"sql(
CREATE TABLE meta(key TEXT PRIMARY KEY, value TEXT);
CREATE TABLE channels(id INTEGER PRIMARY KEY, name TEXT, source TEXT, quantity TEXT, unit TEXT,
  kind TEXT, wrap_at INTEGER, period_ns INTEGER, read_cost_ns INTEGER, origin TEXT);
CREATE TABLE samples(channel_id INTEGER, t_ns INTEGER, value REAL);
CREATE TABLE trials(id INTEGER PRIMARY KEY, model TEXT, view INTEGER, algorithm TEXT,
  repetition INTEGER, position INTEGER, begin_ns INTEGER, end_ns INTEGER, skip_reason TEXT,
  build_ns INTEGER, blob_bytes INTEGER);
CREATE TABLE frames(id INTEGER PRIMARY KEY, trial_id INTEGER, frame INTEGER, phase TEXT,
  submit_ns INTEGER, begin_ns INTEGER, end_ns INTEGER, clock_error_ns INTEGER, ray_count INTEGER,
  hit_count INTEGER, hit_checksum TEXT, node_visit_count INTEGER, prim_test_count INTEGER);
CREATE TABLE events(t_ns INTEGER, end_ns INTEGER, severity TEXT, kind TEXT, channel_id INTEGER,
  text TEXT);
)sql";

TEST_F(RunDb, ReadsARunOfAnotherTool) {
  execute(foreign_run);
  execute(
      "INSERT INTO channels "
      "VALUES(4,'x.temp','x','temperature','kelvin','gauge',NULL,NULL,NULL,NULL);"
      "INSERT INTO samples VALUES(4,10,300.5);"
      "INSERT INTO trials VALUES(1,'m',NULL,'A',NULL,NULL,5,NULL,NULL,NULL,NULL);"
      "INSERT INTO frames VALUES(1,1,0,'timed',NULL,5,15,NULL,NULL,NULL,NULL,NULL,NULL);");
  const RunRecord run = read_run(file());
  EXPECT_EQ(run.channels.at(0).unit_text, "kelvin");
  EXPECT_EQ(run.channels.at(0).unit, Unit::none);
  EXPECT_EQ(run.series.at(4).value, std::vector<double>{300.5});
  EXPECT_EQ(run.trials.at(0).end_ns, std::nullopt);
  EXPECT_EQ(run.frames.at(0).ray_count, std::nullopt);
}

TEST_F(RunDb, SortsSamplesThatWereStoredInAnyOrder) {
  execute(foreign_run);
  execute("INSERT INTO samples VALUES(2,30,3),(1,20,5),(2,10,1),(1,10,4),(2,20,2),(1,10,7);");
  const RunRecord run = read_run(file());
  EXPECT_EQ(run.series.at(1).t_ns, (std::vector<int64_t>{10, 10, 20}));
  EXPECT_EQ(run.series.at(1).value, (std::vector<double>{4, 7, 5})) << "as stored, at equal times";
  EXPECT_EQ(run.series.at(2).value, (std::vector<double>{1, 2, 3}));
}

TEST_F(RunDb, TakesSeveritiesOfAnotherTool) {
  execute(foreign_run);
  execute(
      "INSERT INTO events VALUES(1,NULL,'warn','a',NULL,'x'),(2,NULL,NULL,'b',NULL,NULL),"
      "(3,NULL,'error','c',NULL,'y'),(4,NULL,'Warning','d',NULL,'y'),(5,NULL,'CRITICAL','e',NULL,'"
      "y'),"
      "(6,NULL,'notice','f',NULL,'y');");
  const RunRecord run = read_run(file());
  ASSERT_EQ(run.events.size(), 6u);
  EXPECT_EQ(run.events[3].severity, Severity::warning);
  EXPECT_EQ(run.events[4].severity, Severity::error);
  EXPECT_EQ(run.events[5].severity, Severity::info);
  EXPECT_EQ(run.events[0].severity, Severity::warning);
  EXPECT_EQ(run.events[1].severity, Severity::info);
  EXPECT_EQ(run.events[2].severity, Severity::error);
}

TEST_F(RunDb, LeavesOutInfiniteSamplesAndSaysSo) {
  execute(foreign_run);
  execute("INSERT INTO samples VALUES(1,10,4),(1,20,9e999),(1,30,-9e999),(1,40,5);");
  const RunRecord run = read_run(file());
  EXPECT_EQ(run.series.at(1).value, (std::vector<double>{4, 5}));
  ASSERT_EQ(run.events.size(), 1u);
  EXPECT_EQ(run.events[0].kind, "sensor-bad-value");
  EXPECT_EQ(run.events[0].channel_id, 1);
  EXPECT_EQ(run.events[0].t_ns, 20);
  EXPECT_THAT(run.events[0].text, HasSubstr("2 of its samples"));
}

TEST_F(RunDb, TakesTrialsAndFramesWhoseTimesAreNotKnown) {
  execute(foreign_run);
  execute(
      "DELETE FROM trials; DELETE FROM frames;"
      "INSERT INTO trials(id,model,view,algorithm) VALUES(1,'m',0,'A');"
      "INSERT INTO trials(id,model,view,algorithm,skip_reason) VALUES(2,'m',0,'B','no memory');"
      "INSERT INTO frames(id,trial_id,frame,phase,begin_ns,end_ns) VALUES"
      "(1,1,0,'timed',100,200),(2,1,1,'timed',200,300),(3,1,2,'timed',300,NULL);");
  const RunRecord run = read_run(file());
  ASSERT_EQ(run.trials.size(), 2u);
  EXPECT_EQ(run.trials[0].begin_ns, 100);
  EXPECT_EQ(run.trials[1].begin_ns, 300) << "behind everything that was recorded";
  EXPECT_EQ(run.trials[1].skip_reason, "no memory");
  EXPECT_EQ(run.frames.size(), 2u);
  ASSERT_EQ(run.events.size(), 1u);
  EXPECT_EQ(run.events[0].kind, "frame-undated");
  EXPECT_EQ(run.events[0].t_ns, 300);
  EXPECT_THAT(run.events[0].text, HasSubstr("left out: 1"));
}

TEST_F(RunDb, TakesWhatAnotherToolKnowsOfChannels) {
  execute(foreign_run);
  execute(
      "INSERT INTO channels VALUES(4,'x.temp','x','temperature','C','gauge',NULL,NULL,NULL,NULL);"
      "CREATE TABLE channel_traits(channel_id INTEGER, limit_value INTEGER);"
      "INSERT INTO channel_traits VALUES(4,100),(5,7);"
      "CREATE TABLE read_widths(t_ns INTEGER);"
      "CREATE TABLE self_check_frames(something_else);");
  const RunRecord run = read_run(file());
  EXPECT_EQ(run.channels.at(0).limit, 100);
  EXPECT_EQ(run.channels.at(0).update_period_ns, std::nullopt);
  EXPECT_TRUE(run.wide_reads.empty());
  EXPECT_TRUE(run.self_check.empty());
}

TEST_F(RunDb, SaysWhatIsWrongWithAFile) {
  EXPECT_THAT(read_error(), HasSubstr("there is no such file"));
  std::ofstream(file()) << "This is not a database, it is a sentence that goes on and on and on.";
  EXPECT_THAT(read_error(), HasSubstr("file is not a database"));
  fs::remove(file());
  execute("CREATE TABLE something_else(x)");
  EXPECT_THAT(read_error(), HasSubstr("table 'meta' is missing"));
  fs::remove(file());
  execute(foreign_run);
  execute("INSERT INTO meta VALUES('schema_version','99')");
  EXPECT_THAT(read_error(), HasSubstr("its schema_version is 99, this program reads up to 1"));
  fs::remove(file());
  execute(foreign_run);
  execute("INSERT INTO frames VALUES(1,1,0,'later',NULL,5,15,NULL,NULL,NULL,NULL,NULL,NULL)");
  EXPECT_THAT(read_error(), HasSubstr("frames.phase 'later' is not known"));
  fs::remove(file());
  execute(foreign_run);
  execute("INSERT INTO frames VALUES(1,1,0,'timed',NULL,'soon',15,NULL,NULL,NULL,NULL,NULL,NULL)");
  EXPECT_THAT(read_error(), HasSubstr("column 'begin_ns' holds 'soon'; expected an integer"));
  fs::remove(file());
  execute("CREATE TABLE meta(key TEXT)");
  EXPECT_THAT(read_error(), HasSubstr("table 'meta' has no column 'value'"));
}

}  // namespace
}  // namespace energyprof
