// NVML as far as it can be tested without a GPU: against a library of our own.
#include "probe/nvml.h"

#include <dlfcn.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cerrno>
#include <chrono>
#include <thread>

#include "allocation_count.h"
#include "core/clock.h"
#include "nvml_stub.h"
#include "probe/characterize.h"
#include "probe/sampler.h"
#include "tree.h"

namespace energyprof::probe {
namespace {

using testing::AllOf;
using testing::Contains;
using testing::Each;
using testing::ElementsAre;
using testing::Field;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;
using testing::SizeIs;
using testing::StartsWith;

// A stub library that stays loaded, so that its state can be seen after the sources are gone.
class StubLibrary {
 public:
  explicit StubLibrary(std::string path)
      : path_(std::move(path)), handle_(dlopen(path_.c_str(), RTLD_NOW | RTLD_LOCAL)) {
    if (handle_ == nullptr) throw std::runtime_error(dlerror());
    stub_ = reinterpret_cast<NvmlStub* (*)()>(dlsym(handle_, "nvml_stub"))();
  }
  ~StubLibrary() { dlclose(handle_); }
  StubLibrary(const StubLibrary&) = delete;
  StubLibrary& operator=(const StubLibrary&) = delete;

  NvmlStub* operator->() const { return stub_; }
  [[nodiscard]] Discovery discover(const Root& root) const {
    Discovery found;
    discover_nvml(root, selection(), found);
    return found;
  }
  [[nodiscard]] Selection selection() const {
    Selection selection;
    selection.sources = {"nvml"};
    selection.nvml_library = path_;
    return selection;
  }

 private:
  std::string path_;
  void* handle_;
  NvmlStub* stub_ = nullptr;
};

Discovery discover_library(const std::string& library, const Root& root) {
  Discovery found;
  Selection selection;
  selection.nvml_library = library;
  discover_nvml(root, selection, found);
  return found;
}

std::string only_reason(const Discovery& found) {
  EXPECT_THAT(found.sources, IsEmpty());
  EXPECT_THAT(found.missing, SizeIs(1));
  return found.missing.empty() ? "" : found.missing.front().reason;
}

class Nvml : public testing::Test {
 protected:
  // Files of one NVIDIA GPU, at the address of the stub's first or second one.
  static void add_gpu(const Tree& tree, const std::string& address, const std::string& control,
                      const std::string& status) {
    const std::string device = "sys/bus/pci/devices/" + address;
    tree.write({{device + "/vendor", "0x10de\n"},
                {device + "/class", "0x030000\n"},
                {device + "/power/control", control + "\n"},
                {device + "/power/runtime_status", status + "\n"}});
  }

  const StubLibrary full{NVML_STUB_FULL_PATH};
  const Tree tree;
};

TEST_F(Nvml, GivesEveryChannelOfBothGpus) {
  const Discovery found = full.discover(tree.root());
  auto readings = poll_all(found);
  struct Expected {
    std::string suffix;
    int64_t value;
    Quantity quantity;
    Unit unit;
    Kind kind;
    std::optional<int64_t> limit;
  };
  const std::vector<Expected> expected{
      {"energy", 1'000'000, Quantity::energy, Unit::millijoule, Kind::cumulative, {}},
      {"power_instant", 51'000, Quantity::power, Unit::milliwatt, Kind::gauge, 115'000},
      {"power_limit", 115'000, Quantity::limit, Unit::milliwatt, Kind::gauge, {}},
      {"graphics_freq", 1000, Quantity::frequency, Unit::megahertz, Kind::gauge, 2000},
      {"sm_freq", 1001, Quantity::frequency, Unit::megahertz, Kind::gauge, 2001},
      {"mem_freq", 1002, Quantity::frequency, Unit::megahertz, Kind::gauge, 2002},
      {"video_freq", 1003, Quantity::frequency, Unit::megahertz, Kind::gauge, 2003},
      {"temp", 61, Quantity::temperature, Unit::celsius, Kind::gauge, 97},
      {"mem_temp", 70, Quantity::temperature, Unit::celsius, Kind::gauge, 105},
      {"throttle.sw_power_cap", 0, Quantity::throttle, Unit::count, Kind::flag, {}},
      {"throttle.hw_slowdown", 0, Quantity::throttle, Unit::count, Kind::flag, {}},
      {"throttle.sw_thermal", 0, Quantity::throttle, Unit::count, Kind::flag, {}},
      {"throttle.hw_thermal", 0, Quantity::throttle, Unit::count, Kind::flag, {}},
      {"throttle.hw_power_brake", 0, Quantity::throttle, Unit::count, Kind::flag, {}},
      {"status.idle", 1, Quantity::utilization, Unit::count, Kind::flag, {}},
      {"status.app_clocks", 0, Quantity::utilization, Unit::count, Kind::flag, {}},
      {"status.sync_boost", 0, Quantity::utilization, Unit::count, Kind::flag, {}},
      {"status.display", 0, Quantity::utilization, Unit::count, Kind::flag, {}},
      {"status.other", 0, Quantity::utilization, Unit::count, Kind::flag, {}},
      {"utilization", 83, Quantity::utilization, Unit::percent, Kind::average, {}},
      {"mem_utilization", 41, Quantity::utilization, Unit::percent, Kind::average, {}},
      {"performance_state", 2, Quantity::utilization, Unit::count, Kind::gauge, {}},
      {"violation.power",
       5'000'000'000,
       Quantity::throttle,
       Unit::nanosecond,
       Kind::cumulative,
       {}},
      {"violation.thermal",
       7'000'000'000,
       Quantity::throttle,
       Unit::nanosecond,
       Kind::cumulative,
       {}},
      {"violation.board_limit", 903, Quantity::throttle, Unit::nanosecond, Kind::cumulative, {}},
      {"violation.reliability", 905, Quantity::throttle, Unit::nanosecond, Kind::cumulative, {}},
      {"throttled_time.sw_thermal",
       2'500'000'000,
       Quantity::throttle,
       Unit::nanosecond,
       Kind::cumulative,
       {}},
      {"throttled_time.hw_thermal", 12, Quantity::throttle, Unit::nanosecond, Kind::cumulative, {}},
  };
  EXPECT_THAT(names_of(found), SizeIs(2 * expected.size()));
  for (const Expected& one : expected)
    for (const std::string gpu : {"nvml.gpu0.", "nvml.gpu1."}) {
      const std::string name = gpu + one.suffix;
      const bool is_second_energy = name == "nvml.gpu1.energy";
      ASSERT_EQ(readings.count(name), 1u) << name;
      EXPECT_EQ(readings[name].status, PollStatus::ok) << name;
      EXPECT_EQ(readings[name].value, one.value + (is_second_energy ? 7 : 0)) << name;
      EXPECT_GT(readings[name].t_ns, 0) << name;
      const Channel channel = channel_called(found, name);
      EXPECT_EQ(channel.quantity, one.quantity) << name;
      EXPECT_EQ(channel.unit, one.unit) << name;
      EXPECT_EQ(channel.kind, one.kind) << name;
      EXPECT_EQ(channel.limit, one.limit) << name;
      EXPECT_EQ(channel.gpu, gpu == "nvml.gpu0." ? "0000:01:00.0" : "0000:2d:00.0") << name;
      EXPECT_THAT(channel.origin, StartsWith("nvmlDeviceGet")) << name;
      EXPECT_EQ(channel.period_ns, one.suffix == "power_limit" ? ns_per_s : 100 * ns_per_ms);
    }
  for (const auto& source : found.sources) {
    EXPECT_TRUE(source->traits().slow);
    EXPECT_FALSE(source->traits().wakes_device);
    EXPECT_THAT(source->traits().gpu_uuid, StartsWith("8f1b0000-0000-0000-0000-00000000000"));
  }
  // The one field whose type nobody knows.
  EXPECT_THAT(found.missing, Each(Field(&Missing::reason,
                                        HasSubstr("gives no power brake time: no valid value"))));
}

TEST_F(Nvml, TellsThrottlingFromIdlingAndSettings) {
  const Discovery found = full.discover(tree.root());
  struct Case {
    uint64_t bit;
    std::string channel;
  };
  for (const auto& [bit, name] : std::vector<Case>{{0x1, "status.idle"},
                                                   {0x2, "status.app_clocks"},
                                                   {0x4, "throttle.sw_power_cap"},
                                                   {0x8, "throttle.hw_slowdown"},
                                                   {0x10, "status.sync_boost"},
                                                   {0x20, "throttle.sw_thermal"},
                                                   {0x40, "throttle.hw_thermal"},
                                                   {0x80, "throttle.hw_power_brake"},
                                                   {0x100, "status.display"},
                                                   {0x200, "status.other"},
                                                   {uint64_t{1} << 63, "status.other"}}) {
    full->reasons = bit;
    for (const auto& [channel, reading] : poll_all(found)) {
      const bool is_flag = channel.find(".throttle.") != std::string::npos ||
                           channel.find(".status.") != std::string::npos;
      if (!is_flag) continue;
      EXPECT_EQ(reading.value, channel.ends_with("." + name) ? 1 : 0) << channel;
    }
  }
}

TEST_F(Nvml, LeavesOutReasonsTheGpuNeverGives) {
  full->supported_reasons = 0x5;
  const auto names = names_of(full.discover(tree.root()));
  EXPECT_THAT(names, AllOf(Contains("nvml.gpu0.status.idle"), Contains("nvml.gpu0.status.other"),
                           Contains("nvml.gpu0.throttle.sw_power_cap")));
  EXPECT_THAT(names, Not(Contains("nvml.gpu0.throttle.hw_thermal")));
}

TEST_F(Nvml, DoesWithAnOldDriver) {
  const StubLibrary old(NVML_STUB_OLD_PATH);
  old->reasons = 0x40;
  const Discovery found = old.discover(tree.root());
  auto readings = poll_all(found);
  EXPECT_EQ(readings["nvml.gpu0.power"].value, 45'000);
  EXPECT_EQ(channel_called(found, "nvml.gpu0.power").kind, Kind::average);
  EXPECT_EQ(readings["nvml.gpu0.throttle.hw_thermal"].value, 1);
  EXPECT_EQ(readings["nvml.gpu0.violation.power"].value, 900);
  EXPECT_EQ(readings["nvml.gpu0.temp"].value, 61);
  for (const char* absent : {"energy", "power_instant", "mem_temp", "throttled_time.sw_thermal"})
    EXPECT_EQ(readings.count(std::string("nvml.gpu0.") + absent), 0u) << absent;
  EXPECT_THAT(
      found.missing,
      Contains(Field(&Missing::reason, AllOf(HasSubstr("energy"), HasSubstr("memory temperature"),
                                             HasSubstr("Not Supported (NVML error 3)")))));
}

TEST_F(Nvml, DoesWithADriverThatDroppedWhatIsDeprecated) {
  const StubLibrary next(NVML_STUB_NEW_PATH);
  const Discovery found = next.discover(tree.root());
  auto readings = poll_all(found);
  EXPECT_EQ(readings["nvml.gpu0.energy"].value, 1'000'000);
  EXPECT_THAT(channel_called(found, "nvml.gpu0.energy").origin,
              HasSubstr("nvmlDeviceGetFieldValues 83"));
  EXPECT_EQ(readings["nvml.gpu0.temp"].value, 62);
  EXPECT_EQ(readings["nvml.gpu0.violation.power"].value, 5'000'000'000);
  EXPECT_EQ(readings.count("nvml.gpu0.violation.board_limit"), 0u);
}

TEST_F(Nvml, SaysSoWhereALibraryHasNoSensors) {
  const StubLibrary bare(NVML_STUB_BARE_PATH);
  const Discovery found = bare.discover(tree.root());
  EXPECT_THAT(found.sources, IsEmpty());
  EXPECT_THAT(
      found.missing,
      Contains(Field(&Missing::reason,
                     HasSubstr("nvml.gpu1 (Stub 1, nvml.gpu1) answers no question: no words "
                               "for it (NVML error 3)"))));
}

TEST_F(Nvml, PointsElsewhereOnJetson) {
  full->is_jetson = true;
  full->gpu_count = 1;
  EXPECT_THAT(only_reason(full.discover(tree.root())),
              AllOf(HasSubstr("answers no question: Not Supported (NVML error 3)"),
                    HasSubstr("On Jetson, hwmon and devfreq do")));
}

TEST_F(Nvml, MakesNoChannelOfWhatIsRefused) {
  full->field_result = 4;
  full->violation_result = 4;
  full->energy_result = 3;
  full->memory_celsius = 0;
  const Discovery found = full.discover(tree.root());
  auto readings = poll_all(found);
  for (const char* absent : {"energy", "mem_temp", "violation.power", "throttled_time.hw_thermal"})
    EXPECT_EQ(readings.count(std::string("nvml.gpu0.") + absent), 0u) << absent;
  EXPECT_EQ(readings["nvml.gpu0.power"].value, 45'000);
  EXPECT_THAT(found.missing,
              Contains(Field(&Missing::reason,
                             AllOf(HasSubstr("violation time"),
                                   HasSubstr("Insufficient Permissions (NVML error 4)")))));
}

TEST_F(Nvml, TakesNoZeroForATemperature) {
  full->memory_celsius = 0;
  EXPECT_THAT(names_of(full.discover(tree.root())), Not(Contains("nvml.gpu0.mem_temp")));
}

TEST_F(Nvml, LosesAllChannelsWithTheGpuAndAsksNoMore) {
  const Discovery found = full.discover(tree.root());
  ASSERT_EQ(poll_all(found)["nvml.gpu0.energy"].status, PollStatus::ok);
  full->calls_until_lost = 2;  // in the midst of the first GPU's poll
  const auto readings = poll_all(found);
  EXPECT_EQ(readings.at("nvml.gpu0.energy").status, PollStatus::ok);
  EXPECT_EQ(readings.at("nvml.gpu0.video_freq").status, PollStatus::gone);
  EXPECT_EQ(readings.at("nvml.gpu0.throttle.hw_thermal").error, ENODEV);
  static_cast<void>(poll_all(found));
  full->calls_until_lost = -1;
  const int before = full->reading_count;
  for (const auto& [name, reading] : poll_all(found))
    EXPECT_EQ(reading.status, PollStatus::gone) << name;
  EXPECT_EQ(full->reading_count, before);
}

TEST_F(Nvml, HasNoValueWhereOneIsUnknownAndComesBack) {
  const Discovery found = full.discover(tree.root());
  full->performance_state = 32;
  EXPECT_EQ(poll_all(found)["nvml.gpu0.performance_state"].status, PollStatus::retry);
  full->performance_state = 0;
  EXPECT_EQ(poll_all(found)["nvml.gpu0.performance_state"].status, PollStatus::ok);
  full->energy_result = 3;
  const Reading refused = poll_all(found)["nvml.gpu0.energy"];
  EXPECT_EQ(refused.status, PollStatus::retry);
  EXPECT_EQ(refused.error, EOPNOTSUPP);
}

TEST_F(Nvml, GivesEnergyAsItStandsAfterAReset) {
  const Discovery found = full.discover(tree.root());
  full->energy_mj = 1'050'000;
  EXPECT_EQ(poll_all(found)["nvml.gpu0.energy"].value, 1'050'000);
  full->energy_mj = 12;  // the driver was loaded anew
  EXPECT_EQ(poll_all(found)["nvml.gpu0.energy"].value, 12);
  EXPECT_EQ(channel_called(found, "nvml.gpu0.energy").wrap_at, std::nullopt);
  full->energy_mj = ~uint64_t{0} - 100;
  EXPECT_EQ(poll_all(found)["nvml.gpu0.energy"].status, PollStatus::retry);
}

TEST_F(Nvml, WritesAddressesAsTheKernelDoes) {
  full->gpu_count = 2;
  full->pci_domain = 0x10000;
  EXPECT_EQ(full.discover(tree.root()).sources.back()->traits().gpu, "10000:2d:00.0");
}

TEST_F(Nvml, AllocatesNothingInAPoll) {
  const Discovery found = full.discover(tree.root());
  std::vector<Reading> out(64);
  const auto before = allocation_count();
  for (const auto& source : found.sources)
    source->poll(std::span(out).first(source->channels().size()));
  EXPECT_EQ(allocation_count(), before);
}

TEST_F(Nvml, IsShutDownOnceWhenTheLastSourceGoes) {
  Discovery found = full.discover(tree.root());
  EXPECT_EQ(full->init_count, 1);
  while (found.sources.size() > 1) found.sources.pop_back();
  EXPECT_EQ(full->shutdown_count, 0);
  found.sources.clear();
  EXPECT_EQ(full->shutdown_count, 1);
}

TEST_F(Nvml, SaysWhyItDoesNotStart) {
  struct Case {
    int result;
    std::string reason;
    std::string fix;
  };
  for (const Case& one :
       {Case{9, "Driver Not Loaded (NVML error 9)", "sudo modprobe nvidia"},
        Case{18, "NVML error 18", "sudo reboot"},
        Case{17, "NVML error 17", "docker run --gpus all"}, Case{999, "NVML error 999", ""}}) {
    full->init_result = one.result;
    const Discovery found = full.discover(tree.root());
    EXPECT_THAT(only_reason(found), HasSubstr(one.reason));
    EXPECT_THAT(found.missing.front().fix, StartsWith(one.fix));
  }
  EXPECT_EQ(full->shutdown_count, 0);
}

TEST_F(Nvml, SaysWhichGpuCannotBeOpenedAndUsesTheOther) {
  full->handle_result = 15;
  const Discovery found = full.discover(tree.root());
  EXPECT_THAT(names_of(found), Contains("nvml.gpu0.energy"));
  EXPECT_THAT(names_of(found), Not(Contains("nvml.gpu1.energy")));
  EXPECT_THAT(
      found.missing,
      Contains(Field(&Missing::reason, "nvml.gpu1 cannot be opened: GPU is lost (NVML error 15)")));
}

TEST_F(Nvml, SaysWhenThereIsNoGpu) {
  full->gpu_count = 0;
  EXPECT_EQ(only_reason(full.discover(tree.root())), "NVML knows no GPU");
  full->count_result = 999;
  EXPECT_EQ(only_reason(full.discover(tree.root())),
            "NVML does not tell its GPUs: Unknown Error (NVML error 999)");
}

TEST_F(Nvml, IsBriefWhereThereIsNoNvidiaGpu) {
  EXPECT_EQ(only_reason(discover_library("libno-such-nvml.so.1", tree.root())),
            "libno-such-nvml.so.1 not found, and no NVIDIA GPU either");
}

TEST_F(Nvml, KnowsWhatAnNvidiaGpuWithoutItsLibraryLacks) {
  add_gpu(tree, "0000:01:00.0", "on", "active");
  tree.write(
      {{"sys/bus/pci/drivers/nouveau/module", "\n"}, {"sys/bus/pci/drivers/nvidia/module", "\n"}});
  Discovery found = discover_library("libno-such-nvml.so.1", tree.root());
  EXPECT_THAT(only_reason(found), HasSubstr("the GPU 0000:01:00.0 has the kernel driver none"));
  tree.link("sys/bus/pci/devices/0000:01:00.0/driver", "../../drivers/nouveau");
  found = discover_library("libno-such-nvml.so.1", tree.root());
  EXPECT_THAT(only_reason(found), HasSubstr("driver nouveau, and only NVIDIA's own can be asked"));
  EXPECT_EQ(found.missing.front().fix, "sudo apt install nvidia-driver");
  tree.remove("sys/bus/pci/devices/0000:01:00.0/driver");
  tree.link("sys/bus/pci/devices/0000:01:00.0/driver", "../../drivers/nvidia");
  found = discover_library("libno-such-nvml.so.1", tree.root());
  EXPECT_EQ(found.missing.front().fix, "sudo apt install libnvidia-ml1");
}

TEST_F(Nvml, RefusesWhatIsNoNvml) {
  EXPECT_THAT(only_reason(discover_library("libm.so.6", tree.root())),
              HasSubstr("has no nvmlInit"));
  tree.write({{"text", "not a library"}});
  EXPECT_THAT(only_reason(discover_library(tree.path() + "/text", tree.root())),
              HasSubstr("cannot load"));
}

TEST_F(Nvml, DoesNotWakeASleepingGpu) {
  add_gpu(tree, "0000:01:00.0", "auto", "suspended");
  full->gpu_count = 1;
  Discovery found = full.discover(tree.root());
  EXPECT_THAT(only_reason(found), HasSubstr("the GPU 0000:01:00.0 sleeps"));
  EXPECT_EQ(found.missing.front().fix,
            "echo on | sudo tee /sys/bus/pci/devices/0000:01:00.0/power/control");
  EXPECT_EQ(full->init_count, 0);

  add_gpu(tree, "0000:01:00.0", "auto", "active");
  found = full.discover(tree.root());
  for (const auto& source : found.sources) EXPECT_TRUE(source->traits().wakes_device);
  EXPECT_EQ(poll_all(found)["nvml.gpu0.energy"].status, PollStatus::ok);
  add_gpu(tree, "0000:01:00.0", "auto", "suspended");
  const int before = full->reading_count;
  const Reading asleep = poll_all(found)["nvml.gpu0.energy"];
  EXPECT_EQ(asleep.status, PollStatus::retry);
  EXPECT_EQ(asleep.error, EAGAIN);
  EXPECT_EQ(full->reading_count, before);
  add_gpu(tree, "0000:01:00.0", "auto", "active");
  EXPECT_EQ(poll_all(found)["nvml.gpu0.energy"].status, PollStatus::ok);
}

TEST_F(Nvml, UsesTheGpuThatIsAwake) {
  add_gpu(tree, "0000:01:00.0", "auto", "suspended");
  add_gpu(tree, "0000:2d:00.0", "on", "active");
  const Discovery found = full.discover(tree.root());
  EXPECT_THAT(names_of(found), Contains("nvml.gpu1.energy"));
  EXPECT_THAT(names_of(found), Not(Contains("nvml.gpu0.energy")));
  EXPECT_THAT(found.missing, Contains(Field(&Missing::reason, HasSubstr("0000:01:00.0 sleeps"))));
}

TEST_F(Nvml, IsASourceAndNotUnderAnotherRoot) {
  EXPECT_THAT(names_of(discover(Root(), full.selection())), Contains("nvml.gpu0.energy"));
  EXPECT_THAT(discover(tree.root(), full.selection()).missing,
              ElementsAre(Field(&Missing::reason, HasSubstr("not under --root"))));
}

TEST_F(Nvml, DoesNotDelayQuickSensorsHoweverSlow) {
  Selection selection = full.selection();
  selection.sources = {"nvml", "proc_stat"};
  const Discovery found = discover(Root(), selection);
  const int32_t energy = channel_called(found, "nvml.gpu0.energy").id;
  const int32_t steal = channel_called(found, "proc.stat.busy").id;
  ASSERT_GT(energy, 0);
  ASSERT_GT(steal, 0);
  full->delay_ms = 30;  // of each call: a poll of a GPU takes half a second
  Sampler sampler(found.sources);
  sampler.start();
  // Both GPUs' threads are stuck most of the time: the quick source is polled all the same, many
  // times for each of their polls.
  std::vector<Sample> samples;
  const auto count = [&](int32_t channel) {
    return std::count_if(samples.begin(), samples.end(),
                         [&](const Sample& sample) { return sample.channel_id == channel; });
  };
  const int64_t deadline_ns = now_ns() + 60 * ns_per_s;
  while (count(energy) < 3 && now_ns() < deadline_ns) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    sampler.drain(samples);
  }
  full->delay_ms = 0;
  sampler.stop();
  EXPECT_GE(count(energy), 3);
  EXPECT_GE(count(steal), 5 * count(energy));
}

}  // namespace
}  // namespace energyprof::probe
