#include "app/gpu_counters.h"

#include <gtest/gtest.h>
#include <stdlib.h>

#include <filesystem>
#include <fstream>

namespace energyprof::app {
namespace {

namespace fs = std::filesystem;

TEST(GpuCounters, OfAnIntelGpuMayNeedAKernelThatAllowsThem) {
  std::string name = (fs::temp_directory_path() / "energyprof-counters-XXXXXX").string();
  const fs::path dir = mkdtemp(name.data());
  kernels::DeviceInfo info;
  info.vendor_id = 0x8086;
  info.no_counters_reason = "the driver offers no VK_KHR_performance_query";
  const auto fix = [&] { return counters_fix(probe::Root(dir.string()), info); };
  EXPECT_EQ(fix(), "");
  const auto write = [&](const fs::path& file, const char* text) {
    fs::create_directories((dir / file).parent_path());
    std::ofstream(dir / file) << text;
  };
  write("proc/sys/dev/i915/perf_stream_paranoid", "1\n");
  EXPECT_EQ(fix(), "sudo sysctl dev.i915.perf_stream_paranoid=0");
  write("proc/sys/dev/xe/observation_paranoid", "1\n");
  EXPECT_EQ(fix(), "sudo sysctl dev.i915.perf_stream_paranoid=0 dev.xe.observation_paranoid=0");
  write("proc/sys/dev/i915/perf_stream_paranoid", "0\n");
  write("proc/sys/dev/xe/observation_paranoid", "0\n");
  EXPECT_EQ(fix(), "");
  write("proc/sys/dev/i915/perf_stream_paranoid", "1\n");
  info.vendor_id = 0x1002;
  EXPECT_EQ(fix(), "");
  info.vendor_id = 0x8086;
  info.performance_counters.emplace_back();
  EXPECT_EQ(fix(), "");
  fs::remove_all(dir);
}

}  // namespace
}  // namespace energyprof::app
