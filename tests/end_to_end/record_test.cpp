// `energyprof record` around real programs: it must not be noticed, and must leave a run.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <fstream>
#include <nlohmann/json.hpp>
#include <thread>

#include "core/run_db.h"
#include "tests/end_to_end/program.h"

namespace energyprof {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using test::Output;
using test::Process;
using test::read_text;
using testing::AllOf;
using testing::Contains;
using testing::Field;
using testing::HasSubstr;
using testing::IsEmpty;

class Record : public testing::Test {
 protected:
  [[nodiscard]] std::vector<std::string> command(
      const std::vector<std::string>& words, const std::vector<std::string>& options = {}) const {
    std::vector<std::string> all{ENERGYPROF_PROGRAM, "record", "--out", out().string()};
    all.insert(all.end(), options.begin(), options.end());
    all.emplace_back("--");
    all.insert(all.end(), words.begin(), words.end());
    return all;
  }
  [[nodiscard]] Output record(const std::vector<std::string>& words,
                              const std::vector<std::string>& options = {}) const {
    return test::run(command(words, options));
  }
  [[nodiscard]] fs::path out() const { return dir_ / "run"; }

  test::TempDir dir_;
};

TEST_F(Record, LeavesARunAndTheProgramsOwnWordsAlone) {
  const Output output = record({"sh", "-c", "printf 'a\\nb'; printf oops >&2; exit 7"});
  EXPECT_EQ(output.code, 7);
  EXPECT_EQ(output.out, "a\nb");
  EXPECT_THAT(output.err, testing::StartsWith("oops"));
  EXPECT_THAT(output.err, HasSubstr("report.html"));
  for (const char* file :
       {"run.sqlite", "timeline.json", "report.json", "report.md", "report.html"})
    EXPECT_TRUE(fs::exists(out() / file)) << file;
  EXPECT_FALSE(fs::exists(out() / "images"));
  const RunRecord run = read_run(out());
  EXPECT_THAT(run.frames, IsEmpty());
  EXPECT_FALSE(run.channels.empty());
  EXPECT_THAT(run.meta.at("command"), HasSubstr("printf oops"));
  EXPECT_THAT(run.events, Contains(AllOf(Field(&Event::kind, "command"),
                                         Field(&Event::text, HasSubstr("exit code 7")))));
  EXPECT_EQ(test::run({ENERGYPROF_PROGRAM, "analyze", out().string()}).code, 0);
}

TEST_F(Record, PassesEveryWordAsItIs) {
  // What command lines like to interpret: lists, empty words, options, marks.
  const std::vector<std::string> words{"printf", "<%s>", "[a,b]", "",  "--out",
                                       "--",     "{}",   "-h",    "$x"};
  EXPECT_EQ(record(words).out, "<[a,b]><><--out><--><{}><-h><$x>");
}

TEST_F(Record, RunsScriptsWithoutAnInterpreterLineAsAShellWould) {
  const fs::path script = dir_ / "script";
  std::ofstream(script) << "exit 5\n";
  fs::permissions(script, fs::perms::owner_all);
  EXPECT_EQ(record({script.string()}).code, 5);
}

TEST_F(Record, GivesTheProgramTheSignalsItFound) {
  // As nohup does: a program that is to survive a hang-up still does.
  const Output output = test::run({"sh", "-c", "trap '' HUP; exec \"$@\"", "sh", ENERGYPROF_PROGRAM,
                                   "record", "--out", out().string(), "--", "sh", "-c",
                                   "kill -HUP $$; grep -E 'SigBlk|SigIgn' /proc/self/status"});
  EXPECT_EQ(output.code, 0);
  EXPECT_THAT(output.out, HasSubstr("SigBlk:\t0000000000000000"));
  EXPECT_THAT(output.out, HasSubstr("SigIgn:\t0000000000000001"));
}

TEST_F(Record, SaysWhatTheSensorsShowed) {
  const Output output = record({"sleep", "0.2"});
  EXPECT_THAT(output.err, HasSubstr("sleep 0.2 ran for "));
  const json report = json::parse(read_text(out() / "report.json"));
  EXPECT_EQ(report["run"]["command"]["text"], "sleep 0.2");
  EXPECT_EQ(report["run"]["command"]["exit_code"], 0);
  EXPECT_TRUE(report["run"]["command"]["signal"].is_null());
  EXPECT_GE(report["run"]["command"]["end_ns"].get<int64_t>() -
                report["run"]["command"]["begin_ns"].get<int64_t>(),
            200'000'000);
  const std::string page = read_text(out() / "report.md");
  EXPECT_THAT(page, HasSubstr("## What the sensors showed"));
  EXPECT_THAT(page, testing::Not(HasSubstr("Ranking")));
  EXPECT_THAT(read_text(out() / "timeline.json"),
              HasSubstr(R"("name":"sleep 0.2","cat":"command")"));
}

TEST_F(Record, QuietMeansNothingOnStderr) {
  EXPECT_THAT(record({"true"}, {"--quiet"}).err, IsEmpty());
}

TEST_F(Record, CountsWhatTheProgramDoes) {
  // 64 MiB of fresh memory, touched: 16384 pages, or 32 huge ones.
  const Output output =
      record({"sh", "-c", "head -c 67108864 /dev/zero | tail -c 67108864 >/dev/null"});
  ASSERT_EQ(output.code, 0);
  const RunRecord run = read_run(out());
  for (const Channel& channel : run.channels) {
    if (channel.name != "perf.page_faults") continue;
    const SampleSeries& series = run.series.at(channel.id);
    EXPECT_GT(series.value.back() - series.value.front(), 32.0);
    return;
  }
  GTEST_SKIP() << "page faults cannot be counted here";
}

TEST_F(Record, EndsAsItsProgramWasEnded) {
  EXPECT_EQ(record({"sh", "-c", "kill -TERM $$"}).code, 128 + SIGTERM);
  EXPECT_THAT(read_run(out()).events,
              Contains(AllOf(Field(&Event::kind, "command"),
                             Field(&Event::text, HasSubstr("ended by signal 15")))));
}

TEST_F(Record, ForwardsSignalsThatAreSentToItAlone) {
  for (const int signal : {SIGINT, SIGTERM, SIGUSR1}) {
    test::TempDir dir;
    Process process(
        {ENERGYPROF_PROGRAM, "record", "--out", (dir / "run").string(), "--", "sh", "-c",
         "trap 'exit 3' INT TERM USR1; echo ready >&2; while :; do sleep 0.05; done"},
        {});
    while (process.err_so_far().find("ready") == std::string::npos)
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    process.send(signal);
    EXPECT_EQ(process.wait().code, 3) << signal;
    EXPECT_TRUE(fs::exists(dir / "run/report.json")) << signal;
  }
}

char state_of(const std::string& process) {
  const std::string stat = read_text("/proc/" + process + "/stat");
  const size_t name_end = stat.rfind(") ");
  return name_end == std::string::npos ? '?' : stat[name_end + 2];
}

TEST_F(Record, StopsAndGoesOnWithItsProgram) {
  const std::string words = "echo $$ > '" + (dir_ / "id").string() + "'; while [ ! -e '" +
                            (dir_ / "go").string() + "' ]; do sleep 0.02; done; exit 4";
  std::vector<std::string> all = command({"sh", "-c", words}, {"--quiet"});
  std::vector<char*> argv;
  for (std::string& word : all) argv.push_back(word.data());
  argv.push_back(nullptr);
  const pid_t pid = fork();
  ASSERT_GE(pid, 0);
  if (pid == 0) {
    setpgid(0, 0);  // the kernel stops no group that no shell looks after
    execv(argv[0], argv.data());
    _exit(127);
  }
  std::string program;
  while (program.empty()) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    if (fs::exists(dir_ / "id")) program = read_text(dir_ / "id");
    if (!program.empty() && program.back() == '\n') program.pop_back();
  }
  kill(pid, SIGTSTP);
  int status = 0;
  ASSERT_EQ(waitpid(pid, &status, WUNTRACED), pid);
  EXPECT_TRUE(WIFSTOPPED(status));
  EXPECT_EQ(state_of(program), 'T');
  std::ofstream(dir_ / "go") << "\n";
  kill(pid, SIGCONT);
  ASSERT_EQ(waitpid(pid, &status, 0), pid);
  ASSERT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 4);
}

TEST_F(Record, KilledItLeavesARunThatOpens) {
  Process process(command({"sh", "-c", "echo ready >&2; exec sleep 3"}), {});
  while (process.err_so_far().find("ready") == std::string::npos)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  std::this_thread::sleep_for(std::chrono::milliseconds(800));
  process.send(SIGKILL);
  EXPECT_EQ(process.wait().code, 128 + SIGKILL);
  EXPECT_FALSE(read_run(out()).series.empty());
  EXPECT_EQ(test::run({ENERGYPROF_PROGRAM, "analyze", out().string()}).code, 0);
}

TEST_F(Record, SaysInOneLineThatThereIsNoSuchProgramAndLeavesNothing) {
  const Output missing = record({"no-such-program"});
  EXPECT_EQ(missing.code, 127);
  EXPECT_EQ(missing.err, "energyprof: cannot run 'no-such-program': No such file or directory.\n");
  EXPECT_FALSE(fs::exists(out()));
  EXPECT_EQ(record({"/"}).code, 126);
  EXPECT_FALSE(fs::exists(out()));
}

TEST_F(Record, FollowsAnotherMachinesFilesAndSaysSimulated) {
  fs::copy(fs::path(ENERGYPROF_TEST_DATA) / "sysfs/intel-rplp-i915-laptop", dir_ / "machine",
           fs::copy_options::recursive);
  const std::string energy =
      (dir_ / "machine/sys/devices/virtual/powercap/intel-rapl/intel-rapl:0/energy_uj").string();
  // 0.3 s later, 5 J more, written in place and then by renaming.
  const Output output =
      record({"sh", "-c",
              "sleep 0.3; echo 26968529117 > " + energy + "; sleep 0.1; echo 26973529117 > " +
                  energy + ".new; mv " + energy + ".new " + energy + "; sleep 0.1"},
             {"--root", (dir_ / "machine").string(), "--rate", "200"});
  ASSERT_EQ(output.code, 0) << output.err;
  const RunRecord run = read_run(out());
  EXPECT_EQ(run.meta.at("simulated"), "1");
  for (const Channel& channel : run.channels) {
    if (channel.name != "rapl.package-0.energy") continue;
    EXPECT_EQ(run.series.at(channel.id).value.front(), 26'963'529'117.0);
    EXPECT_EQ(run.series.at(channel.id).value.back(), 26'973'529'117.0);
    EXPECT_GE(channel.period_ns, 5'000'000);
    return;
  }
  FAIL() << "no rapl.package-0.energy";
}

TEST_F(Record, RefusesARunThatIsThere) {
  ASSERT_EQ(record({"true"}).code, 0);
  const Output again = record({"true"});
  EXPECT_EQ(again.code, 1);
  EXPECT_THAT(again.err, HasSubstr("never overwritten"));
}

TEST_F(Record, WrongUsageIsExitTwo) {
  EXPECT_EQ(test::run({ENERGYPROF_PROGRAM, "record"}).code, 2);
  EXPECT_EQ(test::run({ENERGYPROF_PROGRAM, "record", "--rate", "0", "--", "true"}).code, 2);
}

}  // namespace
}  // namespace energyprof
