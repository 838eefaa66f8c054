// Each file source on small machines written from a table: what is there, broken, absent or odd.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cerrno>

#include "core/clock.h"
#include "tree.h"

namespace energyprof::probe {
namespace {

using testing::AllOf;
using testing::Contains;
using testing::ElementsAre;
using testing::Field;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;
using testing::SizeIs;
using testing::UnorderedElementsAre;

Discovery discover_only(const Root& root, const std::string& source) {
  return discover(root, Selection{{source}});
}

auto missing_because(const std::string& reason, const std::string& fix) {
  return Contains(
      AllOf(Field(&Missing::reason, HasSubstr(reason)), Field(&Missing::fix, HasSubstr(fix))));
}

// Not root while it lives: root reads what nobody else may.
class Unprivileged {
 public:
  Unprivileged() { changed_ = geteuid() == 0 && seteuid(65534) == 0; }
  ~Unprivileged() {
    if (changed_ && seteuid(0) != 0) abort();
  }
  Unprivileged(const Unprivileged&) = delete;
  Unprivileged& operator=(const Unprivileged&) = delete;

 private:
  bool changed_ = false;
};

const std::string rapl = "sys/class/powercap/";

TEST(Powercap, NamesTheSameDomainsOfSeveralPackagesApart) {
  const Tree tree{{rapl + "intel-rapl:9/name", "package-9\n"},
                  {rapl + "intel-rapl:9/energy_uj", "1\n"},
                  {rapl + "intel-rapl:9:0/name", "dram\n"},
                  {rapl + "intel-rapl:9:0/energy_uj", "2\n"},
                  {rapl + "intel-rapl:a/name", "package-10-die-1\n"},
                  {rapl + "intel-rapl:a/energy_uj", "3\n"},
                  {rapl + "intel-rapl:a:0/name", "dram\n"},
                  {rapl + "intel-rapl:a:0/energy_uj", "4\n"}};
  const Discovery found = discover_only(tree.root(), "powercap");
  auto readings = poll_all(found);
  EXPECT_THAT(
      names_of(found),
      UnorderedElementsAre("rapl.package-9.energy", "rapl.package-9.dram.energy",
                           "rapl.package-10-die-1.energy", "rapl.package-10-die-1.dram.energy"));
  EXPECT_EQ(readings["rapl.package-9.dram.energy"].value, 2);
  EXPECT_EQ(readings["rapl.package-10-die-1.energy"].value, 3);
  EXPECT_EQ(readings["rapl.package-10-die-1.dram.energy"].value, 4);
}

TEST(Powercap, FindsZonesWhereACopyHasThemInsideTheirControlOnly) {
  const std::string control = rapl + "intel-rapl/";
  const Tree tree{{control + "enabled", "1\n"},
                  {control + "intel-rapl:0/name", "package-0\n"},
                  {control + "intel-rapl:0/energy_uj", "1\n"},
                  {control + "intel-rapl:0/intel-rapl:0:1/name", "uncore\n"},
                  {control + "intel-rapl:0/intel-rapl:0:1/energy_uj", "2\n"}};
  const Discovery found = discover_only(tree.root(), "powercap");
  EXPECT_THAT(names_of(found), ElementsAre("rapl.package-0.energy", "rapl.uncore.energy"));
  EXPECT_EQ(poll_all(found)["rapl.uncore.energy"].value, 2);
}

TEST(Powercap, RecordsEnergyOnceHoweverManyZonesLeadToIt) {
  const Tree tree{{rapl + "intel-rapl-mmio:0/name", "package-0\n"},
                  {rapl + "intel-rapl-mmio:0/energy_uj", "11\n"},
                  {rapl + "intel-rapl:0/name", "package-0\n"},
                  {rapl + "intel-rapl:0/energy_uj", "10\n"}};
  const Discovery found = discover_only(tree.root(), "powercap");
  EXPECT_THAT(names_of(found), ElementsAre("rapl.package-0.energy"));
  EXPECT_EQ(poll_all(found)["rapl.package-0.energy"].value, 10);
  EXPECT_THAT(found.missing, IsEmpty());
}

TEST(Powercap, FallsBackToTheOtherZone) {
  const Tree tree{{rapl + "intel-rapl-mmio:0/name", "package-0\n"},
                  {rapl + "intel-rapl-mmio:0/energy_uj", "11\n"},
                  {rapl + "intel-rapl:0/name", "package-0\n"},
                  {rapl + "intel-rapl:0/energy_uj", "\n"}};
  const Discovery found = discover_only(tree.root(), "powercap");
  EXPECT_EQ(poll_all(found)["rapl.package-0.energy"].value, 11);
}

TEST(Powercap, GivesTheCommandThatOpensForbiddenCounters) {
  const Tree tree{
      {rapl + "intel-rapl:0/name", "package-0\n"}, {rapl + "intel-rapl:0/energy_uj", "1\n"},
      {rapl + "intel-rapl:0:0/name", "core\n"},    {rapl + "intel-rapl:0:0/energy_uj", "2\n"},
      {rapl + "intel-rapl:0:1/name", "uncore\n"},  {rapl + "intel-rapl:0:1/energy_uj", "3\n"}};
  const std::string package = tree.path() + "/" + rapl + "intel-rapl:0/energy_uj";
  const std::string core = tree.path() + "/" + rapl + "intel-rapl:0:0/energy_uj";
  for (const std::string& file : {package, core})
    std::filesystem::permissions(file, std::filesystem::perms::none);
  const Discovery found = [&] {
    const Unprivileged unprivileged;
    return discover_only(tree.root(), "powercap");
  }();
  EXPECT_THAT(names_of(found), ElementsAre("rapl.uncore.energy"));
  ASSERT_THAT(found.missing, SizeIs(1));
  EXPECT_THAT(found.missing[0].reason, HasSubstr("Permission denied"));
  EXPECT_EQ(found.missing[0].fix, "sudo chmod a+r " + package + " " + core);
}

TEST(Discover, SaysWhichDirectoriesItMayNotLookInto) {
  const Tree tree{{rapl + "intel-rapl:0/name", "package-0\n"},
                  {rapl + "intel-rapl:0/energy_uj", "1\n"},
                  {rapl + "intel-rapl:1/name", "psys\n"},
                  {rapl + "intel-rapl:1/energy_uj", "2\n"},
                  {"sys/class/hwmon/hwmon0/name", "coretemp\n"},
                  {"sys/class/hwmon/hwmon0/temp1_input", "40000\n"},
                  {"sys/class/thermal/thermal_zone0/temp", "40000\n"}};
  const auto permit = [&](std::filesystem::perms permissions) {
    for (const char* directory : {"powercap/intel-rapl:0", "hwmon/hwmon0", "thermal"})
      std::filesystem::permissions(tree.path() + "/sys/class/" + directory, permissions);
  };
  permit(std::filesystem::perms::none);
  const Discovery found = [&] {
    const Unprivileged unprivileged;
    return discover(tree.root(), Selection{{"powercap", "hwmon", "thermal"}});
  }();
  permit(std::filesystem::perms::owner_all);  // for who removes the tree
  EXPECT_THAT(names_of(found), ElementsAre("rapl.psys.energy"));
  EXPECT_THAT(found.missing,
              missing_because("cannot enter '" + tree.path() + "/" + rapl + "intel-rapl:0'", ""));
  EXPECT_THAT(found.missing, missing_because("hwmon0': Permission denied", ""));
  EXPECT_THAT(found.missing, missing_because("cannot list", "sudo chmod a+rx " + tree.path() +
                                                                "/sys/class/thermal"));
}

TEST(Powercap, SaysWhatIsWrongWithAZone) {
  const Tree tree{{rapl + "intel-rapl:0/name", "package-0\n"},
                  {rapl + "intel-rapl:0/energy_uj", "99999999999999999999\n"},
                  {rapl + "intel-rapl:0:0/name", "core\n"},
                  {rapl + "intel-rapl:0:0/energy_uj", "text\n"},
                  {rapl + "intel-rapl:0:1/name", "uncore\n"},
                  {rapl + "intel-rapl:0:2/name", "dram\n"},
                  {rapl + "intel-rapl:0:2/energy_uj", "5\n"},
                  {rapl + "intel-rapl:0:2/max_energy_range_uj", "0\n"}};
  const Discovery found = discover_only(tree.root(), "powercap");
  EXPECT_THAT(names_of(found), ElementsAre("rapl.dram.energy"));
  EXPECT_EQ(channel_called(found, "rapl.dram.energy").wrap_at, std::nullopt);
  EXPECT_THAT(found.missing, missing_because("63 bits", ""));
  EXPECT_THAT(found.missing, missing_because("'text'", ""));
  EXPECT_THAT(found.missing, missing_because("No such file", ""));
}

TEST(Powercap, TakesTheLowestLimitThatIsInForce) {
  const Tree tree;
  struct Row {
    std::string zone, enabled, limit_uw;
  };
  for (const Row& row :
       {Row{"intel-rapl:0", "1", "45000000"}, Row{"intel-rapl-mmio:0", "1", "35000000"},
        Row{"intel-rapl-tpmi:0", "0", "10000000"}})
    tree.write({{rapl + row.zone + "/name", "package-0\n"},
                {rapl + row.zone + "/energy_uj", "1\n"},
                {rapl + row.zone + "/enabled", row.enabled},
                {rapl + row.zone + "/constraint_0_name", "short_term\n"},
                {rapl + row.zone + "/constraint_0_power_limit_uw", "0\n"},
                {rapl + row.zone + "/constraint_1_name", "long_term\n"},
                {rapl + row.zone + "/constraint_1_power_limit_uw", row.limit_uw}});
  const Discovery found = discover_only(tree.root(), "powercap");
  EXPECT_THAT(names_of(found), ElementsAre("rapl.package-0.energy", "rapl.package-0.pl1"));
  EXPECT_EQ(poll_all(found)["rapl.package-0.pl1"].value, 35'000'000);
  EXPECT_THAT(
      channel_called(found, "rapl.package-0.pl1").origin,
      AllOf(HasSubstr("intel-rapl:0/"), HasSubstr("intel-rapl-mmio:0/"), Not(HasSubstr("tpmi"))));

  // The other zone takes over while the run goes on; a limit of 0 limits nothing.
  tree.write({{rapl + "intel-rapl:0/constraint_1_power_limit_uw", "15000000\n"}});
  EXPECT_EQ(poll_all(found)["rapl.package-0.pl1"].value, 15'000'000);
  tree.write({{rapl + "intel-rapl:0/constraint_1_power_limit_uw", "0\n"}});
  EXPECT_EQ(poll_all(found)["rapl.package-0.pl1"].value, 35'000'000);
}

TEST(Powercap, ExplainsWhyThereIsNone) {
  const Tree machine{{"proc/cpuinfo", "vendor_id\t: GenuineIntel\nflags\t: fpu vme\n"}};
  EXPECT_THAT(discover_only(machine.root(), "powercap").missing,
              missing_because("on that machine: sudo modprobe intel_rapl_msr", ""));
  const Tree guest{{"proc/cpuinfo", "vendor_id\t: GenuineIntel\nflags\t: fpu hypervisor\n"}};
  const Discovery in_guest = discover_only(guest.root(), "powercap");
  ASSERT_THAT(in_guest.missing, SizeIs(1));
  EXPECT_THAT(in_guest.missing[0].reason, HasSubstr("virtual machine"));
  EXPECT_EQ(in_guest.missing[0].fix, "");
  const Tree container;
  container.link(rapl + "intel-rapl:0", "../../devices/virtual/powercap/intel-rapl/intel-rapl:0");
  EXPECT_THAT(discover_only(container.root(), "powercap").missing,
              missing_because("mask it; on that machine: docker run --security-opt", ""));
}

const std::string chips = "sys/class/hwmon/";

TEST(Hwmon, TellsEqualChipsApartByTheirDevice) {
  const Tree tree{{"sys/devices/0000:01:00.0/hwmon/hwmon3/name", "nvme\n"},
                  {"sys/devices/0000:01:00.0/hwmon/hwmon3/temp1_label", "Composite\n"},
                  {"sys/devices/0000:01:00.0/hwmon/hwmon3/temp1_input", "-5000\n"},
                  {"sys/devices/0000:02:00.0/hwmon/hwmon4/name", "nvme\n"},
                  {"sys/devices/0000:02:00.0/hwmon/hwmon4/temp1_label", "Composite\n"},
                  {"sys/devices/0000:02:00.0/hwmon/hwmon4/temp1_input", "31850\n"},
                  {chips + "hwmon5/name", "nvme\n"},
                  {chips + "hwmon5/temp1_input", "1\n"}};
  tree.link(chips + "hwmon3", "../../devices/0000:01:00.0/hwmon/hwmon3");
  tree.link(chips + "hwmon4", "../../devices/0000:02:00.0/hwmon/hwmon4");
  tree.link("sys/devices/0000:01:00.0/hwmon/hwmon3/device", "../../../0000:01:00.0");
  tree.link("sys/devices/0000:02:00.0/hwmon/hwmon4/device", "../../../0000:02:00.0");
  const Discovery found = discover_only(tree.root(), "hwmon");
  EXPECT_THAT(names_of(found), ElementsAre("hwmon.nvme@0000:01:00_0.composite.temp",
                                           "hwmon.nvme@0000:02:00_0.composite.temp",
                                           "hwmon.nvme@hwmon5.temp1.temp"));
  EXPECT_EQ(poll_all(found)["hwmon.nvme@0000:01:00_0.composite.temp"].value, -5000);
  EXPECT_EQ(found.sources[0]->period_ns(), ns_per_s);
}

TEST(Hwmon, CallsAChipWithoutANameByItsDevice) {
  const Tree tree{{"sys/class/hwmon/hwmon0/temp1_input", "40000\n"}};
  tree.link("sys/class/hwmon/hwmon0/device", "../../../chip.0");  // not there
  EXPECT_THAT(names_of(discover_only(tree.root(), "hwmon")),
              ElementsAre("hwmon.chip_0.temp1.temp"));
}

TEST(Hwmon, NamesWhatHasALabelWithoutLettersAfterItsSensor) {
  const Tree tree{{"sys/class/hwmon/hwmon0/name", "chip\n"},
                  {"sys/class/hwmon/hwmon0/temp1_input", "40000\n"},
                  {"sys/class/hwmon/hwmon0/temp1_label", "\xe6\xb8\xa9\n"},
                  {"sys/class/hwmon/hwmon0/temp2_input", "41000\n"},
                  {"sys/class/hwmon/hwmon0/temp2_label", "--\n"}};
  EXPECT_THAT(names_of(discover_only(tree.root(), "hwmon")),
              ElementsAre("hwmon.chip.temp1.temp", "hwmon.chip.temp2.temp"));
}

TEST(Hwmon, DoesNotTakeALimitThatNothingReaches) {
  const Tree tree{{"sys/class/hwmon/hwmon0/name", "nvme\n"},
                  {"sys/class/hwmon/hwmon0/temp1_input", "42850\n"},
                  {"sys/class/hwmon/hwmon0/temp1_max", "65261850\n"},
                  {"sys/class/hwmon/hwmon0/temp2_input", "42850\n"},
                  {"sys/class/hwmon/hwmon0/temp2_max", "81850\n"}};
  const Discovery found = discover_only(tree.root(), "hwmon");
  EXPECT_EQ(channel_called(found, "hwmon.nvme.temp1.temp").limit, std::nullopt);
  EXPECT_EQ(channel_called(found, "hwmon.nvme.temp2.temp").limit, 81'850);
}

TEST(Hwmon, DoesNotBelieveInputsWhereNothingIsConnected) {
  const Tree tree{{"sys/class/hwmon/hwmon0/name", "nct6775\n"},
                  {"sys/class/hwmon/hwmon0/temp1_input", "-62000\n"},
                  {"sys/class/hwmon/hwmon0/temp2_input", "216000\n"},
                  {"sys/class/hwmon/hwmon0/temp3_input", "25000\n"},
                  {"sys/class/hwmon/hwmon0/temp3_fault", "1\n"},
                  {"sys/class/hwmon/hwmon0/temp4_input", "-5000\n"},
                  {"sys/class/hwmon/hwmon0/temp4_fault", "0\n"},
                  {"sys/class/hwmon/hwmon0/temp5_input", "127500\n"},
                  {"sys/class/hwmon/hwmon0/temp6_input", "0\n"},
                  {"sys/class/hwmon/hwmon0/temp7_input", "0\n"},
                  {"sys/class/hwmon/hwmon0/temp8_input", "0\n"}};
  const Discovery found = discover_only(tree.root(), "hwmon");
  EXPECT_THAT(names_of(found), ElementsAre("hwmon.nct6775.temp4.temp"));
  EXPECT_THAT(found.missing, missing_because("127.5 C", ""));
  EXPECT_THAT(found.missing,
              missing_because("temp6_input' reads 0 C: it is not measuring, and 2 more", ""));
  EXPECT_THAT(found.missing, missing_because("-62 C", ""));
  EXPECT_THAT(found.missing, missing_because("216 C", ""));
  EXPECT_THAT(found.missing, missing_because("faulty", ""));
}

TEST(Hwmon, FindsFilesThatTheDriverPutAtTheDevice) {
  const std::string meter = "sys/devices/ACPI000D:00/";  // as before Linux 6.15
  const Tree tree{{meter + "name", "power_meter\n"},
                  {meter + "power1_average", "412000000\n"},
                  {meter + "power1_cap", "900000000\n"},
                  {meter + "power1_alarm", "0\n"},
                  {meter + "hwmon/hwmon2/uevent", ""},
                  {"sys/devices/1-0040/name", "ina219\n"},  // of the device, not the chip
                  {"sys/devices/1-0040/hwmon/hwmon3/power1_input", "5000000\n"}};
  tree.link(meter + "hwmon/hwmon2/device", "../../../ACPI000D:00");
  tree.link("sys/devices/1-0040/hwmon/hwmon3/device", "../../../1-0040");
  tree.link(chips + "hwmon2", "../../devices/ACPI000D:00/hwmon/hwmon2");
  tree.link(chips + "hwmon3", "../../devices/1-0040/hwmon/hwmon3");
  const Discovery found = discover_only(tree.root(), "hwmon");
  EXPECT_THAT(names_of(found),
              UnorderedElementsAre("hwmon.power_meter.power1.power_average",
                                   "hwmon.power_meter.power1.alarm", "hwmon.ina219.power1.power"));
  EXPECT_EQ(poll_all(found)["hwmon.power_meter.power1.power_average"].value, 412'000'000);
  EXPECT_EQ(channel_called(found, "hwmon.power_meter.power1.power_average").limit, 900'000'000);
}

TEST(Hwmon, LeavesThePowerOfABatteryToTheBattery) {
  // Since Linux 6.11; positive while it charges, of either sign with some drivers.
  const std::string battery = "sys/devices/pmic/power_supply/qcom-battmgr-bat/";
  const Tree tree{{battery + "hwmon1/name", "qcom_battmgr_bat\n"},
                  {battery + "hwmon1/power1_input", "-9876000\n"},
                  {battery + "hwmon1/in1_input", "15000\n"},
                  {battery + "hwmon1/curr1_input", "-640\n"},
                  {battery + "hwmon1/temp1_input", "31200\n"},
                  {battery + "type", "Battery\n"}};
  tree.link(battery + "hwmon1/device", "../../qcom-battmgr-bat");
  tree.link("sys/class/power_supply/qcom-battmgr-bat",
            "../../devices/pmic/power_supply/qcom-battmgr-bat");
  tree.link(chips + "hwmon1", "../../devices/pmic/power_supply/qcom-battmgr-bat/hwmon1");
  const Discovery found = discover_only(tree.root(), "hwmon");
  EXPECT_THAT(names_of(found), ElementsAre("hwmon.qcom_battmgr_bat.temp1.temp"));
  EXPECT_THAT(found.missing, missing_because("the source battery", ""));
}

TEST(Hwmon, FindsTheChipOfACardInACopyWithoutTheClass) {
  const std::string chip = "sys/class/drm/card1/device/hwmon/hwmon6/";
  const Tree tree{{"sys/class/drm/card1/device/uevent", "PCI_SLOT_NAME=0000:03:00.0\n"},
                  {chip + "name", "amdgpu\n"},
                  {chip + "temp1_input", "41000\n"}};
  Discovery found = discover_only(tree.root(), "hwmon");
  EXPECT_THAT(names_of(found), ElementsAre("hwmon.amdgpu.temp1.temp"));
  EXPECT_EQ(found.sources.front()->traits().gpu, "0000:03:00.0");
  // A copy that followed the links has it twice.
  tree.write({{chips + "hwmon6/name", "amdgpu\n"}, {chips + "hwmon6/temp1_input", "41000\n"}});
  EXPECT_THAT(names_of(discover_only(tree.root(), "hwmon")),
              ElementsAre("hwmon.amdgpu.temp1.temp"));
}

TEST(Hwmon, ListsAChipOnceThatTheClassHasTwice) {
  const Tree tree{{"sys/devices/chip/hwmon/hwmon0/name", "chip\n"},
                  {"sys/devices/chip/hwmon/hwmon0/temp1_input", "40000\n"},
                  {"sys/devices/chip/hwmon/hwmon0/temp-2_input", "41000\n"}};
  tree.link(chips + "hwmon0", "../../devices/chip/hwmon/hwmon0");
  tree.link(chips + "hwmon7", "../../devices/chip/hwmon/hwmon0");
  EXPECT_THAT(names_of(discover_only(tree.root(), "hwmon")), ElementsAre("hwmon.chip.temp1.temp"));
}

TEST(FileSource, LeavesOutWhatCannotBe) {
  const std::string card = "sys/class/drm/card0/device/";
  const Tree tree{{rapl + "intel-rapl:0/name", "package-0\n"},
                  {rapl + "intel-rapl:0/energy_uj", "-1\n"},
                  {card + "uevent", "DRIVER=amdgpu\n"},
                  {card + "gpu_busy_percent", "101\n"},
                  {"sys/class/drm/card1/device/uevent", "DRIVER=i915\n"},
                  {"sys/class/drm/card1/gt_act_freq_mhz", "4294967295\n"},
                  {"sys/class/drm/card1/gt_cur_freq_mhz", "300\n"},
                  {"sys/class/drm/card1/gt_RP0_freq_mhz", "0\n"},
                  {chips + "hwmon0/name", "chip\n"},
                  {chips + "hwmon0/power1_input", "4000000000000\n"},
                  {chips + "hwmon0/power1_crit_alarm", "2\n"},
                  {chips + "hwmon0/power2_input", "-1000000\n"}};
  const Discovery found = discover(tree.root(), Selection{{"powercap", "i915", "amdgpu", "hwmon"}});
  EXPECT_THAT(names_of(found), UnorderedElementsAre("i915.gt0.requested_freq", "i915.gt0.rp0_freq",
                                                    "hwmon.chip.power2.power"));
  EXPECT_EQ(channel_called(found, "i915.gt0.requested_freq").limit, std::nullopt);
  for (const char* reason :
       {"reads -1 uJ, which cannot be", "101 %", "4294967295 MHz", "4000000000000 uW", "2 count"})
    EXPECT_THAT(found.missing, missing_because(reason, ""));
  // Later it is no sample.
  tree.write({{"sys/class/drm/card1/gt_cur_freq_mhz", "-1\n"}});
  EXPECT_EQ(poll_all(found)["i915.gt0.requested_freq"].status, PollStatus::retry);
}

TEST(Hwmon, CountsHowOftenAJetsonThrottledForItsSupply) {
  const Tree tree{{"sys/class/hwmon/hwmon3/name", "soctherm_oc\n"},
                  {"sys/class/hwmon/hwmon3/oc1_event_cnt", "0\n"},
                  {"sys/class/hwmon/hwmon3/oc1_throt_en", "1\n"},
                  {"sys/class/hwmon/hwmon3/oc2_event_cnt", "15\n"},
                  {"sys/class/hwmon/hwmon3/oc3_event_cnt", "27390\n"}};
  const Discovery found = discover_only(tree.root(), "hwmon");
  EXPECT_THAT(names_of(found), ElementsAre("hwmon.soctherm_oc.undervoltage.events",
                                           "hwmon.soctherm_oc.overcurrent_average.events",
                                           "hwmon.soctherm_oc.overcurrent_peak.events"));
  EXPECT_EQ(poll_all(found)["hwmon.soctherm_oc.overcurrent_peak.events"].value, 27390);
  const Channel channel = channel_called(found, "hwmon.soctherm_oc.undervoltage.events");
  EXPECT_EQ(channel.quantity, Quantity::throttle);
  EXPECT_EQ(channel.kind, Kind::cumulative);
  EXPECT_TRUE(found.sources.front()->traits().slow);
}

TEST(Hwmon, KnowsTheUnitOfEveryKindOfInput) {
  const Tree tree{{chips + "hwmon0/name", "chip\n"},       {chips + "hwmon0/temp1_input", "1\n"},
                  {chips + "hwmon0/power1_input", "2\n"},  {chips + "hwmon0/power1_average", "3\n"},
                  {chips + "hwmon0/energy1_input", "4\n"}, {chips + "hwmon0/freq1_input", "5\n"},
                  {chips + "hwmon0/fan1_input", "6\n"},    {chips + "hwmon0/in0_input", "7\n"},
                  {chips + "hwmon0/temp1_crit", "8\n"},    {chips + "hwmon0/temp_input", "9\n"}};
  const Discovery found = discover_only(tree.root(), "hwmon");
  EXPECT_THAT(names_of(found),
              UnorderedElementsAre("hwmon.chip.temp1.temp", "hwmon.chip.power1.power",
                                   "hwmon.chip.power1.power_average", "hwmon.chip.energy1.energy",
                                   "hwmon.chip.freq1.freq"));
  EXPECT_EQ(channel_called(found, "hwmon.chip.temp1.temp").unit, Unit::millicelsius);
  EXPECT_EQ(channel_called(found, "hwmon.chip.power1.power").unit, Unit::microwatt);
  EXPECT_EQ(channel_called(found, "hwmon.chip.power1.power_average").kind, Kind::average);
  EXPECT_EQ(channel_called(found, "hwmon.chip.energy1.energy").unit, Unit::microjoule);
  EXPECT_EQ(channel_called(found, "hwmon.chip.energy1.energy").kind, Kind::cumulative);
  EXPECT_EQ(channel_called(found, "hwmon.chip.freq1.freq").unit, Unit::hertz);
  EXPECT_EQ(found.sources[0]->period_ns(), 100 * ns_per_ms);
}

TEST(Hwmon, NamesARepeatedLabelAfterItsSensor) {
  const Tree tree{{chips + "hwmon0/name", "chip\n"},
                  {chips + "hwmon0/temp1_label", "Core\n"},
                  {chips + "hwmon0/temp1_input", "1\n"},
                  {chips + "hwmon0/temp2_label", "Core\n"},
                  {chips + "hwmon0/temp2_input", "2\n"}};
  EXPECT_THAT(names_of(discover_only(tree.root(), "hwmon")),
              ElementsAre("hwmon.chip.core.temp", "hwmon.chip.core_temp2.temp"));
}

TEST(Hwmon, ReportsAChipOrSensorThatGivesNothing) {
  const Tree tree{{chips + "hwmon0/name", "acpi_fan\n"},
                  {chips + "hwmon1/name", "iwlwifi_1\n"},
                  {chips + "hwmon1/temp1_input", ""},
                  {chips + "hwmon2/name", "asleep\n"},
                  {chips + "hwmon2/temp1_input", ""}};
  const Discovery found =
      discover_only(tree.root({{chips + "hwmon2/temp1_input", EAGAIN}}), "hwmon");
  EXPECT_THAT(found.missing, SizeIs(2));
  EXPECT_THAT(found.missing, missing_because("acpi_fan", ""));
  EXPECT_THAT(found.missing, missing_because("temp1_input' is empty", ""));
  EXPECT_THAT(names_of(found), ElementsAre("hwmon.asleep.temp1.temp"));
  EXPECT_EQ(poll_all(found)["hwmon.asleep.temp1.temp"].status, PollStatus::retry);
}

TEST(Hwmon, LosesARailWhenEitherHalfGoes) {
  const Tree tree{{chips + "hwmon0/name", "ina3221\n"},   {chips + "hwmon0/in1_label", "VDD_IN\n"},
                  {chips + "hwmon0/in1_input", "5000\n"}, {chips + "hwmon0/curr1_input", "1000\n"},
                  {chips + "hwmon0/in2_label", "NC\n"},   {chips + "hwmon0/in2_input", "1\n"},
                  {chips + "hwmon0/curr2_input", "1\n"},  {chips + "hwmon0/in3_enable", "0\n"},
                  {chips + "hwmon0/in3_input", "1\n"},    {chips + "hwmon0/curr3_input", "1\n"}};
  const Discovery found = discover_only(tree.root(), "hwmon");
  EXPECT_THAT(names_of(found), ElementsAre("hwmon.ina3221.vdd_in.power"));
  EXPECT_EQ(poll_all(found)["hwmon.ina3221.vdd_in.power"].value, 5'000'000);
  tree.remove(chips + "hwmon0/curr1_input");
  EXPECT_EQ(poll_all(found)["hwmon.ina3221.vdd_in.power"].status, PollStatus::gone);
}

const std::string zones = "sys/class/thermal/";

TEST(Thermal, RefusesZonesThatDoNotMeasure) {
  const Tree tree{{zones + "thermal_zone0/type", "acpitz\n"},
                  {zones + "thermal_zone0/temp", "27800\n"},
                  {zones + "thermal_zone1/type", "acpitz\n"},
                  {zones + "thermal_zone1/temp", "-274000\n"},
                  {zones + "thermal_zone2/type", "INT3400 Thermal\n"},
                  {zones + "thermal_zone2/temp", "20000\n"},
                  {zones + "thermal_zone10/type", "freezer\n"},
                  {zones + "thermal_zone10/temp", "-21000\n"},
                  {zones + "thermal_zone11/type", "off\n"},
                  {zones + "thermal_zone11/temp", ""}};
  const Discovery found =
      discover_only(tree.root({{zones + "thermal_zone11/temp", EINVAL}}), "thermal");
  EXPECT_THAT(names_of(found),
              UnorderedElementsAre("thermal.acpitz-0.temp", "thermal.freezer.temp"));
  EXPECT_EQ(poll_all(found)["thermal.freezer.temp"].value, -21000);
  EXPECT_EQ(channel_called(found, "thermal.acpitz-0.temp").period_ns, 5 * ns_per_s);
  EXPECT_THAT(found.missing, SizeIs(3));
  EXPECT_THAT(found.missing, missing_because("-274 C", ""));
  EXPECT_THAT(found.missing, missing_because("policy", ""));
  EXPECT_THAT(found.missing, missing_because("Invalid argument", ""));
}

TEST(Thermal, DoesNotTakeARadioThatCoolsForThrottling) {
  const Tree tree{{"sys/class/thermal/cooling_device0/type", "iwlwifi\n"},
                  {"sys/class/thermal/cooling_device0/cur_state", "3\n"},
                  {"sys/class/thermal/cooling_device0/max_state", "19\n"}};
  EXPECT_THAT(names_of(discover_only(tree.root(), "thermal")), IsEmpty());
}

TEST(Thermal, TakesCoolingThatSlowsProcessorsAsThrottling) {
  const Tree tree;
  struct Row {
    std::string device, type, now, most;
  };
  for (const Row& row :
       {Row{"0", "Processor", "2", "10"}, Row{"1", "Processor", "0", "10"},
        Row{"2", "intel_powerclamp", "-1", "50"}, Row{"3", "TCC Offset", "3", "63"},
        Row{"4", "pwm-fan", "1", "3"}, Row{"5", "devfreq-17000000.gpu", "0", "0"}})
    tree.write({{zones + "cooling_device" + row.device + "/type", row.type + "\n"},
                {zones + "cooling_device" + row.device + "/cur_state", row.now + "\n"},
                {zones + "cooling_device" + row.device + "/max_state", row.most + "\n"}});
  const Discovery found = discover_only(tree.root(), "thermal");
  EXPECT_THAT(names_of(found), UnorderedElementsAre("thermal.cooling.processor-0.state",
                                                    "thermal.cooling.processor-1.state",
                                                    "thermal.cooling.intel_powerclamp.state"));
  EXPECT_EQ(poll_all(found)["thermal.cooling.processor-0.state"].value, 2);
  EXPECT_EQ(channel_called(found, "thermal.cooling.processor-0.state").quantity,
            Quantity::throttle);
}

TEST(Cpufreq, GivesOneChannelPerPolicyAndSlowsDownForMany) {
  const std::string cpus = "sys/devices/system/cpu/";
  const Tree tree;
  for (int policy = 0; policy < 64; policy += 2)
    tree.write({{cpus + "cpufreq/policy" + std::to_string(policy) + "/scaling_cur_freq",
                 std::to_string(1000 + policy)}});
  tree.write({{cpus + "cpu0/cpufreq/scaling_cur_freq", "1000\n"}, {cpus + "cpufreq/boost", "1\n"}});
  const Discovery found = discover_only(tree.root(), "cpufreq");
  EXPECT_THAT(names_of(found), SizeIs(32));
  EXPECT_EQ(poll_all(found)["cpufreq.cpu62.freq"].value, 1062);
  EXPECT_EQ(found.sources[0]->period_ns(), 20 * ns_per_ms);
}

TEST(ProcStat, NeedsTheEightFieldsOfItsFirstLine) {
  const Tree tree{{"proc/stat", "cpu  1 2 3 4 5 6 7 8 9 10\ncpu0 1 2 3 4 5 6 7 8 9 10\n"}};
  const Discovery found = discover_only(tree.root(), "proc_stat");
  EXPECT_EQ(poll_all(found)["proc.stat.steal"].value, 8);
  EXPECT_EQ(poll_all(found)["proc.stat.busy"].value, 1 + 2 + 3 + 6 + 7);
  for (const char* text : {"", "cpu  1 2 3 4 5 6 7\n", "cpu0 1 2 3 4 5 6 7 8\n", "nonsense"}) {
    tree.write({{"proc/stat", text}});
    EXPECT_EQ(poll_all(found)["proc.stat.steal"].status, PollStatus::retry) << text;
    const Discovery broken = discover_only(tree.root(), "proc_stat");
    EXPECT_THAT(broken.sources, IsEmpty()) << text;
    EXPECT_THAT(broken.missing, SizeIs(1)) << text;
  }
}

TEST(Psi, ReadsTotalsAndSaysWhenItIsOff) {
  const std::string lines =
      "some avg10=0.10 avg60=2.00 avg300=3.85 total=15\n"
      "full avg10=0.20 avg60=3.00 avg300=4.95 total=25\n";
  const Tree tree{{"proc/pressure/cpu", lines},
                  {"proc/pressure/memory", "garbage"},
                  {"proc/pressure/io", lines}};
  const Discovery found = discover_only(tree.root({{"proc/pressure/io", EOPNOTSUPP}}), "psi");
  EXPECT_THAT(names_of(found), ElementsAre("psi.cpu.some"));
  EXPECT_THAT(found.missing,
              missing_because("not supported; on that machine: boot with psi=1", ""));
  EXPECT_THAT(found.missing, missing_because("no line with 'total='", ""));
  const Discovery all = discover_only(tree.root(), "psi");
  EXPECT_THAT(names_of(all), ElementsAre("psi.cpu.some", "psi.io.some", "psi.io.full"));
  EXPECT_EQ(poll_all(all)["psi.io.some"].value, 15);
  EXPECT_EQ(poll_all(all)["psi.io.full"].value, 25);
}

TEST(Cgroup, ReportsEveryLevelThatHasAQuota) {
  const Tree tree{
      {"proc/self/cgroup", "0::/a/b/c\n"},
      {"sys/fs/cgroup/cpu.stat", "usage_usec 1\n"},
      {"sys/fs/cgroup/a/cpu.stat", "nr_periods 9\nnr_throttled 5\nthrottled_usec 500\n"},
      {"sys/fs/cgroup/a/b/cpu.stat", "usage_usec 1\n"},
      {"sys/fs/cgroup/a/b/c/cpu.stat",
       "usage_usec 1\nnr_periods 3\nnr_throttled 2\nthrottled_usec 77\n"}};
  const Discovery found = discover_only(tree.root(), "cgroup");
  EXPECT_THAT(names_of(found),
              ElementsAre("cgroup.cpu.throttled", "cgroup.cpu.throttled_periods",
                          "cgroup.cpu.throttled.parent2", "cgroup.cpu.throttled_periods.parent2"));
  auto readings = poll_all(found);
  EXPECT_EQ(readings["cgroup.cpu.throttled"].value, 77);
  EXPECT_EQ(readings["cgroup.cpu.throttled_periods"].value, 2);
  EXPECT_EQ(readings["cgroup.cpu.throttled.parent2"].value, 500);
  EXPECT_EQ(channel_called(found, "cgroup.cpu.throttled").unit, Unit::microsecond);
}

TEST(Cgroup, CountsNanosecondsInVersionOne) {
  const std::string stat = "nr_periods 3\nnr_throttled 2\nthrottled_time 77000\n";
  const Tree tree{{"proc/self/cgroup", "3:cpuset:/\n2:cpu,cpuacct:/job\n0::/\n"},
                  {"sys/fs/cgroup/cpu,cpuacct/job/cpu.stat", stat}};
  const Discovery found = discover_only(tree.root(), "cgroup");
  EXPECT_EQ(poll_all(found)["cgroup.cpu.throttled"].value, 77000);
  EXPECT_EQ(channel_called(found, "cgroup.cpu.throttled").unit, Unit::nanosecond);
}

TEST(Cgroup, FindsTheControllersInWhateverOrderTheyAreMounted) {
  for (const std::string mounted : {"cpu,cpuacct", "cpuacct,cpu"})
    for (const std::string listed : {"cpu,cpuacct", "cpuacct,cpu"}) {
      const Tree tree{{"proc/self/cgroup", "4:" + listed + ":/a\n0::/a\n"},
                      {"sys/fs/cgroup/" + mounted + "/a/cpu.stat",
                       "nr_periods 9\nnr_throttled 3\nthrottled_time 555\n"}};
      EXPECT_EQ(poll_all(discover_only(tree.root(), "cgroup"))["cgroup.cpu.throttled"].value, 555)
          << mounted << " as " << listed;
    }
}

TEST(Cgroup, TakesTheTopForTheOwnGroupInsideAContainer) {
  const Tree tree{{"proc/self/cgroup", "0::/docker/0123456789abcdef\n"},
                  {"sys/fs/cgroup/cpu.stat", "nr_throttled 4\nthrottled_usec 9\n"}};
  EXPECT_EQ(poll_all(discover_only(tree.root(), "cgroup"))["cgroup.cpu.throttled"].value, 9);
}

TEST(Cgroup, SaysWhenNothingCanThrottle) {
  const Tree tree{{"proc/self/cgroup", "0::/a\n"}, {"sys/fs/cgroup/a/cpu.stat", "usage_usec 1\n"}};
  EXPECT_THAT(discover_only(tree.root(), "cgroup").missing, missing_because("quota", ""));
  EXPECT_THAT(discover_only(Tree().root(), "cgroup").missing, missing_because("No such file", ""));
}

}  // namespace
}  // namespace energyprof::probe
