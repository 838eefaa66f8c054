// Which device is taken on invented machines.
#include "kernels/device_choice.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace energyprof::kernels {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

Candidate device(std::string name, std::string type, std::string unusable = "") {
  Candidate candidate;
  candidate.info.name = std::move(name);
  candidate.info.type = std::move(type);
  candidate.unusable = std::move(unusable);
  return candidate;
}

const std::vector<Candidate> laptop{
    device("llvmpipe (LLVM 15)", "cpu"),
    device("NVIDIA GeForce RTX 4060", "discrete"),
    device("Intel(R) Iris(R) Xe Graphics", "integrated"),
    device("Intel(R) Arc A370M", "discrete"),
};

std::string error_of(std::span<const Candidate> candidates, std::string_view name) {
  try {
    choose_device(candidates, name);
  } catch (const std::runtime_error& error) {
    return error.what();
  }
  return "no error";
}

TEST(DeviceChoice, AutoPrefersIntegratedThenDiscreteThenCpu) {
  EXPECT_EQ(choose_device(laptop, "auto").index, 2u);
  EXPECT_THAT(rank_devices(laptop), ElementsAre(2, 1, 3, 0));
}

TEST(DeviceChoice, EveryOtherDeviceGetsAReason) {
  const Choice choice = choose_device(laptop, "auto");
  ASSERT_EQ(choice.refusals.size(), 3u);
  EXPECT_EQ(choice.refusals[0].name, "llvmpipe (LLVM 15)");
  EXPECT_EQ(choice.refusals[0].reason, "ranked below 'Intel(R) Iris(R) Xe Graphics'");
}

TEST(DeviceChoice, NameMatchesAPartWhateverTheCase) {
  const Choice choice = choose_device(laptop, "geforce");
  EXPECT_EQ(choice.index, 1u);
  EXPECT_EQ(choice.refusals[1].reason, "name does not contain 'geforce'");
}

TEST(DeviceChoice, NameOfSeveralTakesThePreferredOne) {
  const Choice choice = choose_device(laptop, "INTEL");
  EXPECT_EQ(choice.index, 2u);
  EXPECT_EQ(choice.refusals[2].reason, "ranked below 'Intel(R) Iris(R) Xe Graphics'");
}

TEST(DeviceChoice, NameOfNoneListsWhatThereIs) {
  const std::string error = error_of(laptop, "Radeon");
  EXPECT_THAT(error, HasSubstr("no Vulkan device fits: 'llvmpipe (LLVM 15)': name does not contain "
                               "'Radeon'; 'NVIDIA GeForce RTX 4060': name"));
}

TEST(DeviceChoice, UnusableDevicesAreNeverTaken) {
  const std::vector<Candidate> machine{
      device("Foo iGPU", "integrated", "timestampValidBits is 0 on its compute queue"),
      device("llvmpipe", "cpu"),
  };
  EXPECT_EQ(choose_device(machine, "auto").index, 1u);
  EXPECT_EQ(choose_device(machine, "auto").refusals[0].reason,
            "timestampValidBits is 0 on its compute queue");
  EXPECT_EQ(error_of(machine, "foo"),
            "no Vulkan device fits: 'Foo iGPU': timestampValidBits is 0 on its compute queue; "
            "'llvmpipe': name does not contain 'foo'.");
}

}  // namespace
}  // namespace energyprof::kernels
