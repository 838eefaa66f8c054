// AMD GPUs: captured machines, and tables of every revision written here by hand.
#include "probe/amdgpu.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cerrno>
#include <fstream>
#include <iterator>

#include "allocation_count.h"
#include "core/clock.h"
#include "probe/gpu_metrics.h"
#include "tree.h"

namespace energyprof::probe {
namespace {

using testing::AllOf;
using testing::Contains;
using testing::ElementsAre;
using testing::Field;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::IsSupersetOf;
using testing::Not;
using testing::SizeIs;
using testing::UnorderedElementsAre;

const std::string device = "sys/class/drm/card0/device/";

Discovery discover_card(const Root& root) { return discover(root, Selection{{"amdgpu"}}); }

auto missing_because(const std::string& reason, const std::string& fix = "") {
  return Contains(AllOf(Field(&Missing::source, "amdgpu"),
                        Field(&Missing::reason, HasSubstr(reason)),
                        Field(&Missing::fix, HasSubstr(fix))));
}

std::string file_of(const std::string& machine, const std::string& file) {
  std::ifstream in(Tree::machine_dir(machine) / file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

// A table in which every member is marked as unsupported, and some are then given values.
class Table {
 public:
  Table(int format, int content, size_t size) : bytes_(size, '\xff') {
    put(0, 2, size)
        .put(2, 1, static_cast<uint64_t>(format))
        .put(3, 1, static_cast<uint64_t>(content));
  }
  Table& put(size_t offset, size_t width, uint64_t value) {
    for (size_t i = 0; i < width; ++i) bytes_[offset + i] = static_cast<char>(value >> (8 * i));
    return *this;
  }
  [[nodiscard]] const std::string& bytes() const { return bytes_; }

 private:
  std::string bytes_;
};

// A card with this table.
void write_card(const Tree& tree, const std::string& table, const std::string& pci_id = "7480") {
  tree.write({{device + "uevent",
               "DRIVER=amdgpu\nPCI_ID=1002:" + pci_id + "\nPCI_SLOT_NAME=0000:03:00.0\n"},
              {device + "gpu_metrics", table}});
}

// What a poll gives, in a line: the value and its unit, or why there is none.
std::string text_of(const Discovery& found, std::map<std::string, Reading>& readings,
                    const std::string& name) {
  if (readings.count(name) == 0) return "no channel";
  const Reading& reading = readings[name];
  if (reading.status == PollStatus::retry) return "retry";
  if (reading.status == PollStatus::gone) return "gone";
  return std::to_string(reading.value) + " " +
         std::string(unit_info(channel_called(found, name).unit).name);
}

using Expected = std::map<std::string, std::string>;

void expect_values(const Discovery& found, const Expected& expected) {
  auto readings = poll_all(found);
  for (const auto& [name, text] : expected)
    EXPECT_EQ(text_of(found, readings, "amdgpu." + name), text) << name;
}

// Names of the throttle flags that are set.
std::vector<std::string> throttled_by(const Discovery& found) {
  std::vector<std::string> names;
  for (const auto& [name, reading] : poll_all(found))
    if (channel_called(found, name).quantity == Quantity::throttle && reading.value != 0)
      names.push_back(name);
  return names;
}

TEST(PhoenixGpu, GivesWhatItsTableIsExpectedToHold) {
  const std::string machine = "amd-phoenix-apu";
  const Discovery found = discover_card(Root(Tree::machine_dir(machine).string()));
  const std::string table = file_of(machine, "sys/class/drm/card1/device/gpu_metrics");
  EXPECT_THAT(table, SizeIs(120));
  EXPECT_EQ(metrics_revision(table), (MetricsRevision{2, 1}));
  expect_values(found, {{"temp_gfx", "2500 cC"},
                        {"temp_soc", "2737 cC"},
                        {"socket_power", "3401 mW"},
                        {"soc_power", "743 mW"},
                        {"gfx_power", "585 mW"},
                        {"cpu_power", "no channel"},
                        {"gfx_freq", "800 MHz"},
                        {"mem_freq", "400 MHz"},
                        {"activity", "79 c%"},
                        {"busy", "0 %"},
                        {"mem_busy", "no channel"}});
  // current_gfxclk is invalid.
  const Channel clock = channel_called(found, "amdgpu.gfx_freq");
  EXPECT_THAT(clock.origin, HasSubstr("average_gfxclk_frequency"));
  EXPECT_EQ(clock.kind, Kind::average);
  EXPECT_EQ(clock.limit, 2700);
  EXPECT_THAT(throttled_by(found), IsEmpty());
  EXPECT_THAT(channel_called(found, "amdgpu.throttle.spl").origin,
              AllOf(HasSubstr("throttle_status"), Not(HasSubstr("indep"))));
  EXPECT_EQ(channel_called(found, "amdgpu.throttle.temp_gpu").kind, Kind::flag);
  EXPECT_THAT(found.missing, IsEmpty());
  // power/control says that it is never suspended.
  EXPECT_FALSE(clock.wakes_device);
  EXPECT_EQ(clock.gpu, "0000:64:00.0");
  EXPECT_EQ(clock.period_ns, 10 * ns_per_ms);
  EXPECT_TRUE(found.sources[0]->traits().slow);
}

TEST(PhoenixGpu, TellsItsPowerFinerThanHwmonDoes) {
  const Discovery found = discover(Root(Tree::machine_dir("amd-phoenix-apu").string()));
  auto readings = poll_all(found);
  // hwmon prints 3 W + 103/256 W as if 103 were milliwatts.
  EXPECT_EQ(readings["hwmon.amdgpu.ppt.power_average"].value, 3'103'000);
  EXPECT_EQ(readings["amdgpu.socket_power"].value, 3'401);
  const std::vector<std::string> names = names_of(found);
  EXPECT_LT(std::find(names.begin(), names.end(), "amdgpu.socket_power"),
            std::find(names.begin(), names.end(), "hwmon.amdgpu.ppt.power_average"));
}

TEST(VanGoghGpu, GivesWhatItsTableIsExpectedToHold) {
  const std::string machine = "amd-vangogh-apu";
  const Discovery found = discover_card(Root(Tree::machine_dir(machine).string()));
  const std::string table = file_of(machine, "sys/class/drm/card0/device/gpu_metrics");
  EXPECT_THAT(table, SizeIs(152));
  EXPECT_EQ(metrics_revision(table), (MetricsRevision{2, 3}));
  expect_values(found, {{"temp_gfx", "6810 cC"},
                        {"temp_soc", "6520 cC"},
                        {"socket_power", "14980 mW"},
                        {"cpu_power", "4100 mW"},
                        {"soc_power", "2300 mW"},
                        {"gfx_power", "8100 mW"},
                        {"gfx_freq", "1040 MHz"},
                        {"activity", "9700 c%"},
                        {"busy", "0 %"}});
  EXPECT_THAT(channel_called(found, "amdgpu.gfx_freq").origin, HasSubstr("current_gfxclk"));
  EXPECT_EQ(channel_called(found, "amdgpu.socket_power").limit, 15'000);
  EXPECT_THAT(throttled_by(found),
              UnorderedElementsAre("amdgpu.throttle.sppt", "amdgpu.throttle.temp_gpu"));
  EXPECT_THAT(channel_called(found, "amdgpu.throttle.sppt").origin,
              HasSubstr("indep_throttle_status"));
  // The average of the same clock, and the raw status, which says the same: SPPT + THM_GFX.
  for (const MetricsField& field : metrics_fields({2, 3}, 0x163f)) {
    if (field.member == "average_gfxclk_frequency") {
      EXPECT_EQ(field.value(table), 1580);
    } else if (field.member == "throttle_status") {
      EXPECT_EQ(field.value(table),
                field.name == "throttle.sppt" || field.name == "throttle.temp_gpu")
          << field.name;
    }
  }
}

TEST(Rx7600s, GivesWhatItsTableIsExpectedToHoldAndIsNotThrottled) {
  const std::string machine = "amd-rx7600s-dgpu";
  const Discovery found = discover_card(Root(Tree::machine_dir(machine).string()));
  const std::string table = file_of(machine, "sys/class/drm/card1/device/gpu_metrics");
  EXPECT_THAT(table, SizeIs(120));
  EXPECT_EQ(metrics_revision(table), (MetricsRevision{1, 3}));
  expect_values(found, {{"temp_edge", "53 C"},
                        {"temp_hotspot", "54 C"},
                        {"temp_mem", "60 C"},
                        {"temp_vrgfx", "no channel"},  // 0
                        {"socket_power", "1 W"},
                        {"gfx_freq", "1200 MHz"},
                        {"mem_freq", "96 MHz"},
                        {"activity", "0 %"},
                        {"energy", "no channel"},
                        {"status.hotspot", "1 count"},
                        {"status.unnamed", "0 count"},
                        {"busy", "0 %"}});
  EXPECT_THAT(channel_called(found, "amdgpu.gfx_freq").origin, HasSubstr("current_gfxclk"));
  EXPECT_THAT(throttled_by(found), IsEmpty());
  EXPECT_EQ(channel_called(found, "amdgpu.status.hotspot").quantity, Quantity::utilization);
  EXPECT_EQ(channel_called(found, "amdgpu.temp_edge").limit, 100);
  EXPECT_EQ(channel_called(found, "amdgpu.temp_mem").limit, 105);
  EXPECT_EQ(channel_called(found, "amdgpu.socket_power").limit, 95);
  EXPECT_EQ(channel_called(found, "amdgpu.mem_freq").limit, 1000);
  // It may be suspended, and then a read may wake it.
  EXPECT_TRUE(channel_called(found, "amdgpu.gfx_freq").wakes_device);
  EXPECT_TRUE(channel_called(found, "amdgpu.busy").wakes_device);
}

TEST(VegaGpu, GivesClocksFromItsListsOfLevels) {
  const Discovery found = discover_card(Root(Tree::machine_dir("amd-vega-dgpu-procfs").string()));
  EXPECT_THAT(names_of(found), UnorderedElementsAre("amdgpu.busy", "amdgpu.gfx_freq",
                                                    "amdgpu.mem_freq", "amdgpu.soc_freq"));
  expect_values(
      found,
      {{"busy", "4 %"}, {"gfx_freq", "852 MHz"}, {"mem_freq", "167 MHz"}, {"soc_freq", "720 MHz"}});
  EXPECT_EQ(channel_called(found, "amdgpu.gfx_freq").limit, 1630);
  EXPECT_THAT(found.missing, missing_because("gpu_metrics' is not there"));
}

// A revision, its size, members at offsets as the kernel's header lays them out, and what comes
// out. Every member has a value of its own, so that none can be taken for another.
struct Layout {
  int format, content;
  size_t size;
  struct Member {
    size_t offset, width;
    uint64_t value;
  };
  std::vector<Member> members;
  Expected expected;
  std::string pci_id = "7480";
};

const std::vector<Layout> layouts{
    {1,
     0,
     80,
     {{8, 8, 123456789},  // time
      {16, 2, 61},
      {18, 2, 62},
      {20, 2, 63},
      {22, 2, 64},
      {24, 2, 65},
      {26, 2, 66},
      {28, 2, 71},
      {30, 2, 72},
      {34, 2, 250},
      {36, 4, 4711},  // energy in a unit that is not documented
      {54, 2, 2100},
      {56, 2, 1101},
      {58, 2, 875},
      {68, 4, 0xff}},  // throttle status of one chip only
     {{"temp_edge", "61 C"},
      {"temp_hotspot", "62 C"},
      {"temp_mem", "63 C"},
      {"temp_vrgfx", "64 C"},
      {"temp_vrsoc", "65 C"},
      {"temp_vrmem", "66 C"},
      {"activity", "71 %"},
      {"mem_activity", "72 %"},
      {"socket_power", "250 W"},
      {"energy", "no channel"},
      {"gfx_freq", "2100 MHz"},
      {"soc_freq", "1101 MHz"},
      {"mem_freq", "875 MHz"},
      {"throttle.ppt0", "no channel"}}},
    {1,
     1,
     96,
     {{4, 2, 61},
      {6, 2, 62},
      {8, 2, 63},
      {10, 2, 64},
      {12, 2, 65},
      {14, 2, 66},
      {16, 2, 71},
      {18, 2, 72},
      {22, 2, 180},
      {24, 8, 4711},
      {40, 2, 2050},
      {42, 2, 1051},
      {44, 2, 855},
      {68, 4, 0xff}},
     {{"temp_edge", "61 C"},
      {"temp_hotspot", "62 C"},
      {"temp_mem", "63 C"},
      {"temp_vrgfx", "64 C"},
      {"temp_vrsoc", "65 C"},
      {"temp_vrmem", "66 C"},
      {"activity", "71 %"},
      {"mem_activity", "72 %"},
      {"socket_power", "180 W"},
      {"energy", "no channel"},
      {"gfx_freq", "2050 MHz"},  // only the averages are supported
      {"soc_freq", "1051 MHz"},
      {"mem_freq", "855 MHz"},
      {"throttle.ppt0", "no channel"}}},
    {1,
     2,
     104,
     {{4, 2, 61}, {22, 2, 181}, {40, 2, 2050}, {54, 2, 2101}, {56, 2, 1102}, {58, 2, 876}},
     {{"temp_edge", "61 C"},
      {"socket_power", "181 W"},
      {"gfx_freq", "2101 MHz"},
      {"soc_freq", "1102 MHz"},
      {"mem_freq", "876 MHz"},
      {"throttle.ppt0", "no channel"}}},
    // An MI250, the counter of which counts 2^-16 J.
    {1,
     3,
     120,
     {{6, 2, 62}, {22, 2, 300}, {24, 8, 65536ULL * 1000}, {54, 2, 1700}, {112, 8, 1}},
     {{"temp_edge", "no channel"},
      {"temp_hotspot", "62 C"},
      {"socket_power", "300 W"},
      {"energy", "1000000000 uJ"},
      {"gfx_freq", "1700 MHz"},
      {"throttle.ppt0", "1 count"},
      {"throttle.ppt1", "0 count"}},
     "740c"},
    {1,
     4,
     288,
     {{4, 2, 62},
      {6, 2, 63},
      {8, 2, 65},
      {10, 2, 712},
      {12, 2, 98},
      {14, 2, 33},
      {24, 8, 65536ULL * 2 + 1},
      {40, 4, 1},
      {240, 2, 2102},
      {242, 2, 99},
      {256, 2, 1103},
      {280, 2, 1300}},
     {{"temp_hotspot", "62 C"},
      {"temp_mem", "63 C"},
      {"temp_vrsoc", "65 C"},
      {"socket_power", "712 W"},
      {"activity", "98 %"},
      {"mem_activity", "33 %"},
      {"energy", "2000015 uJ"},
      {"gfx_freq", "2102 MHz"},
      {"soc_freq", "1103 MHz"},
      {"mem_freq", "1300 MHz"},
      {"throttle.ppt0", "no channel"}}},
    {1,
     5,
     360,
     {{4, 2, 62},
      {6, 2, 63},
      {8, 2, 65},
      {10, 2, 713},
      {12, 2, 97},
      {14, 2, 34},
      {88, 8, 65536ULL * 3},
      {312, 2, 2103},
      {328, 2, 1104},
      {352, 2, 1301}},
     {{"temp_hotspot", "62 C"},
      {"temp_mem", "63 C"},
      {"temp_vrsoc", "65 C"},
      {"socket_power", "713 W"},
      {"activity", "97 %"},
      {"mem_activity", "34 %"},
      {"energy", "3000000 uJ"},
      {"gfx_freq", "2103 MHz"},
      {"soc_freq", "1104 MHz"},
      {"mem_freq", "1301 MHz"}}},
    {2,
     0,
     120,
     {{16, 2, 5510},
      {18, 2, 5020},
      {40, 2, 4321},
      {44, 2, 15001},
      {46, 2, 6002},
      {48, 2, 2003},
      {50, 2, 7004},
      {68, 2, 1601},
      {80, 2, 1701},
      {82, 2, 1102},
      {84, 2, 1203},
      {86, 2, 1304},
      {112, 4, 1U << 10}},
     {{"temp_gfx", "5510 cC"},
      {"temp_soc", "5020 cC"},
      {"activity", "4321 c%"},
      {"socket_power", "15001 mW"},
      {"cpu_power", "6002 mW"},
      {"soc_power", "2003 mW"},
      {"gfx_power", "7004 mW"},
      {"gfx_freq", "1701 MHz"},
      {"soc_freq", "1102 MHz"},
      {"mem_freq", "1203 MHz"},
      {"fclk_freq", "1304 MHz"},
      {"throttle.prochot_gfx", "1 count"},
      {"throttle.edc_gfx", "0 count"},
      {"throttle.tdc_cvip", "no channel"}},
     "1636"},
    {2,
     1,
     120,
     {{4, 2, 5510},
      {6, 2, 5020},
      {28, 2, 4321},
      {40, 2, 15001},
      {42, 2, 6002},
      {44, 2, 2003},
      {46, 2, 7004},
      {64, 2, 1601},
      {66, 2, 1002},
      {68, 2, 1003},
      {70, 2, 1005},
      {108, 4, 1U << 5}},
     {{"temp_gfx", "5510 cC"},
      {"temp_soc", "5020 cC"},
      {"activity", "4321 c%"},
      {"socket_power", "15001 mW"},
      {"cpu_power", "6002 mW"},
      {"soc_power", "2003 mW"},
      {"gfx_power", "7004 mW"},
      {"gfx_freq", "1601 MHz"},
      {"soc_freq", "1002 MHz"},
      {"mem_freq", "1003 MHz"},
      {"fclk_freq", "1005 MHz"},
      {"throttle.temp_gpu", "1 count"},
      {"throttle.temp_core", "0 count"}},
     "1681"},
    // indep_throttle_status is not filled in: the raw one decides.
    {2,
     2,
     128,
     {{40, 2, 15001}, {76, 2, 1701}, {78, 2, 1102}, {80, 2, 1203}, {82, 2, 1304}, {108, 4, 2}},
     {{"socket_power", "15001 mW"},
      {"gfx_freq", "1701 MHz"},
      {"soc_freq", "1102 MHz"},
      {"mem_freq", "1203 MHz"},
      {"fclk_freq", "1304 MHz"},
      {"throttle.fppt", "1 count"},
      {"throttle.sppt", "0 count"},
      {"throttle.ppt0", "no channel"}},
     "1636"},
    {2,
     4,
     168,
     {{4, 2, 5510}, {40, 2, 15001}, {108, 4, 0}, {120, 8, 1ULL << 47 | 1ULL << 6}, {128, 2, 9999}},
     {{"temp_gfx", "5510 cC"},
      {"socket_power", "15001 mW"},
      {"throttle.prochot_gfx", "1 count"},
      {"throttle.sppt", "1 count"},
      {"throttle.fppt", "0 count"},
      {"status.hotspot", "0 count"}},
     "1435"},
    // The captured Strix, as far as it is known; what it did not have, with other values.
    {3,
     0,
     264,
     {{4, 2, 5510},    {6, 2, 5020},   {40, 2, 4120},   {42, 2, 12},    {94, 2, 2504},
      {96, 2, 637},    {112, 4, 9839}, {120, 4, 9800},  {124, 4, 1536}, {132, 4, 2499},
      {168, 2, 63536},  // junk
      {174, 2, 1601},  {176, 2, 1102}, {182, 2, 1304},  {186, 2, 1203}, {224, 2, 2900},
      {228, 4, 11},    {232, 4, 12},   {236, 4, 92382}, {240, 4, 14},   {244, 4, 15},
      {248, 4, 16},    {252, 4, 17},   {256, 4, 1000}},
     {{"temp_gfx", "5510 cC"},
      {"temp_soc", "5020 cC"},
      {"temp_skin", "4120 cC"},
      {"activity", "12 %"},
      {"dram_read", "2504 MB/s"},
      {"dram_write", "637 MB/s"},
      {"socket_power", "9839 mW"},
      {"apu_power", "9800 mW"},
      {"gfx_power", "1536 mW"},
      {"cpu_power", "2499 mW"},
      {"gfx_freq", "1601 MHz"},
      {"soc_freq", "1102 MHz"},
      {"fclk_freq", "1304 MHz"},
      {"mem_freq", "1203 MHz"},
      {"gfx_max_freq", "2900 MHz"},
      {"throttle.prochot_residency", "11 count"},
      {"throttle.spl_residency", "12 count"},
      {"throttle.fppt_residency", "92382 count"},
      {"throttle.sppt_residency", "14 count"},
      {"throttle.thm_core_residency", "15 count"},
      {"throttle.thm_gfx_residency", "16 count"},
      {"throttle.thm_soc_residency", "17 count"}},
     "150e"}};

std::string table_of(const Layout& layout) {
  Table table(layout.format, layout.content, layout.size);
  for (const Layout::Member& member : layout.members)
    table.put(member.offset, member.width, member.value);
  return table.bytes();
}

class Revision : public testing::TestWithParam<Layout> {};

TEST_P(Revision, IsReadAtItsOwnOffsets) {
  const Tree tree;
  write_card(tree, table_of(GetParam()), GetParam().pci_id);
  const Discovery found = discover_card(tree.root());
  expect_values(found, GetParam().expected);
  for (const auto& source : found.sources)
    for (const Channel& channel : source->channels())
      EXPECT_TRUE(GetParam().expected.contains(channel.name.substr(7)) ||
                  channel.kind == Kind::flag)
          << channel.name << " is not expected";
}

TEST_P(Revision, MarksNothingAsSupportedThatIsNot) {
  const Tree tree;
  write_card(tree, Table(GetParam().format, GetParam().content, GetParam().size).bytes(),
             GetParam().pci_id);
  const Discovery found = discover_card(tree.root());
  EXPECT_THAT(found.sources, IsEmpty());
  EXPECT_THAT(found.missing,
              ElementsAre(Field(&Missing::reason, HasSubstr("marks every value as unsupported"))));
}

TEST_P(Revision, IsRefusedWhenItsSizeIsWrong) {
  const Layout& layout = GetParam();
  const std::string table = table_of(layout);
  const auto reason_for = [&](const std::string& bytes) {
    const Tree tree;
    write_card(tree, bytes);
    const Discovery found = discover_card(tree.root());
    EXPECT_THAT(found.sources, IsEmpty());
    return found.missing.size() == 1 ? found.missing[0].reason : "not one reason";
  };
  // Cut off.
  EXPECT_THAT(reason_for(table.substr(0, table.size() - 1)),
              HasSubstr(std::to_string(layout.size - 1) + " that can be read"));
  EXPECT_THAT(reason_for(table.substr(0, 4)), HasSubstr("of the 4 that can be read"));
  // Says less than its layout has.
  std::string small = table;
  small[0] = static_cast<char>(layout.size - 8);
  small[1] = static_cast<char>((layout.size - 8) >> 8);
  EXPECT_THAT(reason_for(small), HasSubstr("says that it has " + std::to_string(layout.size - 8)));
  // Says more, and is longer: members were added at the end.
  std::string large = table + std::string(8, '\0');
  large[0] = static_cast<char>(layout.size + 8);
  large[1] = static_cast<char>((layout.size + 8) >> 8);
  EXPECT_EQ(metrics_problem(large), "");
  // Longer than it says.
  EXPECT_EQ(metrics_problem(table + std::string(8, '\0')), "");
}

INSTANTIATE_TEST_SUITE_P(All, Revision, testing::ValuesIn(layouts), [](const auto& layout) {
  return "v" + std::to_string(layout.param.format) + "_" + std::to_string(layout.param.content);
});

TEST(GpuMetrics, AreTakenApartByRevisionAndNeverBySize) {
  // The same 120 bytes.
  Table table(1, 3, 120);
  table.put(40, 2, 1234).put(22, 2, 77).put(54, 2, 600);
  const auto power_of = [&](int format, int content) {
    table.put(2, 1, static_cast<uint64_t>(format)).put(3, 1, static_cast<uint64_t>(content));
    const Tree tree;
    write_card(tree, table.bytes());
    const Discovery found = discover_card(tree.root());
    auto readings = poll_all(found);
    return text_of(found, readings, "amdgpu.socket_power");
  };
  EXPECT_EQ(power_of(1, 3), "77 W");
  EXPECT_EQ(power_of(2, 1), "1234 mW");
  EXPECT_EQ(power_of(2, 0), "no channel");  // all bits set at 44
}

TEST(GpuMetrics, OfUnknownRevisionsCannotBeObserved) {
  for (const auto& [format, content] : std::vector<std::pair<int, int>>{
           {0, 0}, {0, 1}, {1, 6}, {1, 8}, {1, 255}, {2, 5}, {3, 1}, {4, 0}, {255, 255}}) {
    const Tree tree;
    write_card(tree, Table(format, content, 400).bytes());
    const Discovery found = discover_card(tree.root());
    EXPECT_THAT(found.sources, IsEmpty());
    EXPECT_THAT(found.missing,
                ElementsAre(Field(&Missing::reason,
                                  AllOf(HasSubstr("unknown revision " + std::to_string(format) +
                                                  "." + std::to_string(content)),
                                        HasSubstr("cannot be observed")))));
    EXPECT_THAT(metrics_fields({static_cast<uint8_t>(format), static_cast<uint8_t>(content)}, 0),
                IsEmpty());
  }
}

TEST(GpuMetrics, ThatAreNoTableAreRefused) {
  for (const std::string& text : {std::string(), std::string("\x78", 1), std::string("abc")}) {
    const Tree tree;
    write_card(tree, text);
    EXPECT_THAT(discover_card(tree.root()).missing, missing_because("fewer than its header"));
  }
  for (const std::string& text :
       {std::string("no such luck\n"), std::string(10 << 20, '\0'), std::string(300, '\xff')}) {
    const Tree tree;
    write_card(tree, text);
    EXPECT_THAT(discover_card(tree.root()).missing, missing_because("unknown revision"));
  }
}

struct Bit {
  int position;
  std::string name;
};
const std::vector<Bit> independent_bits{
    {0, "ppt0"},          {1, "ppt1"},          {2, "ppt2"},          {3, "ppt3"},
    {4, "spl"},           {5, "fppt"},          {6, "sppt"},          {7, "sppt_apu"},
    {16, "tdc_gfx"},      {17, "tdc_soc"},      {18, "tdc_mem"},      {19, "tdc_vdd"},
    {20, "tdc_cvip"},     {21, "edc_cpu"},      {22, "edc_gfx"},      {23, "apcc"},
    {32, "temp_gpu"},     {33, "temp_core"},    {34, "temp_mem"},     {35, "temp_edge"},
    {37, "temp_soc"},     {38, "temp_vr_gfx"},  {39, "temp_vr_soc"},  {40, "temp_vr_mem0"},
    {41, "temp_vr_mem1"}, {42, "temp_liquid0"}, {43, "temp_liquid1"}, {44, "vrhot0"},
    {45, "vrhot1"},       {46, "prochot_cpu"},  {47, "prochot_gfx"},  {56, "ppm"},
    {57, "fit"}};
const std::vector<Bit> apu_bits{
    {0, "spl"},          {1, "fppt"},     {2, "sppt"},    {3, "sppt_apu"}, {4, "temp_core"},
    {5, "temp_gpu"},     {6, "temp_soc"}, {7, "tdc_vdd"}, {8, "tdc_soc"},  {9, "prochot_cpu"},
    {10, "prochot_gfx"}, {11, "edc_cpu"}, {12, "edc_gfx"}};
const std::vector<Bit> vangogh_bits{{0, "spl"},      {1, "fppt"},      {2, "sppt"},
                                    {3, "sppt_apu"}, {4, "temp_core"}, {5, "temp_gpu"},
                                    {6, "temp_soc"}, {7, "tdc_vdd"},   {8, "tdc_soc"},
                                    {9, "tdc_gfx"},  {10, "tdc_cvip"}};

// Sets one bit after the other and looks which flags show it.
void expect_bits(Table table, size_t offset, size_t width, const std::string& pci_id,
                 const std::vector<Bit>& bits) {
  table.put(offset, width, 0);
  const Tree tree;
  write_card(tree, table.bytes(), pci_id);
  const Discovery found = discover_card(tree.root());
  EXPECT_THAT(throttled_by(found), IsEmpty());
  size_t throttle_count = 0;
  for (const auto& source : found.sources)
    for (const Channel& channel : source->channels())
      throttle_count += channel.quantity == Quantity::throttle;
  EXPECT_EQ(throttle_count, bits.size());
  for (int bit = 0; bit < static_cast<int>(8 * width); ++bit) {
    tree.write(
        {{device + "gpu_metrics", Table(table).put(offset, width, uint64_t{1} << bit).bytes()}});
    const auto named =
        std::find_if(bits.begin(), bits.end(), [&](const Bit& one) { return one.position == bit; });
    const std::vector<std::string> set = throttled_by(found);
    auto readings = poll_all(found);
    const bool is_hotspot = width == 8 && bit == 36;
    if (named != bits.end()) {
      EXPECT_THAT(set, ElementsAre("amdgpu.throttle." + named->name)) << bit;
    } else {
      EXPECT_THAT(set, IsEmpty()) << bit;
    }
    EXPECT_EQ(readings["amdgpu.status.unnamed"].value, named == bits.end() && !is_hotspot) << bit;
    EXPECT_EQ(readings["amdgpu.status.hotspot"].value, is_hotspot) << bit;
  }
}

TEST(GpuMetrics, NameTheBitsOfThrottling) {
  expect_bits(Table(1, 3, 120), 112, 8, "7480", independent_bits);
  expect_bits(Table(2, 2, 128), 120, 8, "1636", independent_bits);
  expect_bits(Table(2, 4, 168), 120, 8, "163f", independent_bits);
  expect_bits(Table(2, 0, 120), 112, 4, "1636", apu_bits);
  expect_bits(Table(2, 1, 120), 108, 4, "15bf", apu_bits);
  expect_bits(Table(2, 1, 120), 108, 4, "163F", vangogh_bits);
  expect_bits(Table(2, 0, 120), 112, 4, "1435", vangogh_bits);
}

TEST(GpuMetrics, SayWhenThrottlingCannotBeTold) {
  const Tree tree;
  write_card(tree, Table(1, 1, 96).put(22, 2, 100).put(68, 4, 0xffff).bytes());
  const Discovery found = discover_card(tree.root());
  EXPECT_THAT(names_of(found), ElementsAre("amdgpu.socket_power"));
  EXPECT_THAT(found.missing, missing_because("revision 1.1 does not tell throttling"));
}

TEST(GpuMetrics, CountResidenciesThatWrapAt32Bits) {
  const Tree tree;
  write_card(tree, Table(3, 0, 264).put(236, 4, 0xffff'fff0).bytes());
  const Discovery found = discover_card(tree.root());
  const Channel channel = channel_called(found, "amdgpu.throttle.fppt_residency");
  EXPECT_EQ(channel.quantity, Quantity::throttle);
  EXPECT_EQ(channel.kind, Kind::cumulative);
  EXPECT_EQ(channel.wrap_at, 0xffff'ffff);
  EXPECT_EQ(poll_all(found)[channel.name].value, 0xffff'fff0);
}

TEST(GpuMetrics, SettleWhatActivityIsCountedIn) {
  const MetricsRevision v2{2, 1};
  const MetricsRevision v3{3, 0};
  EXPECT_EQ(activity_unit(v2, 79, 0), Unit::centipercent);  // Phoenix: 0.79 %
  EXPECT_EQ(activity_unit(v2, 79, 80), Unit::percent);
  EXPECT_EQ(activity_unit(v2, 79, 40), Unit::centipercent);  // neither fits
  EXPECT_EQ(activity_unit(v2, 79, std::nullopt), Unit::centipercent);
  EXPECT_EQ(activity_unit(v2, 3, 2), Unit::centipercent);  // both fit
  EXPECT_EQ(activity_unit(v2, 9700, 0), Unit::centipercent);
  EXPECT_EQ(activity_unit(v2, 100, 100), Unit::percent);
  EXPECT_EQ(activity_unit(v3, 0, 0), Unit::percent);
  EXPECT_EQ(activity_unit(v3, 79, 0), Unit::centipercent);
  EXPECT_EQ(activity_unit(v3, 79, 77), Unit::percent);
  EXPECT_EQ(activity_unit(v3, 101, 1), Unit::centipercent);

  const Tree tree;
  write_card(tree, Table(3, 0, 264).put(42, 2, 4700).bytes());
  tree.write({{device + "gpu_busy_percent", "47\n"}});
  expect_values(discover_card(tree.root()), {{"activity", "4700 c%"}, {"busy", "47 %"}});
  write_card(tree, Table(2, 1, 120).put(28, 2, 47).bytes());
  const Discovery found = discover_card(tree.root());
  expect_values(found, {{"activity", "47 %"}});
  // Not what it was taken for.
  tree.write({{device + "gpu_metrics", Table(2, 1, 120).put(28, 2, 101).bytes()}});
  expect_values(found, {{"activity", "retry"}});
}

TEST(GpuMetrics, SettleWhatAnApusPowerIsCountedIn) {
  EXPECT_EQ(socket_power_unit(3401, 3'103'000), Unit::milliwatt);
  EXPECT_EQ(socket_power_unit(3, 3'103'000), Unit::watt);
  EXPECT_EQ(socket_power_unit(15, 15'000'000), Unit::watt);
  EXPECT_EQ(socket_power_unit(9839, 12'000), Unit::milliwatt);  // hwmon of some says 12 mW
  EXPECT_EQ(socket_power_unit(0, 3'103'000), Unit::milliwatt);
  EXPECT_EQ(socket_power_unit(15, std::nullopt), Unit::milliwatt);

  const Tree tree;
  write_card(tree, Table(2, 2, 128).put(40, 2, 15).bytes(), "1636");
  tree.write({{device + "hwmon/hwmon3/power1_input", "15000000\n"},
              {device + "hwmon/hwmon3/power1_cap", "25000000\n"}});
  const Discovery found = discover_card(tree.root());
  expect_values(found, {{"socket_power", "15 W"}});
  EXPECT_EQ(channel_called(found, "amdgpu.socket_power").limit, 25);
}

TEST(AmdGpu, LosesSingleValuesForAMomentAndAllWithAnotherRevision) {
  const Tree tree;
  const Table table = Table(2, 1, 120).put(40, 2, 5000).put(64, 2, 800).put(108, 4, 0);
  write_card(tree, table.bytes());
  const Discovery found = discover_card(tree.root());
  const auto rewrite = [&](const std::string& bytes) {
    tree.write({{device + "gpu_metrics", bytes}});
  };
  expect_values(found, {{"socket_power", "5000 mW"}, {"gfx_freq", "800 MHz"}});
  rewrite(Table(table).put(40, 2, 0xffff).put(108, 4, 0xffff'ffff).bytes());
  expect_values(found,
                {{"socket_power", "retry"}, {"gfx_freq", "800 MHz"}, {"throttle.spl", "retry"}});
  // A clock that was taken from its average stays so.
  rewrite(Table(table).put(76, 2, 1900).bytes());
  expect_values(found, {{"gfx_freq", "800 MHz"}});
  rewrite(table.bytes().substr(0, 119));
  expect_values(found, {{"socket_power", "retry"}, {"gfx_freq", "retry"}});
  rewrite("");
  expect_values(found, {{"socket_power", "retry"}});
  rewrite(table.bytes());
  expect_values(found, {{"socket_power", "5000 mW"}});
  rewrite(Table(table).put(3, 1, 2).bytes());
  expect_values(found, {{"socket_power", "gone"}, {"gfx_freq", "gone"}, {"throttle.spl", "gone"}});
  rewrite(table.bytes());
  expect_values(found, {{"socket_power", "gone"}});
}

TEST(AmdGpu, IsGoneWithItsFiles) {
  const Tree tree;
  write_card(tree, Table(2, 1, 120).put(40, 2, 5000).put(108, 4, 0).bytes());
  tree.write({{device + "gpu_busy_percent", "3\n"}, {device + "pp_dpm_sclk", "0: 200Mhz *\n"}});
  const Discovery found = discover_card(tree.root());
  EXPECT_THAT(names_of(found),
              IsSupersetOf({"amdgpu.socket_power", "amdgpu.busy", "amdgpu.gfx_freq"}));
  tree.remove(device);
  for (const auto& [name, reading] : poll_all(found)) {
    EXPECT_EQ(reading.status, PollStatus::gone) << name;
    EXPECT_EQ(reading.error, ENOENT) << name;
  }
}

TEST(AmdGpu, ThatSleepsSaysHowToWakeIt) {
  const Tree tree;
  write_card(tree, Table(1, 3, 120).put(22, 2, 10).bytes());
  tree.write({{device + "gpu_busy_percent", "3\n"},
              {device + "pp_dpm_sclk", "0: 500Mhz *\n"},
              {device + "power/control", "auto\n"}});
  const Discovery found = discover_card(tree.root({{device + "gpu_metrics", EPERM},
                                                   {device + "gpu_busy_percent", EPERM},
                                                   {device + "pp_dpm_sclk", EPERM}}));
  EXPECT_THAT(found.missing,
              ElementsAre(AllOf(Field(&Missing::reason, HasSubstr("sleeps")),
                                Field(&Missing::fix, AllOf(HasSubstr("echo on | sudo tee"),
                                                           HasSubstr("power/control"))))));
  // What needs no look into the table stays, and waits.
  EXPECT_THAT(names_of(found), UnorderedElementsAre("amdgpu.busy", "amdgpu.gfx_freq"));
  for (const auto& [name, reading] : poll_all(found)) {
    EXPECT_EQ(reading.status, PollStatus::retry) << name;
    EXPECT_EQ(reading.error, EPERM) << name;
  }
}

TEST(AmdGpu, SaysWhichFilesDoNotWork) {
  const Tree tree;
  write_card(tree, Table(1, 3, 120).bytes());
  tree.write({{device + "gpu_busy_percent", "3\n"},
              {device + "mem_busy_percent", "4\n"},
              {device + "pp_dpm_sclk", "0: 500Mhz *\n"},
              {device + "pp_dpm_mclk", "\n"},
              {device + "pp_dpm_socclk", ""}});
  const Discovery found = discover_card(tree.root({{device + "gpu_metrics", EOPNOTSUPP},
                                                   {device + "gpu_busy_percent", EOPNOTSUPP},
                                                   {device + "mem_busy_percent", EINVAL},
                                                   {device + "pp_dpm_sclk", EIO}}));
  EXPECT_THAT(found.sources, IsEmpty());
  EXPECT_THAT(found.missing, SizeIs(6));
  EXPECT_THAT(found.missing, missing_because("gpu_metrics': Operation not supported"));
  EXPECT_THAT(found.missing, missing_because("gpu_busy_percent': Operation not supported"));
  EXPECT_THAT(found.missing, missing_because("mem_busy_percent': Invalid argument"));
  EXPECT_THAT(found.missing, missing_because("pp_dpm_sclk': Input/output error"));
  EXPECT_THAT(found.missing, missing_because("pp_dpm_mclk' lists no clock"));
  EXPECT_THAT(found.missing, missing_because("pp_dpm_socclk' lists no clock"));
}

TEST(AmdGpu, ReadsTheLevelThatIsMarked) {
  struct Row {
    std::string text, value;
    std::optional<int64_t> limit;
  };
  const Tree tree;
  tree.write({{device + "uevent", "DRIVER=amdgpu\n"}, {device + "pp_dpm_sclk", "0: 1Mhz *\n"}});
  for (const Row& row :
       {Row{"0: 852Mhz *\n1: 991Mhz \n", "852 MHz", 991},
        Row{"0: 852Mhz \n1: 991Mhz *\n", "991 MHz", 991},
        Row{"0: 255Mhz\n1: 0Mhz *\n2: 1841Mhz\n", "0 MHz", 1841},               // stands still
        Row{"0: 687Mhz *\n1: 687Mhz *\n", "687 MHz", 687},                      // twice the same
        Row{"0: 200Mhz *\n1: 700Mhz *\n", "retry", 700},                        // which one?
        Row{"S: 19Mhz *\n0: 615Mhz \n1: 800Mhz\n2: 888Mhz \n", "19 MHz", 888},  // asleep
        Row{"0: 852Mhz\n1: 991Mhz\n", "retry", 991},                            // none
        Row{"0: 852Mhz *", "852 MHz", 852}, Row{"0: 2.5GT/s, x8 *\n1: 99Mhz *\n", "99 MHz", 99},
        Row{"junk\n: \n0: -5Mhz *\n1: 99999999999999999999Mhz *\n2: 7Mhz *\n", "7 MHz", 7}}) {
    tree.write({{device + "pp_dpm_sclk", row.text}});
    const Discovery found = discover_card(tree.root());
    expect_values(found, {{"gfx_freq", row.value}});
    EXPECT_EQ(channel_called(found, "amdgpu.gfx_freq").limit, row.limit) << row.text;
  }
}

TEST(AmdGpu, TellsSeveralCardsApart) {
  const Tree tree;
  for (const auto& [card, slot] : {std::pair{"card0", "0000:03:00.0"}, {"card1", "0000:c4:00.0"}})
    tree.write({{std::string("sys/class/drm/") + card + "/device/uevent",
                 std::string("DRIVER=amdgpu\nPCI_SLOT_NAME=") + slot + "\n"},
                {std::string("sys/class/drm/") + card + "/device/gpu_busy_percent", "5\n"},
                {std::string("sys/class/drm/") + card + "/device/power/control", "auto\n"}});
  tree.write({{"sys/class/drm/card2/device/uevent", "DRIVER=i915\n"},
              {"sys/class/drm/card2/device/gpu_busy_percent", "5\n"}});
  const Discovery found = discover_card(tree.root());
  EXPECT_THAT(names_of(found), ElementsAre("amdgpu@0000:03:00_0.busy", "amdgpu@0000:c4:00_0.busy"));
  for (const auto& source : found.sources) {
    EXPECT_TRUE(source->traits().slow);
    EXPECT_TRUE(source->traits().wakes_device);
  }
  EXPECT_EQ(found.sources[1]->traits().gpu, "0000:c4:00.0");
}

TEST(AmdGpu, IsMissingWithoutACardOfItsDriver) {
  const Tree tree{{"sys/class/drm/card0/device/uevent", "DRIVER=i915\n"}};
  EXPECT_THAT(discover_card(tree.root()).missing, missing_because("no GPU with the driver amdgpu"));
}

TEST(AmdGpu, IsPolledWithoutAnAllocation) {
  const Discovery found = discover_card(Root(Tree::machine_dir("amd-phoenix-apu").string()));
  ASSERT_FALSE(found.sources.empty());
  for (const auto& source : found.sources) {
    std::vector<Reading> out(source->channels().size());
    const int64_t before = allocation_count();
    source->poll(out);
    EXPECT_EQ(allocation_count(), before);
  }
}

}  // namespace
}  // namespace energyprof::probe
