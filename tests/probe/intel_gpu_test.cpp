// i915 and xe: clocks, throttle reasons, idle time; on captured machines and odd ones.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cerrno>

#include "core/clock.h"
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

const std::string card = "sys/class/drm/card0/";
const std::string xe_freq = card + "device/tile0/gt0/freq0/";

auto missing_because(const std::string& reason) {
  return Contains(Field(&Missing::reason, HasSubstr(reason)));
}

Discovery find(const Root& root, const std::string& source) {
  return discover(root, Selection{.sources = {source}});
}

const SensorSource& source_of(const Discovery& found, const std::string& name) {
  for (const auto& source : found.sources)
    for (const Channel& channel : std::as_const(*source).channels())
      if (channel.name == name) return *source;
  throw std::runtime_error("no channel " + name);
}

TEST(I915, ShowsALaptopThatBeginsToThrottle) {
  const std::string machine = "intel-rplp-i915-laptop";
  const Tree tree(machine);
  const Discovery found = find(tree.root(), "i915");
  auto t0 = poll_all(found);
  EXPECT_EQ(t0["i915.gt0.act_freq"].value, 1300);
  EXPECT_EQ(t0["i915.gt0.requested_freq"].value, 1300);
  EXPECT_EQ(t0["i915.gt0.throttle.status"].value, 0);
  EXPECT_EQ(t0["i915.gt0.throttle.pl1"].status, PollStatus::ok);
  tree.overlay(machine, "t1");
  auto t1 = poll_all(found);
  // EXPECTED.tsv: active pl1; act/requested = 850/1500; rc6 residency 0.0 %.
  EXPECT_EQ(t1["i915.gt0.act_freq"].value, 850);
  EXPECT_EQ(t1["i915.gt0.requested_freq"].value, 1500);
  EXPECT_EQ(t1["i915.gt0.throttle.status"].value, 1);
  EXPECT_EQ(t1["i915.gt0.throttle.pl1"].value, 1);
  for (const char* reason :
       {"pl2", "pl4", "thermal", "prochot", "ratl", "vr_thermalert", "vr_tdc"}) {
    const Reading& reading = t1[std::string("i915.gt0.throttle.") + reason];
    EXPECT_EQ(reading.status, PollStatus::ok) << reason;
    EXPECT_EQ(reading.value, 0) << reason;
  }
  EXPECT_EQ(t1["i915.gt0.rc6_residency"].value, t0["i915.gt0.rc6_residency"].value);
  EXPECT_EQ(channel_called(found, "i915.gt0.act_freq").limit, 1500);
  EXPECT_EQ(channel_called(found, "i915.gt0.throttle.pl1").kind, Kind::flag);
  EXPECT_EQ(channel_called(found, "i915.gt0.rc6_residency").wrap_at, 4'294'967'295);
  EXPECT_EQ(channel_called(found, "i915.gt0.act_freq").gpu, "0000:00:02.0");
  EXPECT_EQ(t1["i915.gt0.punit_requested_freq"].value, 1500);
  EXPECT_EQ(t1["i915.gt0.rp0_freq"].value, 1500);
  EXPECT_EQ(t1["i915.gt0.rpn_freq"].value, 100);
  EXPECT_THAT(found.missing, SizeIs(1));
  EXPECT_THAT(found.missing, missing_because("its energy is RAPL's uncore"));
}

TEST(I915, LeavesASleepingGpuItsSleepExceptForReasonsAndResidency) {
  const Discovery found = find(Root(Tree::machine_dir("intel-rplp-i915-laptop").string()), "i915");
  EXPECT_FALSE(source_of(found, "i915.gt0.act_freq").traits().wakes_device);
  EXPECT_TRUE(source_of(found, "i915.gt0.throttle.pl1").traits().wakes_device);
  EXPECT_TRUE(source_of(found, "i915.gt0.throttle.pl1").traits().slow);
  EXPECT_TRUE(source_of(found, "i915.gt0.rc6_residency").traits().wakes_device);
}

TEST(I915, ReadsTheReasonsOnlyWhileTheSummarySaysSo) {
  const Tree tree("intel-rplp-i915-laptop");
  const std::string gt = "sys/devices/pci0000:00/0000:00:02.0/drm/card1/gt/gt0/";
  const Discovery found = find(tree.root(), "i915");
  // A reason that is set while the summary is not: its file is not read.
  tree.write({{gt + "throttle_reason_thermal", "1\n"}});
  EXPECT_EQ(poll_all(found)["i915.gt0.throttle.thermal"].value, 0);
  tree.write({{gt + "throttle_reason_status", "1\n"}});
  EXPECT_EQ(poll_all(found)["i915.gt0.throttle.thermal"].value, 1);
}

TEST(I915, HasOldFilesAndNoReasonsBeforeGeneration11) {
  const Discovery found = find(Root(Tree::machine_dir("intel-cml-i915-laptop").string()), "i915");
  auto readings = poll_all(found);
  EXPECT_EQ(readings["i915.gt0.act_freq"].value, 300);
  EXPECT_EQ(readings["i915.gt0.requested_freq"].value, 300);
  EXPECT_EQ(readings["i915.gt0.max_freq"].value, 1150);
  EXPECT_EQ(channel_called(found, "i915.gt0.max_freq").quantity, Quantity::limit);
  EXPECT_EQ(channel_called(found, "i915.gt0.act_freq").limit, 1150);
  EXPECT_THAT(found.missing, missing_because("generation 11"));
}

TEST(I915, KnowsGenerationsBefore11ByTheirDirectoryWithoutReasons) {
  const Tree tree{{card + "device/uevent", "DRIVER=i915\nPCI_SLOT_NAME=0000:00:02.0\n"},
                  {card + "gt/gt0/rps_act_freq_mhz", "300\n"},
                  {card + "power/rc6_residency_ms", "7\n"}};
  const Discovery found = find(tree.root(), "i915");
  EXPECT_THAT(found.missing,
              missing_because("GPU generation before 11, for which the driver exposes no "
                              "throttle reasons"));
  EXPECT_EQ(poll_all(found)["i915.gt0.rc6_residency"].value, 7);
}

TEST(I915, TakesTheOldClocksOfAGtWhoseDirectoryHasNone) {
  const Tree tree{{card + "device/uevent", "DRIVER=i915\n"},
                  {card + "gt/gt0/id", "0\n"},
                  {card + "gt_act_freq_mhz", "350\n"}};
  EXPECT_EQ(poll_all(find(tree.root(), "i915"))["i915.gt0.act_freq"].value, 350);
}

TEST(I915, HasClocksWhereTheReasonsMayNotBeRead) {
  const Tree tree("intel-rplp-i915-laptop");
  const std::string gt = "sys/devices/pci0000:00/0000:00:02.0/drm/card1/gt/gt0/";
  const Discovery found = find(
      tree.root({{gt + "throttle_reason_status", EACCES}, {gt + "throttle_reason_pl2", EACCES}}),
      "i915");
  auto readings = poll_all(found);
  EXPECT_EQ(readings["i915.gt0.act_freq"].status, PollStatus::ok);
  // Without a summary, each reason is read.
  EXPECT_EQ(readings["i915.gt0.throttle.pl1"].status, PollStatus::ok);
  EXPECT_EQ(readings.count("i915.gt0.throttle.pl2"), 0u);
  EXPECT_THAT(found.missing, missing_because("throttle_reason_pl2': Permission denied"));
}

TEST(I915, KeepsSeveralCardsAndTheirChipsApart) {
  const Tree tree{
      {card + "device/uevent", "DRIVER=i915\nPCI_SLOT_NAME=0000:00:02.0\n"},
      {card + "gt_act_freq_mhz", "300\n"},
      {"sys/class/drm/card1/device/uevent", "DRIVER=i915\nPCI_SLOT_NAME=0000:03:00.0\n"},
      {"sys/class/drm/card1/device/hwmon/hwmon2/name", "i915\n"},
      {"sys/class/drm/card1/gt/gt0/rps_act_freq_mhz", "2400\n"}};
  const Discovery found = find(tree.root(), "i915");
  auto readings = poll_all(found);
  EXPECT_EQ(readings["i915@0000:00:02_0.gt0.act_freq"].value, 300);
  EXPECT_EQ(readings["i915@0000:03:00_0.gt0.act_freq"].value, 2400);
  EXPECT_EQ(channel_called(found, "i915@0000:03:00_0.gt0.act_freq").gpu, "0000:03:00.0");
  EXPECT_THAT(found.missing, missing_because("0000:00:02.0 has no power"));
  EXPECT_THAT(found.missing, Not(missing_because("0000:03:00.0 has no power")));
}

TEST(I915, LosesAReasonThatGoesAwayAndNothingElse) {
  const Tree tree("intel-rplp-i915-laptop");
  const std::string gt = "sys/devices/pci0000:00/0000:00:02.0/drm/card1/gt/gt0/";
  const Discovery found = find(tree.root(), "i915");
  tree.write({{gt + "throttle_reason_status", "1\n"}});
  poll_all(found);
  tree.remove(gt + "throttle_reason_pl4");
  auto readings = poll_all(found);
  EXPECT_EQ(readings["i915.gt0.throttle.pl4"].status, PollStatus::gone);
  EXPECT_EQ(readings["i915.gt0.throttle.pl1"].status, PollStatus::ok);
}

TEST(I915, KeepsReasonsThatItDoesNotKnowAndGtsThatDoNotRender) {
  const Tree tree{{card + "device/uevent", "DRIVER=i915\nPCI_SLOT_NAME=0000:00:02.0\n"},
                  {card + "gt/gt0/rps_act_freq_mhz", "500\n"},
                  {card + "gt/gt1/rps_act_freq_mhz", "0\n"},
                  {card + "gt/gt1/throttle_reason_soc_thermal", "1\n"}};
  const Discovery found = find(tree.root(), "i915");
  auto readings = poll_all(found);
  EXPECT_EQ(readings["i915.gt0.act_freq"].value, 500);
  EXPECT_EQ(readings["i915.gt1.act_freq"].status, PollStatus::ok);
  EXPECT_EQ(readings["i915.gt1.throttle.soc_thermal"].value, 1);
}

TEST(I915, SaysWhyAFileIsNoUse) {
  const Tree tree{{card + "device/uevent", "DRIVER=i915\n"},
                  {card + "gt/gt0/rps_act_freq_mhz", "fast\n"},
                  {card + "gt/gt0/throttle_reason_pl1", ""}};
  const Discovery found = find(tree.root(), "i915");
  EXPECT_THAT(names_of(found), IsEmpty());
  EXPECT_THAT(found.missing, missing_because("'fast'"));
  EXPECT_THAT(found.missing, missing_because("throttle_reason_pl1' is empty"));
  EXPECT_THAT(find(Tree().root(), "i915").missing, missing_because("no GPU runs under"));
}

TEST(Xe, ReadsAHandheldFromIdleToLoad) {
  const std::string machine = "intel-lnl-xe-handheld";
  const Tree tree(machine);
  const Discovery found = find(tree.root(), "xe");
  auto t0 = poll_all(found);
  EXPECT_EQ(t0["xe.gt0.act_freq"].value, 0);  // asleep
  EXPECT_EQ(t0["xe.gt0.throttle.pl1"].value, 0);
  EXPECT_EQ(channel_called(found, "xe.gt0.act_freq").limit, 1950);
  EXPECT_EQ(channel_called(found, "xe.gt1.act_freq").limit, 1500);
  tree.overlay(machine, "t1");
  auto t1 = poll_all(found);
  EXPECT_EQ(t1["xe.gt0.act_freq"].value, 1350);
  EXPECT_EQ(t1["xe.gt0.requested_freq"].value, 1950);
  EXPECT_EQ(t1["xe.gt0.throttle.pl1"].value, 1);
  EXPECT_EQ(t1["xe.gt0.throttle.pl2"].value, 1);
  EXPECT_EQ(t1["xe.gt0.throttle.thermal"].value, 0);
  EXPECT_EQ(t1["xe.gt0.throttle.other"].value, 0);
  EXPECT_EQ(t0["xe.gt0.throttle.status"].value, 0);
  EXPECT_EQ(t1["xe.gt0.throttle.status"].value, 1);
  EXPECT_EQ(t1["xe.gt0.rpn_freq"].value, 100);
  EXPECT_EQ(t1["xe.gt1.max_freq"].value, 1500);
  EXPECT_EQ(t0["xe.gt1.c6_residency"].value, 5'708'895);
  EXPECT_THAT(found.missing, SizeIs(1));
  EXPECT_THAT(found.missing, missing_because("its energy is RAPL's uncore"));
}

TEST(Xe, DoesNotKeepTheGpuAwakeToKnowItsRequestedClock) {
  const Discovery found = find(Root(Tree::machine_dir("intel-lnl-xe-handheld").string()), "xe");
  const SensorSource& requested = source_of(found, "xe.gt0.requested_freq");
  EXPECT_TRUE(requested.traits().slow);
  EXPECT_TRUE(requested.traits().wakes_device);
  EXPECT_GE(requested.period_ns(), ns_per_s);
  EXPECT_TRUE(source_of(found, "xe.gt0.max_freq").traits().wakes_device);  // the firmware's answer
}

TEST(Xe, WakesADeviceThatMaySleepForItsActualClock) {
  const std::string device = "sys/class/drm/card0/device/";
  const Tree tree{{device + "uevent", "DRIVER=xe\n"},
                  {device + "power/control", "auto\n"},
                  {device + "tile0/gt0/freq0/act_freq", "0\n"},
                  {device + "tile0/gt0/freq0/rp0_freq", "2400\n"}};
  const auto act = [&] { return source_of(find(tree.root(), "xe"), "xe.gt0.act_freq").traits(); };
  EXPECT_TRUE(act().wakes_device);
  EXPECT_TRUE(act().slow);
  tree.write({{device + "power/control", "on\n"}});
  EXPECT_FALSE(act().wakes_device);
  EXPECT_FALSE(act().slow);
  const Discovery found = find(tree.root(), "xe");
  EXPECT_GE(source_of(found, "xe.gt0.rp0_freq").period_ns(), 60 * ns_per_s);  // never changes
}

TEST(Xe, DoesNotBelieveAnImpossibleClock) {
  const Discovery found = find(Root(Tree::machine_dir("intel-a380-xe-dgpu").string()), "xe");
  auto readings = poll_all(found);
  // rpa_freq holds 627200 MHz on this machine.
  for (const auto& [name, reading] : readings) {
    if (name.ends_with("freq")) {
      EXPECT_LE(reading.value, 2450) << name;
    }
  }
  EXPECT_EQ(channel_called(found, "xe.gt0.act_freq").limit, 2450);
  EXPECT_EQ(readings["xe.gt0.c6_residency"].value, 2'547'784);
  EXPECT_EQ(channel_called(found, "xe.gt0.act_freq").gpu, "0000:08:00.0");
  EXPECT_THAT(found.missing, IsEmpty());  // it has a chip
}

TEST(Xe, KeepsReasonsThatItDoesNotKnow) {
  const Tree tree{{card + "device/uevent", "DRIVER=xe\n"},
                  {xe_freq + "act_freq", "1000\n"},
                  {xe_freq + "throttle/reasons", "psys_pl1\n"},
                  {xe_freq + "throttle/reason_thermal", "0\n"}};
  const Discovery found = find(tree.root(), "xe");
  EXPECT_EQ(poll_all(found)["xe.gt0.throttle.psys_pl1"].value, 1);
  EXPECT_EQ(poll_all(found)["xe.gt0.throttle.other"].value, 0);
  tree.write({{xe_freq + "throttle/reasons", "thermal fastvmode\n"}});
  auto readings = poll_all(found);
  EXPECT_EQ(readings["xe.gt0.throttle.psys_pl1"].value, 0);
  EXPECT_EQ(readings["xe.gt0.throttle.thermal"].value, 1);
  EXPECT_EQ(readings["xe.gt0.throttle.other"].value, 1);
  tree.write({{xe_freq + "throttle/reasons", "\n"}});
  EXPECT_EQ(poll_all(found)["xe.gt0.throttle.thermal"].status, PollStatus::retry);
}

TEST(Xe, KnowsReasonsWithoutAFileForEach) {
  const Tree tree{{card + "device/uevent", "DRIVER=xe\n"},
                  {xe_freq + "act_freq", "1000\n"},
                  {xe_freq + "throttle/reasons", "none\n"}};
  const Discovery found = find(tree.root(), "xe");
  tree.write({{xe_freq + "throttle/reasons", "pl1 soc_avg_thermal\n"}});
  auto readings = poll_all(found);
  EXPECT_EQ(readings["xe.gt0.throttle.pl1"].value, 1);
  EXPECT_EQ(readings["xe.gt0.throttle.soc_avg_thermal"].value, 1);
  EXPECT_EQ(readings["xe.gt0.throttle.psys_crit"].status, PollStatus::ok);
  EXPECT_EQ(readings["xe.gt0.throttle.psys_crit"].value, 0);
  EXPECT_EQ(readings["xe.gt0.throttle.other"].value, 0);
}

TEST(Xe, DoesNotTakeNoiseForAListOfReasons) {
  const Tree tree{{card + "device/uevent", "DRIVER=xe\n"},
                  {xe_freq + "act_freq", "1000\n"},
                  {xe_freq + "throttle/reasons", "none\n"}};
  const Discovery found = find(tree.root(), "xe");
  for (const std::string& text :
       {std::string(), std::string("\x01\xff pl1\n"), std::string(5000, 'x')}) {
    tree.write({{xe_freq + "throttle/reasons", text}});
    EXPECT_EQ(poll_all(found)["xe.gt0.throttle.pl1"].status, PollStatus::retry);
    EXPECT_EQ(names_of(find(tree.root(), "xe")), std::vector<std::string>{"xe.gt0.act_freq"});
  }
}

TEST(Xe, FindsTheGtsOfEveryTileAndIgnoresWhatOnlyLooksLikeOne) {
  const Tree tree{{card + "device/uevent", "DRIVER=xe\n"},
                  {card + "device/tile0/gt0/freq0/act_freq", "1\n"},
                  {card + "device/tile1/gt1/freq0/act_freq", "2\n"},
                  {card + "device/tile1/gtidle/freq0/act_freq", "3\n"},
                  {card + "device/tiles/gt2/freq0/act_freq", "4\n"}};
  EXPECT_THAT(names_of(find(tree.root(), "xe")), ElementsAre("xe.gt0.act_freq", "xe.gt1.act_freq"));
}

TEST(Xe, TakesReasonFilesWhereThereIsNoListAndGtsWithoutATile) {
  const std::string gt = card + "device/gt0/freq0/";
  const Tree tree{{card + "device/uevent", "DRIVER=xe\n"},
                  {gt + "act_freq", "900\n"},
                  {gt + "throttle/status", "1\n"},
                  {gt + "throttle/reason_ratl", "1\n"},
                  {gt + "throttle/reason_iccmax", "0\n"}};
  auto readings = poll_all(find(tree.root(), "xe"));
  EXPECT_EQ(readings["xe.gt0.act_freq"].value, 900);
  EXPECT_EQ(readings["xe.gt0.throttle.status"].value, 1);
  EXPECT_EQ(readings["xe.gt0.throttle.ratl"].value, 1);
  EXPECT_EQ(readings["xe.gt0.throttle.iccmax"].value, 0);
}

TEST(Xe, TriesAgainWhenTheGpuDidNotWakeInTime) {
  const Tree tree{{card + "device/uevent", "DRIVER=xe\n"}, {xe_freq + "cur_freq", "900\n"}};
  const Discovery found = find(tree.root({{xe_freq + "cur_freq", ETIMEDOUT}}), "xe");
  EXPECT_EQ(poll_all(found)["xe.gt0.requested_freq"].status, PollStatus::retry);
}

}  // namespace
}  // namespace energyprof::probe
