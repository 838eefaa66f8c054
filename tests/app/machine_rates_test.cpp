// Two looks at another machine's files, from discovery to watts: what EXPECTED.tsv of
// tests/data/sysfs says of the time between them.
#include <gtest/gtest.h>

#include "analysis/series.h"
#include "core/clock.h"
#include "tests/probe/tree.h"

namespace energyprof {
namespace {

using analysis::unwrap;
using probe::Tree;

/// A fixture machine that is looked at, changes to its next steps, and is looked at again.
class Machine {
 public:
  explicit Machine(const std::string& name) : name_(name), tree_(name), discovery_(discover()) {}

  /// Reads everything at `t_ns`, after the files of `step` (empty: none) took effect.
  void look(int64_t t_ns, const std::string& step) {
    if (!step.empty()) tree_.overlay(name_, step);
    for (const auto& [channel, reading] : poll_all(discovery_)) {
      if (reading.status != probe::PollStatus::ok) continue;
      series_[channel].t_ns.push_back(t_ns);
      series_[channel].value.push_back(static_cast<double>(reading.value));
    }
  }
  [[nodiscard]] analysis::Unwrapped total(const std::string& channel) const {
    return unwrap(channel_called(discovery_, channel), series_.at(channel));
  }
  /// Mean watts over `seconds` of everything seen.
  [[nodiscard]] double watts(const std::string& channel, double seconds) const {
    return total(channel).value.back() * unit_info(channel_called(discovery_, channel).unit).to_si /
           seconds;
  }

 private:
  [[nodiscard]] probe::Discovery discover() const { return probe::discover(tree_.root()); }

  std::string name_;
  Tree tree_;
  probe::Discovery discovery_;
  std::map<std::string, SampleSeries> series_;
};

TEST(MachineRates, OfTheRaptorLakeLaptopAreThoseOnItsLabel) {
  Machine machine("intel-rplp-i915-laptop");
  machine.look(0, "");
  machine.look(ns_per_s, "t1");
  EXPECT_NEAR(machine.watts("rapl.package-0.energy", 1), 35.012, 5e-4);
  EXPECT_NEAR(machine.watts("rapl.core.energy", 1), 6.010, 5e-4);
  EXPECT_NEAR(machine.watts("rapl.uncore.energy", 1), 21.040, 5e-4);
  EXPECT_NEAR(machine.watts("rapl.psys.energy", 1), 52.300, 5e-4);
  // Each CPU of the package tells of the same event: one, not one for each.
  EXPECT_EQ(machine.total("cpu.package-0.throttle.count").value.back(), 1);
  EXPECT_EQ(machine.total("cpu.package-0.throttle.time").value.back(), 462);
  // The GPU was never in RC6.
  EXPECT_EQ(machine.total("i915.gt0.rc6_residency").value.back(), 0);
}

TEST(MachineRates, AResetOfTheRaptorLakeLaptopIsNoWrap) {
  Machine machine("intel-rplp-i915-laptop");
  machine.look(0, "");
  machine.look(ns_per_s, "t1");
  machine.look(2 * ns_per_s, "t2-reset");
  const analysis::Unwrapped package = machine.total("rapl.package-0.energy");
  EXPECT_EQ(package.resets, (std::vector<size_t>{2}));
  EXPECT_EQ(package.value.back(), 35'012'000);  // and not 235 kJ more
}

TEST(MachineRates, TheWrapOfThePhoenixIsFollowed) {
  Machine machine("amd-phoenix-apu");
  machine.look(0, "");
  machine.look(10 * ns_per_s, "t1-wrap");
  EXPECT_TRUE(machine.total("rapl.package-0.energy").resets.empty());
  EXPECT_NEAR(machine.watts("rapl.package-0.energy", 10), 60.986, 5e-4);
}

}  // namespace
}  // namespace energyprof
