// Control groups in the layouts that systems mount them in, and their pressure files.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cerrno>

#include "tree.h"

namespace energyprof::probe {
namespace {

using testing::AllOf;
using testing::Contains;
using testing::ElementsAre;
using testing::Field;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

const std::string groups = "sys/fs/cgroup/";

Discovery find(const Root& root, const std::string& source) {
  return discover(root, Selection{.sources = {source}});
}

TEST(ControlGroup, OfAContainerOnTheLaptopIsThrottled) {
  const Tree tree("intel-rplp-i915-laptop");
  tree.write({{"proc/self/cgroup", "0::/kubepods-burstable.slice\n"}});
  const Discovery found = find(tree.root(), "cgroup");
  EXPECT_THAT(names_of(found), ElementsAre("cgroup.cpu.throttled", "cgroup.cpu.throttled_periods"));
  auto readings = poll_all(found);
  EXPECT_EQ(readings["cgroup.cpu.throttled"].value, 156'161);
  EXPECT_EQ(readings["cgroup.cpu.throttled_periods"].value, 2);
  EXPECT_EQ(channel_called(found, "cgroup.cpu.throttled").unit, Unit::microsecond);
}

TEST(ControlGroup, OfVersionOneMayHaveTheControllerAlone) {
  // Linux without systemd: a mount for each controller, and an empty v2 hierarchy beside them.
  const Tree tree{{"proc/self/cgroup", "4:memory:/job\n2:cpuacct:/\n1:cpu:/job\n0::/\n"},
                  {groups + "cpuacct/cpuacct.usage", "1\n"},
                  {groups + "unified/cpu.stat", "usage_usec 5\n"},
                  {groups + "cpu/cpu.stat", "nr_periods 0\nnr_throttled 0\nthrottled_time 0\n"},
                  {groups + "cpu/job/cpu.stat",
                   "nr_periods 9\nnr_throttled 3\nthrottled_time 5000000\nnr_bursts 0\n"}};
  const Discovery found = find(tree.root(), "cgroup");
  auto readings = poll_all(found);
  EXPECT_EQ(readings["cgroup.cpu.throttled"].value, 5'000'000);
  EXPECT_EQ(readings["cgroup.cpu.throttled_periods"].value, 3);
  EXPECT_EQ(readings["cgroup.cpu.throttled.parent1"].value, 0);
  EXPECT_EQ(channel_called(found, "cgroup.cpu.throttled").unit, Unit::nanosecond);
}

TEST(ControlGroup, OfAHybridSystemMayHaveTheControllerInVersionTwo) {
  const Tree tree{{"proc/self/cgroup", "3:memory:/a\n1:name=systemd:/a\n0::/a\n"},
                  {groups + "unified/a/cpu.stat",
                   "usage_usec 1\nnr_periods 2\nnr_throttled 1\nthrottled_usec 700\n"}};
  EXPECT_EQ(poll_all(find(tree.root(), "cgroup"))["cgroup.cpu.throttled"].value, 700);
}

TEST(ControlGroup, IsReadAThousandTimesASecondOnlyWhereAQuotaCanStopIt) {
  const auto period_ns = [](const std::string& own_quota, const std::string& quota_above) {
    const Tree tree{{"proc/self/cgroup", "0::/a/b\n"},
                    {groups + "a/b/cpu.stat", "nr_throttled 1\nthrottled_usec 700\n"},
                    {groups + "a/b/cpu.max", own_quota},
                    {groups + "a/cpu.stat", "nr_throttled 1\nthrottled_usec 700\n"},
                    {groups + "a/cpu.max", quota_above}};
    return find(tree.root(), "cgroup").sources.at(0)->period_ns();
  };
  EXPECT_EQ(period_ns("max 100000\n", "max 100000\n"), 10'000'000);
  EXPECT_EQ(period_ns("50000 100000\n", "max 100000\n"), 1'000'000);
  EXPECT_EQ(period_ns("max 100000\n", "50000 100000\n"), 1'000'000);
  EXPECT_EQ(period_ns("", "max 100000\n"), 1'000'000) << "not known";
  const Tree v1{{"proc/self/cgroup", "1:cpu:/job\n"},
                {groups + "cpu/job/cpu.stat", "nr_throttled 3\nthrottled_time 5000000\n"},
                {groups + "cpu/job/cpu.cfs_quota_us", "-1\n"}};
  EXPECT_EQ(find(v1.root(), "cgroup").sources.at(0)->period_ns(), 10'000'000);
}

TEST(ControlGroup, IsNotFoundThroughALineThatLeadsAstray) {
  const std::string stat = "nr_periods 0\nnr_throttled 0\nthrottled_time 0\n";
  const Tree tree{{groups + "cpuacct/cpu.stat", stat}, {groups + "cpu/cpu.stat", stat}};
  for (const char* lines : {"", "\n", "0", "1:cpu", "1:cpu:acct\n", "1:cpu:\n", "1:cpu:/../cpuacct",
                            "1:cpu:////\n", ":::::\n", "1:cpu:/nowhere/at/all\n"}) {
    tree.write({{"proc/self/cgroup", lines}});
    for (const std::string& name : names_of(find(tree.root(), "cgroup")))
      EXPECT_THAT(name, testing::AnyOf("cgroup.cpu.throttled", "cgroup.cpu.throttled_periods"))
          << lines;
  }
}

TEST(ControlGroup, ThatVanishesIsGone) {
  const Tree tree("intel-rplp-i915-laptop");
  tree.write({{"proc/self/cgroup", "0::/kubepods-burstable.slice\n"}});
  const Discovery found = find(tree.root(), "cgroup");
  tree.remove(groups + "kubepods-burstable.slice");
  EXPECT_EQ(poll_all(found)["cgroup.cpu.throttled"].status, PollStatus::gone);
}

TEST(ControlGroup, ThatLosesItsQuotaGivesNoValue) {
  const std::string stat = groups + "a/cpu.stat";
  const Tree tree{{"proc/self/cgroup", "0::/a\n"}, {stat, "nr_throttled 4\nthrottled_usec 9\n"}};
  const Discovery found = find(tree.root(), "cgroup");
  for (const char* text : {"usage_usec 1\n", "", "nr_throttled\nthrottled_usec x\n"}) {
    tree.write({{stat, text}});
    EXPECT_EQ(poll_all(found)["cgroup.cpu.throttled"].status, PollStatus::retry) << text;
    EXPECT_EQ(poll_all(found)["cgroup.cpu.throttled_periods"].status, PollStatus::retry) << text;
  }
}

TEST(Pressure, OfTheOwnGroupStandsBesideTheMachines) {
  const Tree tree{{"proc/self/cgroup", "0::/a/b\n"},
                  {"proc/pressure/cpu", "some avg10=0.00 avg60=0.00 avg300=0.00 total=15\n"},
                  {groups + "a/b/cpu.pressure",
                   "some avg10=0.00 avg60=0.00 avg300=0.00 total=7\n"
                   "full avg10=0.00 avg60=0.00 avg300=0.00 total=3\n"}};
  const Discovery found = find(tree.root(), "psi");
  EXPECT_THAT(names_of(found),
              ElementsAre("psi.cpu.some", "psi.cgroup.cpu.some", "psi.cgroup.cpu.full"));
  auto readings = poll_all(found);
  EXPECT_EQ(readings["psi.cpu.some"].value, 15);
  EXPECT_EQ(readings["psi.cgroup.cpu.some"].value, 7);
  EXPECT_EQ(readings["psi.cgroup.cpu.full"].value, 3);
  EXPECT_EQ(channel_called(found, "psi.cgroup.cpu.some").unit, Unit::microsecond);
}

TEST(Pressure, OfAGroupMayBeSwitchedOff) {
  const std::string machine = "intel-rplp-i915-laptop";
  const Tree tree(machine);
  const std::string pressure = groups + "kubepods-burstable.slice/cpu.pressure";
  tree.write({{"proc/self/cgroup", "0::/kubepods-burstable.slice\n"}, {pressure, ""}});
  // ERRNO.tsv
  const Discovery found = find(tree.root({{pressure, EOPNOTSUPP}}), "psi");
  EXPECT_EQ(channel_called(found, "psi.cgroup.cpu.some").id, 0);
  EXPECT_NE(channel_called(found, "psi.cpu.some").id, 0);
  EXPECT_THAT(
      found.missing,
      Contains(Field(&Missing::reason, AllOf(HasSubstr("not supported"), HasSubstr("psi=1")))));
}

TEST(Pressure, OfAGroupWithoutTheFileIsNoNews) {
  const Tree tree("intel-rplp-i915-laptop");
  EXPECT_THAT(find(tree.root(), "psi").missing, IsEmpty());
}

}  // namespace
}  // namespace energyprof::probe
