// Counters that sysfs describes, and registers: what would be opened on other machines, and what
// this one counts.
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <cerrno>
#include <filesystem>

#include "core/clock.h"
#include "probe/machine_counters.h"
#include "probe/perf_events.h"
#include "probe/schedstat.h"
#include "tree.h"

namespace energyprof::probe {
namespace {

using testing::Contains;
using testing::ElementsAre;
using testing::Field;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;
using testing::SizeIs;

Root machine(const std::string& name) { return Root(Tree::machine_dir(name).string()); }

auto missing_because(const std::string& reason) {
  return Contains(Field(&Missing::reason, HasSubstr(reason)));
}

const std::map<std::string, std::string> formats{
    {"event", "config:0-7"},       {"umask", "config:8-15"}, {"edge", "config:18"},
    {"split", "config1:12-15,20"}, {"all", "config2:0-63"},  {"odd", "config:9-3"}};

TEST(EncodeEvent, PutsEachTermWhereItsFormatSays) {
  EXPECT_EQ(encode_event("event=0xff,umask=0x20", formats).config[0], 0x20ffu);
  EXPECT_EQ(encode_event("config=0x100000", {}).config[0], 0x100000u);
  EXPECT_EQ(encode_event("event=0x1,edge", formats).config[0], 0x40001u);
  // 0x1f: four bits at 12, the fifth at 20.
  EXPECT_EQ(encode_event("split=0x1f", formats).config[1], 0x10f000u);
  EXPECT_EQ(encode_event("all=0xffffffffffffffff", formats).config[2], ~uint64_t{0});
  EXPECT_EQ(encode_event(" event=3 \n", formats).config[0], 3u);
}

TEST(EncodeEvent, SaysWhatIsWrong) {
  for (const auto& [text, problem] :
       std::map<std::string, std::string>{{"", "empty"},
                                          {"event=0x100", "does not fit"},
                                          {"nothing=1", "no format"},
                                          {"event=", "no number"},
                                          {"event=zz", "no number"},
                                          {"odd=1", "does not fit"},
                                          {"event=0x11111111111111111", "no number"}})
    EXPECT_THAT(encode_event(text, formats).problem, HasSubstr(problem)) << text;
}

TEST(ParseCpuList, TakesNumbersAndRanges) {
  EXPECT_THAT(*parse_cpu_list("0,24\n"), ElementsAre(0, 24));
  EXPECT_THAT(*parse_cpu_list("0-2,8"), ElementsAre(0, 1, 2, 8));
  for (const char* text : {"", "x", "3-1", "0-99999999", "1,,2"})
    EXPECT_EQ(parse_cpu_list(text), std::nullopt) << text;
}

TEST(PerfRapl, OpensEachDomainOnceInNanojoules) {
  Discovery found;
  const std::vector<ChannelPlan> plans = plan_perf_rapl(machine("intel-rplp-i915-laptop"), found);
  std::map<std::string, const ChannelPlan*> by_name;
  for (const ChannelPlan& plan : plans) by_name[plan.channel.name] = &plan;
  ASSERT_THAT(by_name, SizeIs(4));
  const ChannelPlan& gpu = *by_name.at("rapl.uncore.energy");
  EXPECT_EQ(gpu.channel.unit, Unit::nanojoule);
  EXPECT_EQ(gpu.channel.wrap_at, std::nullopt);
  ASSERT_THAT(gpu.counters, SizeIs(1));
  EXPECT_EQ(gpu.counters[0].type, 17u);
  EXPECT_EQ(gpu.counters[0].config[0], 0x04u);
  EXPECT_EQ(gpu.counters[0].cpu, 0);
  EXPECT_EQ(gpu.counters[0].pid, -1);
  // 2^32 counts are one joule.
  EXPECT_NEAR(static_cast<double>(gpu.factor * 4294967296.0L), 1e9, 1e-3);
  EXPECT_THAT(by_name, Contains(testing::Key("rapl.package-0.energy")));
  EXPECT_THAT(by_name, Contains(testing::Key("rapl.psys.energy")));
  EXPECT_THAT(found.missing, IsEmpty());
}

TEST(PerfRapl, NamesPackagesApartAndBelievesAmdOnlyItsPackage) {
  const std::string power = "sys/bus/event_source/devices/power/";
  const std::string cpus = "sys/devices/system/cpu/";
  const Tree tree{{power + "type", "30\n"},
                  {power + "cpumask", "0,8\n"},
                  {power + "format/event", "config:0-7\n"},
                  {power + "events/energy-pkg", "event=0x02\n"},
                  {power + "events/energy-pkg.scale", "2.3283064365386962890625e-10\n"},
                  {power + "events/energy-pkg.unit", "Joules\n"},
                  {power + "events/energy-gpu", "event=0x04\n"},
                  {cpus + "cpu0/topology/physical_package_id", "0\n"},
                  {cpus + "cpu8/topology/physical_package_id", "1\n"},
                  {"proc/cpuinfo", "vendor_id\t: AuthenticAMD\n"}};
  Discovery found;
  std::vector<std::string> names;
  for (const ChannelPlan& plan : plan_perf_rapl(tree.root(), found))
    names.push_back(plan.channel.name);
  EXPECT_THAT(names, ElementsAre("rapl.package-0.energy", "rapl.package-1.energy"));
}

TEST(PerfRapl, SaysWhyAnEventIsNoUse) {
  const std::string power = "sys/bus/event_source/devices/power/";
  const Tree tree{{power + "type", "30\n"},
                  {power + "events/energy-pkg", "event=0x02\n"},
                  {power + "format/other", "config:0-7\n"},
                  {power + "events/energy-gpu", "config=4\n"},
                  {power + "events/energy-gpu.scale", "-1\n"}};
  Discovery found;
  EXPECT_THAT(plan_perf_rapl(tree.root(), found), IsEmpty());
  EXPECT_THAT(found.missing, missing_because("no format says where 'event'"));
  EXPECT_THAT(found.missing, missing_because("no positive number"));
}

TEST(Uncore, AddsUpTheControllersInBytes) {
  Discovery found;
  for (const char* name : {"intel-rplp-i915-laptop", "intel-lnl-xe-handheld"}) {
    const std::vector<ChannelPlan> plans = plan_uncore(machine(name), found);
    ASSERT_THAT(plans, SizeIs(2)) << name;
    for (const ChannelPlan& plan : plans) {
      EXPECT_EQ(plan.channel.quantity, Quantity::memory_traffic);
      EXPECT_EQ(plan.channel.unit, Unit::byte);
      EXPECT_EQ(plan.factor, 64.0L);
      EXPECT_THAT(plan.counters, SizeIs(2));
    }
    EXPECT_EQ(plans[0].channel.name, "uncore.imc.read");
    EXPECT_EQ(plans[0].counters[0].config[0], 0x20ffu);
    EXPECT_EQ(plans[1].counters[0].config[0], 0x30ffu);
  }
}

TEST(Uncore, TellsTheGpusRequestsApartWhereTheControllerDoes) {
  const std::string imc = "sys/bus/event_source/devices/uncore_imc/";
  const Tree tree{{imc + "type", "9\n"},
                  {imc + "format/event", "config:0-7\n"},
                  {imc + "events/gt_requests", "event=0x03\n"},
                  {imc + "events/gt_requests.scale", "6.103515625e-5\n"},
                  {imc + "events/gt_requests.unit", "MiB\n"}};
  Discovery found;
  const std::vector<ChannelPlan> plans = plan_uncore(tree.root(), found);
  ASSERT_THAT(plans, SizeIs(1));
  EXPECT_EQ(plans[0].channel.name, "uncore.imc.gt");
}

TEST(Uncore, TakesTheProgrammableCountersWhereTheFreeRunningOnesCountNoTraffic) {
  const std::string units = "sys/bus/event_source/devices/";
  const std::string clocks = units + "uncore_imc_free_running_0/";  // as on Sapphire Rapids
  const std::string commands = units + "uncore_imc_3/";
  const Tree tree{{clocks + "type", "30\n"},
                  {clocks + "format/event", "config:0-7\n"},
                  {clocks + "events/dclk", "event=0xff\n"},
                  {commands + "type", "23\n"},
                  {commands + "cpumask", "0,56\n"},
                  {commands + "format/event", "config:0-7\n"},
                  {commands + "format/umask", "config:8-15\n"},
                  {commands + "events/cas_count_read", "event=0x05,umask=0xcf\n"},
                  {commands + "events/cas_count_read.scale", "6.103515625e-5\n"},
                  {commands + "events/cas_count_read.unit", "MiB\n"}};
  Discovery found;
  const std::vector<ChannelPlan> plans = plan_uncore(tree.root(), found);
  ASSERT_THAT(plans, SizeIs(1));
  EXPECT_EQ(plans[0].channel.name, "uncore.imc.read");
  EXPECT_EQ(plans[0].counters[0].config[0], 0xcf05u);
  EXPECT_THAT(plans[0].counters, SizeIs(2));
}

TEST(Uncore, KnowsHowServersNameTheirFreeRunningCounters) {
  const std::string unit = "sys/bus/event_source/devices/uncore_imc_free_running_0/";
  const Tree tree{{unit + "type", "30\n"},
                  {unit + "format/event", "config:0-7\n"},
                  {unit + "format/umask", "config:8-15\n"},
                  {unit + "events/write", "event=0xff,umask=0x30\n"},
                  {unit + "events/write.scale", "6.103515625e-5\n"},
                  {unit + "events/write.unit", "MiB\n"}};
  Discovery found;
  const std::vector<ChannelPlan> plans = plan_uncore(tree.root(), found);
  ASSERT_THAT(plans, SizeIs(1));
  EXPECT_EQ(plans[0].channel.name, "uncore.imc.write");
}

TEST(Uncore, AddsUpTheSubchannelsOfAController) {
  const std::string unit = "sys/bus/event_source/devices/uncore_imc_0/";  // as on Granite Rapids
  const Tree tree{{unit + "type", "30\n"},
                  {unit + "format/event", "config:0-7\n"},
                  {unit + "format/umask", "config:8-15\n"},
                  {unit + "events/cas_count_read_sch0", "event=0x05,umask=0xcf\n"},
                  {unit + "events/cas_count_read_sch1", "event=0x06,umask=0xcf\n"},
                  {unit + "events/cas_count_write_sch0", "event=0x05,umask=0xf0\n"},
                  {unit + "events/cas_count_write_sch1", "event=0x06,umask=0xf0\n"}};
  Discovery found;
  const std::vector<ChannelPlan> plans = plan_uncore(tree.root(), found);
  ASSERT_THAT(plans, SizeIs(2));
  EXPECT_EQ(plans[0].channel.name, "uncore.imc.read");
  ASSERT_THAT(plans[0].counters, SizeIs(2));
  EXPECT_EQ(plans[0].counters[1].config[0], 0xcf06u);
  EXPECT_TRUE(plans[0].counters[1].pinned);
  EXPECT_EQ(plans[1].channel.name, "uncore.imc.write");
}

TEST(Uncore, SaysSoWhereAControllerListsNoKnownEvent) {
  const std::string unit = "sys/bus/event_source/devices/uncore_imc_0/";
  const Tree tree{{unit + "type", "30\n"}, {unit + "events/clockticks", "event=0x01\n"}};
  Discovery found;
  discover_uncore(tree.root(), found);
  EXPECT_THAT(found.missing, missing_because("uncore_imc_0: no event"));
  EXPECT_THAT(found.missing, Not(missing_because("no perf unit")));
}

TEST(Uncore, CountsTheCommandsOfAmdsControllers) {
  const std::string units = "sys/bus/event_source/devices/";
  const Tree tree;
  for (const std::string unit : {"amd_umc_0/", "amd_umc_1/"})
    tree.write({{units + unit + "type", "11\n"},
                {units + unit + "cpumask", "0\n"},
                {units + unit + "format/event", "config:0-7\n"},
                {units + unit + "format/rdwrmask", "config:8-9\n"}});
  tree.write({{units + "amd_umc_2/type", "12\n"}});  // nothing says how to ask it
  Discovery found;
  const std::vector<ChannelPlan> plans = plan_uncore(tree.root(), found);
  ASSERT_THAT(plans, SizeIs(2));
  EXPECT_EQ(plans[0].channel.name, "uncore.umc.read");
  EXPECT_EQ(plans[0].channel.quantity, Quantity::memory_traffic);
  EXPECT_EQ(plans[0].channel.unit, Unit::byte);
  EXPECT_EQ(plans[0].factor, 64.0L);
  EXPECT_EQ(plans[0].counters[0].config[0], 0x10au);
  EXPECT_EQ(plans[1].channel.name, "uncore.umc.write");
  EXPECT_EQ(plans[1].counters[0].config[0], 0x20au);
  EXPECT_THAT(plans[1].counters, SizeIs(2));
}

TEST(GpuCounters, AreThoseOfTheDriversUnit) {
  Discovery found;
  const std::vector<GpuPlan> i915 = plan_i915_pmu(machine("intel-rplp-i915-laptop"), found);
  ASSERT_THAT(i915, SizeIs(1));
  EXPECT_EQ(i915[0].gpu, "0000:00:02.0");
  std::map<std::string, const ChannelPlan*> by_name;
  for (const ChannelPlan& plan : i915[0].plans) by_name[plan.channel.name] = &plan;
  EXPECT_EQ(by_name.at("i915.pmu.gt0.actual_cycles")->counters[0].config[0], 0x100000u);
  EXPECT_EQ(by_name.at("i915.pmu.gt0.actual_cycles")->factor, 1e6L);
  EXPECT_EQ(by_name.at("i915.pmu.gt0.rc6")->channel.unit, Unit::nanosecond);
  EXPECT_EQ(by_name.at("i915.pmu.rcs0.busy")->counters[0].config[0], 0u);
  EXPECT_EQ(by_name.count("i915.pmu.bcs0.busy"), 0u);

  const std::vector<GpuPlan> xe = plan_xe_pmu(machine("intel-lnl-xe-handheld"), found);
  ASSERT_THAT(xe, SizeIs(1));
  EXPECT_EQ(xe[0].gpu, "0000:00:02.0");
  // Its clock events keep the GPU awake while they are open.
  ASSERT_THAT(xe[0].plans, SizeIs(1));
  EXPECT_EQ(xe[0].plans[0].channel.name, "xe.pmu.gt0.c6");
  EXPECT_THAT(found.missing, IsEmpty());
}

TEST(MachineCounters, AreNotForARoot) {
  const Discovery found = discover(machine("intel-rplp-i915-laptop"));
  for (const char* source : {"perf_rapl", "i915_pmu", "xe_pmu", "perf", "uncore"})
    EXPECT_THAT(found.missing,
                Contains(testing::AllOf(Field(&Missing::source, source),
                                        Field(&Missing::reason, HasSubstr("not under --root")))));
}

TEST(MachineCounters, SayWhatTheKernelWouldHaveToAllow) {
  const Tree tree{{"proc/sys/kernel/perf_event_paranoid", "4\n"}};
  const auto explain = [&](int error, int paranoid) {
    return explain_counters(tree.root(), "uncore", "'x'", error, paranoid);
  };
  EXPECT_THAT(explain(EACCES, 0).reason, HasSubstr("perf_event_paranoid is 4, and this needs 0"));
  // The program that runs, wherever it lies.
  EXPECT_EQ(explain(EACCES, 0).fix, "sudo setcap cap_perfmon+ep '" +
                                        std::filesystem::read_symlink("/proc/self/exe").string() +
                                        "'");
  EXPECT_THAT(explain(EMFILE, 0).fix, HasSubstr("ulimit -n"));
  EXPECT_THAT(explain(ENOENT, 0).reason, HasSubstr("virtual machine"));
  EXPECT_THAT(explain(EINVAL, 0).reason, Not(HasSubstr("virtual machine")));
  tree.write({{"proc/sys/kernel/perf_event_paranoid", "1\n"}});
  EXPECT_THAT(explain(EPERM, 2).reason, HasSubstr("which allows it"));
  EXPECT_THAT(explain(EPERM, 2).fix, HasSubstr("docker"));
  EXPECT_THAT(explain(EPERM, 0).fix, HasSubstr("setcap"));
}

TEST(MachineCounters, SayWhenTheyCannotBeOpened) {
  Discovery found;
  ChannelPlan plan;
  plan.channel.origin = "perf nothing/such/";
  plan.counters = {{.type = 0x7fff'fff0, .cpu = 0, .pinned = true}};
  std::vector<ChannelPlan> plans(2, plan);
  add_counters(Root(), found, "uncore", ns_per_ms, std::move(plans), {});
  EXPECT_THAT(found.sources, IsEmpty());
  ASSERT_THAT(found.missing, SizeIs(1));  // one reason for both
  EXPECT_THAT(found.missing[0].reason, HasSubstr("'perf nothing/such/', 'perf nothing/such/'"));
}

TEST(RunningRatio, IsThatOfTheEventCountedLeast) {
  constexpr uint64_t ms = ns_per_ms;
  EXPECT_EQ(lowest_running_ppm({}, false), std::nullopt);
  EXPECT_EQ(lowest_running_ppm(std::vector<CountedTime>{{0, 0, 0}}, false), std::nullopt);
  const std::vector<CountedTime> shared{{0, 20 * ms, 20 * ms}, {1, 20 * ms, 15 * ms}};
  EXPECT_EQ(lowest_running_ppm(shared, false), 750'000);
  // A thread that changes between two kinds of cores is counted on one of them at a time.
  const std::vector<CountedTime> hybrid{{0, 20 * ms, 5 * ms}, {0, 20 * ms, 15 * ms}};
  EXPECT_EQ(lowest_running_ppm(hybrid, false), 1'000'000);
  // Processors of both kinds are counted all the time.
  const std::vector<CountedTime> processors{{0, 40 * ms, 40 * ms}, {0, 20 * ms, 5 * ms}};
  EXPECT_EQ(lowest_running_ppm(processors, true), 750'000);
}

TEST(Counter, ThatTheHardwareHasNoRoomForCountsNothing) {
  // As of a pinned counter that is not counted: the end of the file.
  const Counter counter(open("/dev/null", O_RDONLY));
  EXPECT_EQ(counter.read().error, ENODEV);
}

TEST(CorePmus, AreAllThatListTheirProcessors) {
  const std::string units = "sys/bus/event_source/devices/";
  const Tree tree{{units + "cpu_core/type", "4\n"},
                  {units + "cpu_core/cpus", "0-3\n"},
                  {units + "power/type", "17\n"},
                  {units + "power/cpumask", "0\n"}};
  EXPECT_THAT(list_core_pmus(tree.root()), IsEmpty());  // all cores are alike
  tree.write({{units + "cpu_atom/type", "10\n"},
              {units + "cpu_atom/cpus", "4-7\n"},
              {units + "cpu_lowpower/type", "11\n"},
              {units + "cpu_lowpower/cpus", "8-9\n"}});
  const std::vector<Pmu> kinds = list_core_pmus(tree.root());
  ASSERT_THAT(kinds, SizeIs(3));
  EXPECT_EQ(kinds[1].name, "cpu_core");
  EXPECT_EQ(kinds[2].name, "cpu_lowpower");
  EXPECT_THAT(kinds[2].cpus, ElementsAre(8, 9));
}

TEST(ProcessUsage, CountsThePageFaultsOfThisProcess) {
  Discovery found;
  add_process_usage({}, found);
  const int64_t before = poll_all(found)["process.page_faults"].value;
  // More than any allocator keeps.
  std::vector<char> memory(size_t{64} << 20, 1);
  EXPECT_GE(poll_all(found)["process.page_faults"].value - before, 16);
  EXPECT_EQ(memory[123], 1);
}

TEST(ProcessUsage, IsNotThatOfARecordedProgram) {
  const Discovery found =
      discover(Root(), Selection{.sources = {"schedstat", "perf"}, .program = true});
  for (const std::string& name : names_of(found))
    EXPECT_FALSE(name.starts_with("process.")) << name;
  EXPECT_THAT(found.missing,
              Contains(testing::AllOf(Field(&Missing::source, "schedstat"),
                                      Field(&Missing::reason, HasSubstr("energyprof itself")))));
}

// What the thread's file would have to be for the source to see that nothing is counted.
Discovery schedstat_of(const Tree& tree) {
  Discovery found;
  discover_schedstat(tree.root(), {}, found);
  return found;
}

TEST(Schedstat, IsMissingWhereTheKernelDoesNotCount) {
  const Tree tree{{"proc/thread-self/schedstat", "0 0 0\n"}};
  EXPECT_THAT(schedstat_of(tree).sources, IsEmpty());
  EXPECT_THAT(schedstat_of(tree).missing, missing_because("does not count"));
  tree.write({{"proc/sys/kernel/task_delayacct", "0\n"}});
  EXPECT_THAT(schedstat_of(tree).missing,
              Contains(Field(&Missing::fix, "sudo sysctl kernel.task_delayacct=1")));
  tree.write({{"proc/thread-self/schedstat", "much\n"}});
  EXPECT_THAT(schedstat_of(tree).missing, missing_because("two numbers"));
}

TEST(Schedstat, GivesNoZerosForThreadsThatItCannotOpen) {
  const Tree tree{{"proc/thread-self/schedstat", "1 0 1\n"}};
  rlimit limit{};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &limit), 0);
  const rlimit none{0, limit.rlim_max};
  const Discovery found = schedstat_of(tree);  // opens what it lists threads by
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &none), 0);
  auto readings = poll_all(found);
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &limit), 0);
  EXPECT_EQ(readings["process.cpu_wait"].status, PollStatus::retry);
  EXPECT_EQ(readings["process.cpu_time"].status, PollStatus::retry);
}

Selection with_msr() { return Selection{.sources = {"powercap", "msr"}, .allow_msr = true}; }

TEST(Msr, IsReadOnlyIfAllowed) {
  const Discovery found =
      discover(machine("intel-rplp-i915-laptop"), Selection{.sources = {"msr"}});
  EXPECT_THAT(found.sources, IsEmpty());
  EXPECT_THAT(found.missing, Contains(Field(&Missing::fix, HasSubstr("--allow-msr"))));
}

TEST(Msr, GivesWhatPowercapDoesNot) {
  Selection selection = with_msr();
  const Discovery both = discover(machine("intel-rplp-i915-laptop"), selection);
  EXPECT_EQ(channel_called(both, "rapl.package-0.energy").source, "powercap");
  EXPECT_EQ(poll_all(both)["msr.gfx.throttle.pl1"].value, 1);
  EXPECT_EQ(channel_called(both, "msr.gfx.throttle.pl1").gpu, "0000:00:02.0");
  EXPECT_EQ(channel_called(both, "msr.core.throttle.pl1").gpu, "");

  selection.sources = {"msr"};
  const Discovery alone = discover(machine("intel-rplp-i915-laptop"), selection);
  auto readings = poll_all(alone);
  // 0x1a54e1dd x 2^-14 J
  EXPECT_EQ(readings["rapl.package-0.energy"].value,
            static_cast<int64_t>(uint64_t{0x1a54e1dd} * 1'000'000'000 >> 14));
  EXPECT_EQ(channel_called(alone, "rapl.package-0.energy").wrap_at,
            (int64_t{1} << 18) * 1'000'000'000 - 1);
  EXPECT_EQ(readings["rapl.package-0.pl1"].value, 45'000'000);
  EXPECT_EQ(readings["rapl.package-0.pl2"].value, 115'000'000);
  EXPECT_EQ(readings.count("rapl.dram.energy"), 0u);  // the register is not there
  // 0x64f = 0x3d001000: max-turbo limit alone is active, and that is no throttling.
  for (const auto& [name, reading] : readings) {
    if (name.starts_with("msr.core.")) {
      EXPECT_EQ(reading.value, 0) << name;
    }
  }
  EXPECT_EQ(readings["msr.package.throttle.power_limit"].value, 1);
  EXPECT_EQ(readings["msr.package.throttle.prochot"].value, 0);
}

TEST(Msr, KnowsTheUnitsOfServers) {
  const std::string registers = "0x606\t0xa0e03\n0x611\t0x4000\n0x619\t0x10000\n0x64d\t0x3\n";
  const auto energies = [&](const std::string& model) {
    const Tree tree{
        {"dev/cpu/0/msr.tsv", registers},
        {"proc/cpuinfo", "cpu family\t: 6\nmodel\t\t: " + model + "\nmodel name\t: Intel\n"}};
    auto readings = poll_all(discover(tree.root(), with_msr()));
    return std::array{readings["rapl.package-0.energy"].value, readings["rapl.dram.energy"].value,
                      readings["rapl.psys.energy"].value};
  };
  constexpr int64_t j = 1'000'000'000;
  EXPECT_EQ(energies("186"), (std::array{j, 4 * j, 3 * j >> 14}));  // a laptop: all 2^-14 J
  EXPECT_EQ(energies("85"), (std::array{j, j, 3 * j >> 14}));       // Skylake server
  EXPECT_EQ(energies("143"), (std::array{j, j, 3 * j}));            // Sapphire Rapids
}

TEST(Msr, DoesNotRecordAgainWhatAPackageOfSeveralHas) {
  const std::string rapl = "sys/class/powercap/";
  const Tree tree{{"dev/cpu/0/msr.tsv", "0x606\t0xa0e03\n0x611\t0x1\n0x619\t0x1\n"},
                  {rapl + "intel-rapl:0/name", "package-0\n"},
                  {rapl + "intel-rapl:0/energy_uj", "1\n"},
                  {rapl + "intel-rapl:0:0/name", "dram\n"},
                  {rapl + "intel-rapl:0:0/energy_uj", "2\n"},
                  {rapl + "intel-rapl:1/name", "package-1\n"},
                  {rapl + "intel-rapl:1/energy_uj", "3\n"}};
  for (const std::string& name : names_of(discover(tree.root(), with_msr())))
    EXPECT_NE(name, "rapl.dram.energy");
}

TEST(Msr, DoesNotRecordAgainWhatADieOfSeveralHas) {
  const std::string rapl = "sys/class/powercap/";
  const Tree tree{
      {"dev/cpu/0/msr.tsv", "0x606\t0xa0e03\n0x610\t0x80c8\n0x611\t0x1\n0x619\t0x1\n0x639\t0x1\n"},
      {rapl + "intel-rapl:0/name", "package-0-die-0\n"},
      {rapl + "intel-rapl:0/energy_uj", "1\n"},
      {rapl + "intel-rapl:0/constraint_0_name", "long_term\n"},
      {rapl + "intel-rapl:0/constraint_0_power_limit_uw", "25000000\n"},
      {rapl + "intel-rapl:0:0/name", "dram\n"},
      {rapl + "intel-rapl:0:0/energy_uj", "2\n"},
      {rapl + "intel-rapl:1/name", "package-0-die-1\n"},
      {rapl + "intel-rapl:1/energy_uj", "3\n"}};
  const Discovery found = discover(tree.root(), with_msr());
  std::vector<std::string> of_msr;
  for (const auto& source : found.sources)
    if (source->name() == "msr")
      for (const Channel& channel : std::as_const(*source).channels())
        of_msr.push_back(channel.name);
  EXPECT_THAT(of_msr, ElementsAre("rapl.core.energy"));  // nobody else has it
}

TEST(Msr, TakesNoLimitThatIsNotEnabled) {
  // PL1 25 W with bit 15, PL2 25 W without bit 47.
  const Tree tree{{"dev/cpu/0/msr.tsv", "0x606\t0xa0e03\n0x610\t0xc8000080c8\n"}};
  const Discovery found = discover(tree.root(), with_msr());
  EXPECT_EQ(poll_all(found)["rapl.package-0.pl1"].value, 25'000'000);
  EXPECT_EQ(channel_called(found, "rapl.package-0.pl2").id, 0);
  EXPECT_THAT(found.missing, missing_because("rapl.package-0.pl2 is not enabled"));
  tree.write({{"dev/cpu/0/msr.tsv", "0x606\t0xa0e03\n0x610\t0xc8000000c8\n"}});  // later
  EXPECT_EQ(poll_all(found)["rapl.package-0.pl1"].status, PollStatus::retry);
}

TEST(Msr, GivesNoReasonsOfAGpuThatIsNotThere) {
  const Tree tree{{"dev/cpu/0/msr.tsv", "0x606\t0xa0e03\n0x64f\t0x1\n0x6b0\t0x1\n"}};
  const Discovery found = discover(tree.root(), with_msr());
  EXPECT_EQ(poll_all(found)["msr.core.throttle.prochot"].value, 1);
  EXPECT_EQ(channel_called(found, "msr.gfx.throttle.prochot").id, 0);
}

TEST(Msr, BlamesLockdownOnlyWhereItIsOn) {
  const Tree tree{{"dev/cpu/0/msr.tsv", "0x606\t0xa0e03\n"},
                  {"sys/kernel/security/lockdown", "none [integrity] confidentiality\n"}};
  const auto why = [&] {
    return discover(tree.root({{"dev/cpu/0/msr.tsv", EPERM}}), with_msr()).missing;
  };
  EXPECT_THAT(why(), missing_because("lockdown"));
  tree.write({{"sys/kernel/security/lockdown", "[none] integrity confidentiality\n"}});
  EXPECT_THAT(why(), missing_because("CAP_SYS_RAWIO"));
  EXPECT_THAT(why(), Not(missing_because("lockdown")));
}

TEST(Msr, SuggestsACommandForTheSameTreeWhereThatHasRegisters) {
  const Tree tree{{"dev/cpu/0/msr.tsv", "0x606\t0xa0e03\n"}};
  const auto missing = [](const Tree& of) {
    return discover(of.root(), Selection{.sources = {"msr"}}).missing;
  };
  // The program that runs: the shell may find another one, or none.
  const std::string program = std::filesystem::read_symlink("/proc/self/exe").string();
  EXPECT_THAT(missing(tree),
              ElementsAre(Field(&Missing::fix, "'" + program + "' probe --allow-msr --root '" +
                                                   tree.path() + "'")));
  const auto without_fix = [](const std::string& reason) {
    return ElementsAre(AllOf(Field(&Missing::reason, HasSubstr(reason)), Field(&Missing::fix, "")));
  };
  EXPECT_THAT(missing(Tree()), without_fix("msr.tsv"));
  const Tree board{{"proc/cpuinfo", "processor\t: 0\nCPU implementer\t: 0x41\n"}};
  EXPECT_THAT(missing(board), without_fix("no x86 processor"));
}

TEST(Msr, TakesTheReasonsOfOldProcessorsFromTheirOwnRegister) {
  const Tree tree{{"dev/cpu/0/msr.tsv", "0x606\t0xa0e03\n0x690\t0x430\n"}};
  auto readings = poll_all(discover(tree.root(), with_msr()));
  EXPECT_EQ(readings["msr.core.throttle.pl1"].value, 1);
  EXPECT_EQ(readings.count("msr.core.throttle.ratl"), 0u);
}

TEST(Msr, ReadsAmdAndSaysWhyNotOtherwise) {
  const Tree amd{{"dev/cpu/0/msr.tsv", "0xc0010299\t0xa1000\n0xc001029b\t0x10000\n"}};
  const Discovery found = discover(amd.root(), with_msr());
  EXPECT_EQ(poll_all(found)["rapl.package-0.energy"].value, 1'000'000'000);  // 2^16 x 2^-16 J
  EXPECT_THAT(discover(Tree().root(), with_msr()).missing, missing_because("msr.tsv"));
  const Tree junk{{"dev/cpu/0/msr.tsv", "0x606\tzz\n\n0x\n"}};
  EXPECT_THAT(discover(junk.root(), with_msr()).missing, missing_because("neither"));
}

}  // namespace
}  // namespace energyprof::probe
