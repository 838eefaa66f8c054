// The sensors of the GPU that traces stay, those of all others go, with the reason.
#include "probe/gpu_match.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "probe/file_source.h"
#include "tree.h"

namespace energyprof::probe {
namespace {

using testing::Contains;
using testing::Each;
using testing::Field;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

// A laptop with an integrated and a discrete GPU, and a temperature.
class TwoGpus : public testing::Test {
 protected:
  TwoGpus() {
    for (const auto& [card, slot, driver] :
         {std::tuple{"card0", "0000:00:02.0", "i915"}, std::tuple{"card1", "0000:03:00.0", "xe"}}) {
      const std::string device = "sys/devices/pci/" + std::string(slot);
      tree_.write(
          {{device + "/uevent", "DRIVER=" + std::string(driver) + "\nPCI_SLOT_NAME=" + slot + "\n"},
           {device + "/drm/" + card + "/gt/gt0/rps_act_freq_mhz", "300\n"},
           {device + "/tile0/gt0/freq0/act_freq", "600\n"}});
      tree_.link("sys/class/drm/" + std::string(card),
                 "../../devices/pci/" + std::string(slot) + "/drm/" + card);
      tree_.link(device + "/drm/" + card + "/device", "../../../" + std::string(slot));
    }
    tree_.link("sys/dev/char/226:129", "../../devices/pci/0000:03:00.0/drm/card1");
    tree_.write({{"sys/class/hwmon/hwmon0/name", "coretemp\n"},
                 {"sys/class/hwmon/hwmon0/temp1_input", "30000\n"}});
    found_ = discover(tree_.root(), Selection{.sources = {"i915", "xe", "hwmon"}});
    found_.missing.clear();
  }
  void keep(const TracingDevice& device) { keep_gpu(found_, tree_.root(), device); }

  Tree tree_;
  Discovery found_;
};

TEST_F(TwoGpus, AreToldApartByPciAddress) {
  keep({"Arc", false, "0000:03:00.0", {}});
  EXPECT_THAT(names_of(found_), Contains("xe.gt0.act_freq"));
  EXPECT_THAT(names_of(found_), Contains("hwmon.coretemp.temp1.temp"));
  EXPECT_THAT(names_of(found_), Not(Contains("i915.gt0.act_freq")));
  EXPECT_THAT(found_.missing,
              Contains(Field(&Missing::reason, HasSubstr("which is 0000:03:00.0"))));
}

TEST_F(TwoGpus, AreToldApartByDrmNode) {
  keep({"Arc", false, std::nullopt, {{226, 1}, {226, 129}}});
  EXPECT_THAT(names_of(found_), Contains("xe.gt0.act_freq"));
  EXPECT_THAT(names_of(found_), Not(Contains("i915.gt0.act_freq")));
}

TEST_F(TwoGpus, AreToldApartByUuid) {
  found_.sources.push_back(std::make_unique<FileSource>(
      "nvml", 1, std::vector<FileChannel>{},
      SourceTraits{.gpu = "0000:2d:00.0", .gpu_uuid = "8f1b0000-0000-0000-0000-000000000001"}));
  keep({"GeForce", false, std::nullopt, {}, "8f1b0000-0000-0000-0000-000000000001"});
  EXPECT_EQ(found_.sources.back()->name(), "nvml");
  EXPECT_THAT(names_of(found_), testing::ElementsAre("hwmon.coretemp.temp1.temp"));
  EXPECT_THAT(found_.missing,
              Contains(Field(&Missing::reason, HasSubstr("which is 0000:2d:00.0"))));
}

TEST_F(TwoGpus, ExplainNoFrameOfACpuDevice) {
  keep({"llvmpipe", true, std::nullopt, {}});
  EXPECT_THAT(names_of(found_), testing::ElementsAre("hwmon.coretemp.temp1.temp"));
  EXPECT_THAT(found_.missing, Each(Field(&Missing::reason, HasSubstr("on the CPU"))));
}

TEST_F(TwoGpus, AreBothLeftOutWhereTheDeviceDoesNotSay) {
  keep({"Mystery", false, std::nullopt, {}});
  EXPECT_THAT(names_of(found_), testing::ElementsAre("hwmon.coretemp.temp1.temp"));
  EXPECT_THAT(found_.missing,
              Contains(Field(&Missing::reason, HasSubstr("does not say which card"))));
}

TEST_F(TwoGpus, LackTheSensorsOfAThird) {
  keep({"Third", false, "0000:09:00.0", {}});
  EXPECT_THAT(found_.missing,
              Contains(Field(&Missing::reason, HasSubstr("no sensor of the GPU that traces"))));
}

TEST(KeepGpu, SaysThatACpuDeviceHasNoGpuSensorsWhereThereAreNone) {
  const Root root(Tree::machine_dir("vm-no-sensors").string());
  Discovery found;
  keep_gpu(found, root, {"llvmpipe", true, std::nullopt, {}});
  EXPECT_THAT(found.missing, Contains(Field(&Missing::reason, HasSubstr("on the CPU"))));
}

TEST(KeepGpu, TakesTheOnlyGpuForADeviceThatDoesNotSay) {
  const Root root(Tree::machine_dir("msm8916-adreno-board").string());
  Discovery found = discover(root, Selection{.sources = {"devfreq"}});
  found.missing.clear();
  keep_gpu(found, root, {"Turnip Adreno", false, std::nullopt, {}});
  EXPECT_THAT(names_of(found), Contains("devfreq.1c00000_gpu.freq"));
  EXPECT_THAT(found.missing, IsEmpty());
}

}  // namespace
}  // namespace energyprof::probe
