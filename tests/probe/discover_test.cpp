// Discovery as a whole, and on the machine that runs the tests.
#include "probe/discover.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/mman.h>

#include <set>
#include <stdexcept>
#include <thread>

#include "probe/characterize.h"
#include "tree.h"

namespace energyprof::probe {
namespace {

using testing::AllOf;
using testing::Contains;
using testing::Each;
using testing::Field;
using testing::HasSubstr;
using testing::IsEmpty;

TEST(Discover, RefusesASourceThereIsNot) {
  try {
    discover(Root(), Selection{{"powercap", "nvml2"}});
    FAIL() << "an unknown source was accepted";
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(),
                AllOf(HasSubstr("'nvml2'"), HasSubstr("powercap, "), HasSubstr("hwmon, thermal")));
  }
}

TEST(Discover, LooksForSelectedSourcesOnly) {
  const Discovery found = discover(Tree().root(), Selection{{"psi", "hwmon"}});
  EXPECT_THAT(found.missing, Each(Field(&Missing::source, testing::AnyOf("psi", "hwmon"))));
}

TEST(Discover, GivesAReasonForEverythingOnAnEmptyMachine) {
  const Tree tree;
  const Discovery found = discover(tree.root());
  EXPECT_THAT(found.sources, IsEmpty());
  for (const std::string& name : source_names())
    EXPECT_THAT(found.missing, Contains(AllOf(Field(&Missing::source, name),
                                              Field(&Missing::reason, testing::Ne("")))));
  EXPECT_THAT(verdict(found), HasSubstr("Nothing but frame times"));
}

TEST(Discover, SaysWhatTheKernelOfAnotherMachineWouldCount) {
  const auto why = [](const std::string& machine, const std::string& source) {
    return discover(Root(Tree::machine_dir(machine).string()), Selection{{source}})
        .missing.front()
        .reason;
  };
  EXPECT_THAT(why("intel-rplp-i915-laptop", "uncore"),
              AllOf(HasSubstr("not under --root"),
                    HasSubstr("perf may count uncore.imc.read, uncore.imc.write")));
  EXPECT_THAT(why("intel-rplp-i915-laptop", "perf_rapl"), HasSubstr("rapl.package-0.energy"));
  EXPECT_THAT(why("vm-no-sensors", "uncore"), testing::Not(HasSubstr("may count")));
}

TEST(Verdict, DoesNotSayThatPowerIsUnknownWhereEnergyIsCounted) {
  const std::string zone = "sys/class/powercap/intel-rapl:0/";
  const Tree tree{{zone + "name", "package-0\n"}, {zone + "energy_uj", "1\n"}};
  EXPECT_THAT(verdict(discover(tree.root())), HasSubstr("Cannot: GPU energy, GPU clock"));
  EXPECT_THAT(verdict(discover(Tree().root())), HasSubstr("Cannot: energy, GPU energy, power"));
}

TEST(Discover, WorksOnThisMachine) {
  Discovery found = discover(Root());
  characterize(found, Root());
  std::set<std::string> heard_of;
  for (const auto& source : found.sources)
    for (const Channel& channel : source->channels()) {
      heard_of.insert(channel.source);
      EXPECT_GE(channel.read_cost_ns.value_or(-1), 0) << channel.name;
    }
  for (const Missing& missing : found.missing) heard_of.insert(missing.source);
  EXPECT_EQ(heard_of.size(), source_names().size());
  EXPECT_NE(verdict(found), "");
}

TEST(PerfEvents, CountFaultsOfThreadsStartedLater) {
  const Discovery found = discover(Root(), Selection{{"perf"}});
  const std::string name = "perf.page_faults";
  if (channel_called(found, name).id == 0)
    GTEST_SKIP() << (found.missing.empty() ? "not found" : found.missing.front().reason);
  const int64_t before = poll_all(found)[name].value;
  // Each page of fresh anonymous memory faults when it is first written.
  constexpr size_t page_count = 512;
  std::thread([] {
    const auto page_bytes = static_cast<size_t>(sysconf(_SC_PAGESIZE));
    const size_t bytes = page_count * page_bytes;
    void* const memory =
        mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    madvise(memory, bytes, MADV_NOHUGEPAGE);
    for (size_t page = 0; page < page_count; ++page)
      static_cast<volatile char*>(memory)[page * page_bytes] = 1;
    munmap(memory, bytes);
  }).join();
  EXPECT_GE(poll_all(found)[name].value - before, static_cast<int64_t>(page_count));
}

}  // namespace
}  // namespace energyprof::probe
