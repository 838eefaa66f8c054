// NVML against a library of our own that exports the same symbols.
#include "probe/nvml.h"

#include <dlfcn.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <thread>

#include "core/clock.h"
#include "probe/sampler.h"
#include "tree.h"

namespace energyprof::probe {
namespace {

using testing::Contains;
using testing::Field;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

// The stub, held open so that its settings last; all at their defaults again.
class Stub {
 public:
  explicit Stub(const char* path) : path_(path), handle_(dlopen(path, RTLD_NOW | RTLD_LOCAL)) {
    if (handle_ == nullptr) throw std::runtime_error(dlerror());
    set("result", 0);
    set("calls_until_lost", -1);
    set("call_us", 0);
    set("init", 0);
    set("reasons", 1);
    set("energy_mj", 1'000'000);
  }
  ~Stub() { dlclose(handle_); }
  Stub(const Stub&) = delete;
  Stub& operator=(const Stub&) = delete;

  void set(const char* what, long long value) const {
    reinterpret_cast<void (*)(const char*, long long)>(dlsym(handle_, "nvml_stub_set"))(what,
                                                                                        value);
  }
  [[nodiscard]] int open_count() const {
    return reinterpret_cast<int (*)()>(dlsym(handle_, "nvml_stub_open_count"))();
  }
  [[nodiscard]] Discovery discover(const Root& root = Root()) const {
    Discovery found;
    discover_nvml(root, Selection{.sources = {"nvml"}, .nvml_library = path_}, found);
    return found;
  }

 private:
  std::string path_;
  void* handle_;
};

TEST(Nvml, ReadsEveryGpu) {
  const Stub stub(NVML_STUB);
  const Discovery found = stub.discover();
  ASSERT_THAT(found.sources, SizeIs(2));
  auto readings = poll_all(found);
  EXPECT_EQ(readings["nvml.gpu0.energy"].value, 1'000'000);
  EXPECT_EQ(readings["nvml.gpu1.energy"].value, 1'000'001);
  EXPECT_EQ(readings["nvml.gpu0.power_instant"].value, 42'000);
  EXPECT_EQ(readings.count("nvml.gpu0.power"), 0u);
  EXPECT_EQ(readings["nvml.gpu0.graphics_freq"].value, 1'980);
  EXPECT_EQ(readings["nvml.gpu0.mem_freq"].value, 10'501);
  EXPECT_EQ(readings["nvml.gpu0.temp"].value, 61);
  EXPECT_EQ(readings.count("nvml.gpu0.mem_temp"), 0u);  // not supported
  EXPECT_EQ(readings["nvml.gpu0.power_limit"].value, 450'000);
  EXPECT_EQ(readings["nvml.gpu0.utilization"].value, 97);
  EXPECT_EQ(readings["nvml.gpu0.mem_utilization"].value, 41);
  EXPECT_EQ(readings["nvml.gpu0.violation.power"].value, 5'000'000'000);
  EXPECT_EQ(channel_called(found, "nvml.gpu0.temp").limit, 93);
  EXPECT_EQ(channel_called(found, "nvml.gpu0.sm_freq").limit, 2'520);
  EXPECT_EQ(channel_called(found, "nvml.gpu0.energy").unit, Unit::millijoule);
  EXPECT_EQ(found.sources[0]->traits().gpu, "0000:01:00.0");
  EXPECT_EQ(found.sources[1]->traits().gpu, "0000:2d:00.0");
  EXPECT_TRUE(found.sources[0]->traits().slow);
  EXPECT_THAT(found.missing, IsEmpty());
}

TEST(Nvml, TellsThrottlingFromIdlingAndSetClocks) {
  const Stub stub(NVML_STUB);
  const Discovery found = stub.discover();
  const auto set_flags = [&](long long reasons) {
    stub.set("reasons", reasons);
    std::vector<std::string> names;
    for (const auto& [name, reading] : poll_all(found))
      if (name.starts_with("nvml.gpu0.") && channel_called(found, name).kind == Kind::flag &&
          reading.value == 1)
        names.push_back(name.substr(10));
    return names;
  };
  EXPECT_THAT(set_flags(0x1), testing::ElementsAre("status.idle"));
  EXPECT_THAT(set_flags(0x44),
              testing::ElementsAre("throttle.hw_thermal", "throttle.sw_power_cap"));
  EXPECT_THAT(set_flags(0xa8), testing::ElementsAre("throttle.hw_power_brake",
                                                    "throttle.hw_slowdown", "throttle.sw_thermal"));
  EXPECT_THAT(set_flags(0x1112), testing::ElementsAre("status.app_clocks", "status.display",
                                                      "status.other", "status.sync_boost"));
  EXPECT_EQ(channel_called(found, "nvml.gpu0.throttle.hw_slowdown").quantity, Quantity::throttle);
  EXPECT_NE(channel_called(found, "nvml.gpu0.status.app_clocks").quantity, Quantity::throttle);
}

TEST(Nvml, DoesWithoutWhatAnOldDriverLacks) {
  const Stub stub(NVML_STUB_OLD);
  stub.set("reasons", 0x4);
  const Discovery found = stub.discover();
  auto readings = poll_all(found);
  EXPECT_EQ(readings.count("nvml.gpu0.energy"), 0u);
  EXPECT_EQ(readings["nvml.gpu0.power"].value, 33'000);
  EXPECT_EQ(channel_called(found, "nvml.gpu0.power").kind, Kind::average);
  EXPECT_EQ(readings["nvml.gpu0.throttle.sw_power_cap"].value, 1);
}

TEST(Nvml, SaysWhyThereIsNothing) {
  const Stub stub(NVML_STUB);
  stub.set("result", 3);
  EXPECT_THAT(stub.discover().missing,
              Contains(Field(&Missing::reason, HasSubstr("GPU 0 answers nothing"))));
  stub.set("init", 9);
  EXPECT_THAT(
      stub.discover().missing,
      Contains(Field(&Missing::reason, HasSubstr("does not start: Stub error (NVML error 9)"))));
  Discovery none;
  discover_nvml(Root(), Selection{.sources = {}, .nvml_library = "libno-such-thing.so"}, none);
  EXPECT_THAT(none.missing, Contains(Field(&Missing::reason, HasSubstr("no NVIDIA driver"))));
}

TEST(Nvml, LosesAGpuThatFellOffTheBusAndBearsPassingErrors) {
  const Stub stub(NVML_STUB);
  const Discovery found = stub.discover();
  stub.set("result", 4);
  EXPECT_EQ(poll_all(found)["nvml.gpu0.temp"].status, PollStatus::retry);
  EXPECT_EQ(poll_all(found)["nvml.gpu0.temp"].error, EACCES);
  stub.set("result", 0);
  EXPECT_EQ(poll_all(found)["nvml.gpu0.temp"].status, PollStatus::ok);
  stub.set("calls_until_lost", 3);
  static_cast<void>(poll_all(found));
  EXPECT_EQ(poll_all(found)["nvml.gpu0.temp"].status, PollStatus::gone);
}

TEST(Nvml, DoesNotAskAGpuThatSleeps) {
  const Stub stub(NVML_STUB);
  const std::string status = "sys/bus/pci/devices/0000:01:00.0/power/runtime_status";
  const Tree tree{{status, "active\n"}};
  const Discovery found = stub.discover(tree.root());
  tree.write({{status, "suspended\n"}});
  EXPECT_EQ(poll_all(found)["nvml.gpu0.energy"].status, PollStatus::retry);
  EXPECT_EQ(poll_all(found)["nvml.gpu1.energy"].status, PollStatus::ok);
}

TEST(Nvml, ClosesTheLibraryWithTheLastSource) {
  const Stub stub(NVML_STUB);
  {
    Discovery found = stub.discover();
    EXPECT_EQ(stub.open_count(), 1);
    found.sources.erase(found.sources.begin());
    EXPECT_EQ(stub.open_count(), 1);
  }
  EXPECT_EQ(stub.open_count(), 0);
}

TEST(Nvml, DelaysNoOtherSourceWithItsSlowCalls) {
  const Stub stub(NVML_STUB);
  Discovery found = stub.discover();
  Discovery quick = discover(Root(), Selection{.sources = {"proc_stat"}});
  ASSERT_THAT(quick.sources, SizeIs(1));
  int32_t id = 0;
  for (const auto& source : found.sources)
    for (Channel& channel : source->channels()) channel.id = ++id;
  for (Channel& channel : quick.sources[0]->channels()) channel.id += 1000;
  const int32_t quick_id = std::as_const(*quick.sources[0]).channels()[0].id;
  found.sources.push_back(std::move(quick.sources[0]));
  stub.set("call_us", 30'000);
  Sampler sampler(found.sources);
  sampler.start();
  const int32_t gpu_id = channel_called(found, "nvml.gpu0.energy").id;
  const int64_t deadline_ns = now_ns() + 60 * ns_per_s;
  int64_t quick_count = 0;
  int64_t gpu_count = 0;
  std::vector<Sample> samples;
  while (quick_count < 40 && now_ns() < deadline_ns) {
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
    samples.clear();
    sampler.drain(samples);
    for (const Sample& sample : samples) {
      quick_count += sample.channel_id == quick_id ? 1 : 0;
      gpu_count += sample.channel_id == gpu_id ? 1 : 0;
    }
  }
  EXPECT_EQ(sampler.stats().thread_count, 3);
  // A poll of a GPU takes 30 ms times its dozen calls; on one thread each would hold the other up.
  EXPECT_GE(quick_count, 40);
  EXPECT_GT(quick_count, 4 * gpu_count);
  stub.set("call_us", 0);
}

}  // namespace
}  // namespace energyprof::probe
