// Whole machines of tests/data/sysfs: each is discovered and read; the known numbers come out.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <map>
#include <set>
#include <sstream>

#include "probe/characterize.h"
#include "tree.h"

namespace energyprof::probe {
namespace {

using testing::AllOf;
using testing::Contains;
using testing::Field;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;
using testing::SizeIs;

// Errors that the real machine's files give, from its ERRNO.tsv: "path<TAB>ERRNO".
std::map<std::string, int> read_errors(const std::string& machine) {
  const std::map<std::string, int> known{
      {"EACCES", EACCES},       {"EAGAIN", EAGAIN}, {"EBUSY", EBUSY},           {"EFBIG", EFBIG},
      {"EINVAL", EINVAL},       {"EIO", EIO},       {"ENODATA", ENODATA},       {"ENODEV", ENODEV},
      {"ENOENT", ENOENT},       {"ENXIO", ENXIO},   {"EOPNOTSUPP", EOPNOTSUPP}, {"EPERM", EPERM},
      {"EREMOTEIO", EREMOTEIO}, {"ETIME", ETIME},   {"ETIMEDOUT", ETIMEDOUT}};
  std::map<std::string, int> errors;
  std::ifstream file(Tree::machine_dir(machine) / "ERRNO.tsv");
  for (std::string line; std::getline(file, line);) {
    const size_t tab = line.find('\t');
    // Lines with '*' or a space tell of users and libraries, not of a file.
    if (tab == std::string::npos || line.substr(0, tab).find_first_of("* #") != std::string::npos)
      continue;
    errors[line.substr(0, tab)] = known.at(line.substr(tab + 1));
  }
  return errors;
}

std::vector<std::string> machines() {
  std::vector<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(Tree::machine_dir("")))
    if (entry.is_directory()) names.push_back(entry.path().filename().string());
  return names;
}

class Machine : public testing::TestWithParam<std::string> {};

TEST_P(Machine, IsDiscoveredAndRead) {
  const Root root(Tree::machine_dir(GetParam()).string(), read_errors(GetParam()));
  Discovery found = discover(root);
  characterize(found, root, {ns_per_ms, ns_per_ms});
  std::set<std::string> names;
  std::set<std::string> heard_of;
  int32_t id = 0;
  for (const auto& source : found.sources) {
    EXPECT_FALSE(source->channels().empty());
    EXPECT_GT(source->period_ns(), 0);
    for (const Channel& channel : source->channels()) {
      EXPECT_TRUE(names.insert(channel.name).second) << channel.name;
      EXPECT_EQ(channel.id, ++id);
      EXPECT_EQ(parse_unit(unit_info(channel.unit).name), channel.unit);
      EXPECT_NE(channel.unit, Unit::none) << channel.name;
      EXPECT_TRUE(channel.read_cost_ns.has_value()) << channel.name;
      EXPECT_EQ(channel.source, source->name());
      EXPECT_THAT(channel.origin, HasSubstr(GetParam())) << channel.name;
      heard_of.insert(channel.source);
    }
  }
  for (const Missing& missing : found.missing) {
    EXPECT_NE(missing.reason, "");
    // A command that names no file of the tree would change the machine that runs the test.
    EXPECT_THAT(missing.fix, testing::AnyOf("", HasSubstr(root.directory())));
    heard_of.insert(missing.source);
  }
  for (const std::string& name : source_names()) EXPECT_THAT(heard_of, Contains(name));
  for (const auto& [name, reading] : poll_all(found))
    EXPECT_NE(reading.status, PollStatus::gone) << name;
  EXPECT_THAT(verdict(found), Not(HasSubstr("\n")));
}

INSTANTIATE_TEST_SUITE_P(All, Machine, testing::ValuesIn(machines()), [](const auto& machine) {
  std::string name = machine.param;
  for (char& c : name)
    if (c == '-') c = '_';
  return name;
});

TEST(Machines, AreThere) { EXPECT_GE(machines().size(), 5u); }

int64_t file_value(const std::string& machine, const std::string& file) {
  int64_t value = 0;
  std::ifstream(Tree::machine_dir(machine) / file) >> value;
  return value;
}

TEST(RaptorLakeLaptop, ReadsPowercapAsItStands) {
  const std::string machine = "intel-rplp-i915-laptop";
  const Discovery found = discover(Root(Tree::machine_dir(machine).string()));
  auto readings = poll_all(found);
  const std::string zones = "sys/devices/virtual/powercap/intel-rapl/";
  for (const auto& [name, file] : std::map<std::string, std::string>{
           {"rapl.package-0.energy", "intel-rapl:0/energy_uj"},
           {"rapl.core.energy", "intel-rapl:0/intel-rapl:0:0/energy_uj"},
           {"rapl.uncore.energy", "intel-rapl:0/intel-rapl:0:1/energy_uj"},
           {"rapl.psys.energy", "intel-rapl:1/energy_uj"}}) {
    EXPECT_EQ(readings[name].status, PollStatus::ok) << name;
    EXPECT_EQ(readings[name].value, file_value(machine, zones + file)) << name;
    const Channel channel = channel_called(found, name);
    EXPECT_EQ(channel.wrap_at, 262'143'328'850);
    EXPECT_EQ(channel.unit, Unit::microjoule);
    EXPECT_EQ(channel.kind, Kind::cumulative);
    EXPECT_EQ(channel.period_ns, 1'000'000);
  }
  EXPECT_EQ(readings["rapl.package-0.pl1"].value, 35'000'000);  // min(45, 35)
  EXPECT_EQ(readings["rapl.package-0.pl2"].value, 64'000'000);  // min(115, 64)
  EXPECT_EQ(readings["rapl.package-0.pl4"].value, 215'000'000);
  EXPECT_EQ(readings.count("rapl.psys.pl1"), 0u);  // 0: never set
}

TEST(RaptorLakeLaptop, GivesTheExpectedPowerBetweenTwoSteps) {
  const Tree tree("intel-rplp-i915-laptop");
  const Discovery found = discover(tree.root());
  auto t0 = poll_all(found);
  tree.overlay("intel-rplp-i915-laptop", "t1");
  auto t1 = poll_all(found);
  // EXPECTED.tsv, dt = 1 s: watts as microjoules per second.
  for (const auto& [name, power_uw] :
       std::map<std::string, int64_t>{{"rapl.package-0.energy", 35'012'000},
                                      {"rapl.core.energy", 6'010'000},
                                      {"rapl.uncore.energy", 21'040'000},
                                      {"rapl.psys.energy", 52'300'000}}) {
    EXPECT_EQ(t1[name].value - t0[name].value, power_uw) << name;
    EXPECT_GT(t1[name].t_ns, t0[name].t_ns) << name;
  }
  EXPECT_EQ(t0["hwmon.coretemp.package_id_0.temp"].value, 28000);
  EXPECT_EQ(t1["hwmon.coretemp.package_id_0.temp"].value, 97000);
}

TEST(RaptorLakeLaptop, HasItsOtherSensors) {
  const std::string machine = "intel-rplp-i915-laptop";
  const Discovery found = discover(Root(Tree::machine_dir(machine).string(), read_errors(machine)));
  auto readings = poll_all(found);
  EXPECT_EQ(readings["thermal.x86_pkg_temp.temp"].value, 53000);
  EXPECT_EQ(readings["thermal.cooling.intel_powerclamp.state"].value, -1);
  EXPECT_EQ(readings.count("thermal.cooling.tcc_offset.state"), 0u);
  EXPECT_EQ(readings["cpufreq.cpu12.freq"].value, 1'799'990);
  EXPECT_EQ(readings["hwmon.coretemp.core_31.temp"].value, 27000);
  EXPECT_EQ(readings["proc.stat.steal"].value, 0);
  EXPECT_EQ(readings["psi.io.full"].value, 25);
  EXPECT_EQ(channel_called(found, "hwmon.coretemp.package_id_0.temp").period_ns, 1'000'000'000);
  const auto missing = [](const std::string& source, const std::string& reason) {
    return Contains(
        AllOf(Field(&Missing::source, source), Field(&Missing::reason, HasSubstr(reason))));
  };
  EXPECT_THAT(found.missing, missing("thermal", "No data available"));
  EXPECT_THAT(found.missing, missing("thermal", "INT3400"));
  EXPECT_THAT(found.missing, missing("cgroup", "quota"));
  EXPECT_THAT(found.missing, missing("perf", "not under --root"));
  EXPECT_THAT(verdict(found), AllOf(HasSubstr("energy (rapl.package-0.energy"),
                                    HasSubstr("GPU throttling (i915.gt0.throttle.status"),
                                    HasSubstr("Cannot: cache misses, memory traffic")));
}

TEST(PhoenixApu, WrapsAtTheRangeOfItsOwnCounter) {
  const Tree tree("amd-phoenix-apu");
  const Discovery found = discover(tree.root());
  auto t0 = poll_all(found);
  tree.overlay("amd-phoenix-apu", "t1-wrap");
  auto t1 = poll_all(found);
  const std::string name = "rapl.package-0.energy";
  const Channel channel = channel_called(found, name);
  ASSERT_TRUE(channel.wrap_at.has_value());
  // EXPECTED.tsv: 60.986 W over 10 s, one wrap.
  EXPECT_EQ(t1[name].value - t0[name].value + *channel.wrap_at, 609'860'834);
  EXPECT_EQ(t0["hwmon.amdgpu.ppt.power"].value, 3'142'000);
  EXPECT_EQ(t0["hwmon.amdgpu.ppt.power_average"].value, 3'103'000);
  EXPECT_EQ(t0["hwmon.amdgpu.sclk.freq"].value, 800'000'000);
  EXPECT_EQ(t0["hwmon.k10temp.tctl.temp"].value, 36125);
}

TEST(JetsonOrinNano, MultipliesVoltageAndCurrentOfItsRails) {
  const std::string machine = "jetson-orin-nano";
  const Discovery found = discover(Root(Tree::machine_dir(machine).string(), read_errors(machine)));
  auto readings = poll_all(found);
  EXPECT_EQ(readings["hwmon.ina3221.vdd_in.power"].value, 4976 * 1240);         // 6.170 W
  EXPECT_EQ(readings["hwmon.ina3221.vdd_cpu_gpu_cv.power"].value, 4968 * 312);  // 1.550 W
  EXPECT_EQ(readings["thermal.gpu-thermal.temp"].value, 47812);
  EXPECT_EQ(readings["thermal.cv0-thermal.temp"].status, PollStatus::retry);  // powered off
}

TEST(RaspberryPi4, ReadsItsOneZoneAndPolicy) {
  const Discovery found = discover(Root(Tree::machine_dir("rpi4-v3d-board").string()));
  auto readings = poll_all(found);
  EXPECT_EQ(readings["thermal.bcm2835_thermal.temp"].value, 49925);
  EXPECT_EQ(readings["hwmon.cpu_thermal.temp1.temp"].value, 49925);
  EXPECT_EQ(readings["cpufreq.cpu0.freq"].value, 600'000);
}

TEST(XeonServer, CountsEachPackageOnItsOwn) {
  const std::string machine = "intel-xeon-2s-server";
  const Tree tree(machine);
  const Discovery found = discover(tree.root());
  auto t0 = poll_all(found);
  tree.overlay(machine, "t1");
  auto t1 = poll_all(found);
  const auto difference = [&](const std::string& name) {
    int64_t rise = t1[name].value - t0[name].value;
    if (rise < 0) rise += channel_called(found, name).wrap_at.value_or(0);
    return rise;
  };
  // EXPECTED.tsv, dt = 1 s: watts as microjoules per second.
  EXPECT_EQ(difference("rapl.package-0.energy"), 120'000'000);
  EXPECT_EQ(difference("rapl.package-1.energy"), 95'500'000);  // over the counter's end
  EXPECT_EQ(difference("rapl.package-0.dram.energy"), 12'250'000);
  EXPECT_EQ(channel_called(found, "rapl.package-0.dram.energy").wrap_at, 65'712'999'613);
  EXPECT_EQ(difference("cpu.package-1.throttle.count"), 2);
  EXPECT_EQ(difference("cpu.package-1.throttle.time"), 33);
  EXPECT_EQ(difference("cpu.package-0.throttle.count"), 0);
  for (const char* limit : {"rapl.package-0.pl1", "rapl.package-1.pl1"})
    EXPECT_EQ(t0[limit].value, 350'000'000);
  EXPECT_EQ(t0.count("rapl.psys.pl1"), 0u);
}

TEST(XeonServer, HasAMeterASupplyAndMemoryControllers) {
  const Discovery found = discover(Root(Tree::machine_dir("intel-xeon-2s-server").string()));
  auto readings = poll_all(found);
  EXPECT_EQ(readings["hwmon.power_meter.power1.power_average"].value, 412'000'000);
  EXPECT_EQ(channel_called(found, "hwmon.power_meter.power1.power_average").limit, 900'000'000);
  EXPECT_EQ(readings["hwmon.pfe1100.pin.power"].value, 414'000'000);
  EXPECT_EQ(readings["hwmon.pfe1100.pout1.power"].value, 391'000'000);
  EXPECT_EQ(readings["hwmon.coretemp@coretemp_1.package_id_1.temp"].value, 62'000);
  EXPECT_THAT(found.missing,
              Contains(Field(&Missing::reason, HasSubstr("uncore.imc.read, uncore.imc.write"))));
}

TEST(B580Desktop, TellsItsTwoGpusApart) {
  const std::string machine = "intel-b580-desktop";
  const Tree tree(machine);
  const Discovery found = discover(tree.root());
  auto t0 = poll_all(found);
  tree.overlay(machine, "t1");
  auto t1 = poll_all(found);
  // EXPECTED.tsv, dt = 1 s.
  EXPECT_EQ(t1["hwmon.xe.pkg.energy"].value - t0["hwmon.xe.pkg.energy"].value, 118'500'000);
  EXPECT_EQ(t1["rapl.uncore.energy"].value - t0["rapl.uncore.energy"].value, 250'000);
  EXPECT_EQ(t0.count("hwmon.xe.card.energy"), 0u);
  EXPECT_EQ(t0["hwmon.xe.card.power_limit"].value, 190'000'000);
  EXPECT_EQ(t0["xe.gt0.act_freq"].value, 2740);
  EXPECT_EQ(t0["xe.gt0.requested_freq"].value, 2850);
  std::vector<std::string> throttled;
  for (const auto& [name, reading] : t0) {
    const Channel channel = channel_called(found, name);
    if (channel.quantity == Quantity::throttle && reading.value != 0) throttled.push_back(name);
    if (name.starts_with("xe.") || name.starts_with("hwmon.xe.")) {
      EXPECT_EQ(channel.gpu, "0000:03:00.0") << name;
    } else if (name.starts_with("i915.")) {
      EXPECT_EQ(channel.gpu, "0000:00:02.0") << name;
    }
  }
  EXPECT_THAT(throttled, testing::ElementsAre("xe.gt0.throttle.fancy_new", "xe.gt0.throttle.pl1",
                                              "xe.gt0.throttle.status"));
}

TEST(Rk3588Board, IsHeldBackByItsHeat) {
  const Discovery found = discover(Root(Tree::machine_dir("rockchip-rk3588-board").string()));
  auto readings = poll_all(found);
  const std::string gpu = "devfreq.fb000000_gpu.";
  for (const auto& [name, value] :
       std::map<std::string, int64_t>{{gpu + "freq", 900'000'000},
                                      {gpu + "throttle.clamp", 1},
                                      {gpu + "load", 78},
                                      {gpu + "time_at.300000000", 10'000},
                                      {gpu + "time_at.900000000", 2000},
                                      {gpu + "time_at.1000000000", 777},
                                      {gpu + "transitions", 19},
                                      {"thermal.gpu-thermal.temp", 86'000},
                                      {"thermal.cooling.devfreq-fb000000_gpu.state", 1}})
    EXPECT_EQ(readings[name].value, value) << name;
  EXPECT_EQ(channel_called(found, gpu + "freq").limit, 1'000'000'000);
  EXPECT_EQ(channel_called(found, "thermal.gpu-thermal.temp").limit, 75'000);
  EXPECT_EQ(channel_called(found, "thermal.cooling.devfreq-fb000000_gpu.state").limit, 7);
  EXPECT_EQ(readings.count("thermal.npu-thermal.temp"), 0u);
  for (const auto& [name, reading] : readings) {
    const Quantity quantity = channel_called(found, name).quantity;
    EXPECT_TRUE(quantity != Quantity::energy && quantity != Quantity::power) << name;
  }
}

TEST(VirtualMachine, HasNothingButInterference) {
  const Discovery found = discover(Root(Tree::machine_dir("vm-no-sensors").string()));
  for (const auto& source : found.sources)
    for (const Channel& channel : source->channels())
      EXPECT_TRUE(channel.quantity == Quantity::interference ||
                  channel.quantity == Quantity::utilization)
          << channel.name;
  EXPECT_EQ(poll_all(found)["proc.stat.steal"].value, 55231);
  EXPECT_THAT(verdict(found),
              AllOf(HasSubstr("joules per ray will be refused"), HasSubstr("proc.stat.steal")));
}

}  // namespace
}  // namespace energyprof::probe
