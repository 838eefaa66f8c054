// Which caches are modelled: the config's, the host's, or assumed ones.
#include "app/cache_choice.h"

#include <gtest/gtest.h>

#include <fstream>

namespace energyprof::app {
namespace {

namespace fs = std::filesystem;

kernels::DeviceInfo device(const std::string& type) {
  kernels::DeviceInfo info;
  info.type = type;
  info.subgroup_size = 16;
  return info;
}

const HostCaches laptop{HostCache{48 << 10, 12, 64}, HostCache{24 << 20, 12, 64}};

TEST(CacheChoice, OfACpuDeviceIsTheHosts) {
  const CacheChoice choice = choose_caches({}, device("cpu"), laptop);
  EXPECT_EQ(choice.model.l1.size_bytes, 48u << 10);
  EXPECT_EQ(choice.model.llc.size_bytes, 24u << 20);
  EXPECT_EQ(choice.model.llc.ways, 12u);
  EXPECT_EQ(choice.model.lanes, 16u);
  EXPECT_EQ(choice.l1_source, "host");
  EXPECT_EQ(choice.llc_source, "host");
}

TEST(CacheChoice, OfAGpuIsAssumed) {
  const CacheChoice choice = choose_caches({}, device("integrated"), laptop);
  EXPECT_EQ(choice.model.l1.size_bytes, accel::CacheModelConfig{}.l1.size_bytes);
  EXPECT_EQ(choice.model.llc.size_bytes, accel::CacheModelConfig{}.llc.size_bytes);
  EXPECT_EQ(choice.l1_source, "assumed");
}

TEST(CacheChoice, TheConfigGoesFirst) {
  CacheSettings settings;
  settings.llc_kib = 1024;
  const CacheChoice choice = choose_caches(settings, device("cpu"), laptop);
  EXPECT_EQ(choice.model.llc.size_bytes, 1u << 20);
  EXPECT_EQ(choice.model.llc.ways, 12u);
  EXPECT_EQ(choice.llc_source, "config");
  EXPECT_EQ(choice.l1_source, "host");
}

TEST(CacheChoice, NoMoreWaysThanLines) {
  CacheSettings settings;
  settings.l1_kib = 1;
  settings.l1_ways = 1024;
  settings.line_bytes = 128;
  const CacheChoice choice = choose_caches(settings, device("discrete"), {});
  EXPECT_EQ(choice.model.l1.ways, 8u);
  EXPECT_NO_THROW(accel::CacheLevel{choice.model.l1});
}

TEST(CacheChoice, IsDescribedForTheRecord) {
  accel::CacheModelResult result;
  result.pixel_count = 7;
  const auto text = describe(choose_caches({}, device("cpu"), laptop), result);
  EXPECT_EQ(text["modelled"], true);
  EXPECT_EQ(text["pixels"], 7);
  EXPECT_EQ(text["lanes"], 16);
  EXPECT_EQ(text["l1"]["size_bytes"], 48 << 10);
  EXPECT_EQ(text["llc"]["source"], "host");
}

class HostCachesTest : public testing::Test {
 protected:
  HostCachesTest() {
    std::string pattern = (fs::temp_directory_path() / "energyprof_host_XXXXXX").string();
    root_ = mkdtemp(pattern.data());
  }
  ~HostCachesTest() override { fs::remove_all(root_); }

  void add(int index, const char* level, const char* type, const char* size, const char* ways) {
    const fs::path dir =
        root_ / "sys/devices/system/cpu/cpu0/cache" / ("index" + std::to_string(index));
    fs::create_directories(dir);
    std::ofstream(dir / "level") << level << '\n';
    std::ofstream(dir / "type") << type << '\n';
    std::ofstream(dir / "size") << size << '\n';
    std::ofstream(dir / "ways_of_associativity") << ways << '\n';
    std::ofstream(dir / "coherency_line_size") << "64\n";
  }

  fs::path root_;
};

TEST_F(HostCachesTest, AreTheFirstAndTheLastForData) {
  add(0, "1", "Data", "48K", "12");
  add(1, "1", "Instruction", "32K", "8");
  add(2, "2", "Unified", "1280K", "10");
  add(3, "3", "Unified", "24576K", "12");
  const HostCaches caches = read_host_caches(root_);
  ASSERT_TRUE(caches.l1);
  ASSERT_TRUE(caches.last_level);
  EXPECT_EQ(caches.l1->size_bytes, 48 << 10);
  EXPECT_EQ(caches.l1->ways, 12);
  EXPECT_EQ(caches.l1->line_bytes, 64);
  EXPECT_EQ(caches.last_level->size_bytes, 24 << 20);
}

TEST_F(HostCachesTest, WithoutAllNumbersAreUnknown) {
  EXPECT_FALSE(read_host_caches(root_).l1);
  add(0, "1", "Data", "48K", "0");  // fully associative, or a virtual machine that does not tell
  add(1, "2", "Unified", "big", "8");
  const HostCaches caches = read_host_caches(root_);
  EXPECT_FALSE(caches.l1);
  EXPECT_FALSE(caches.last_level);
}

}  // namespace
}  // namespace energyprof::app
