// Which cards there are, whose they are, and how they are told apart.
#include "probe/drm_card.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tree.h"

namespace energyprof::probe {
namespace {

using testing::IsEmpty;
using testing::SizeIs;

TEST(DrmCard, IsFoundWithItsDriverAndAddress) {
  const Root root(Tree::machine_dir("intel-rplp-i915-laptop").string());
  const auto cards = drm_cards_of(root, "i915");
  ASSERT_THAT(cards, SizeIs(1));
  EXPECT_EQ(cards[0].card.path, "sys/class/drm/card1");
  EXPECT_EQ(cards[0].card.gpu, "0000:00:02.0");
  EXPECT_EQ(cards[0].prefix, "i915");
  EXPECT_THAT(drm_cards_of(root, "xe"), IsEmpty());
}

TEST(DrmCard, CarriesItsAddressWhereItsDriverHasSeveral) {
  const Tree tree;
  for (const std::string slot : {"0000:03:00.0", "0000:2d:00.0"}) {
    const std::string device = "sys/devices/pci/" + slot;
    tree.write({{device + "/uevent", "DRIVER=xe\nPCI_SLOT_NAME=" + slot + "\n"},
                {device + "/drm/card" + slot.substr(6, 1) + "/dev", "226:0\n"}});
  }
  tree.link("sys/class/drm/card0", "../../devices/pci/0000:03:00.0/drm/card3");
  tree.link("sys/devices/pci/0000:03:00.0/drm/card3/device", "../../../0000:03:00.0");
  tree.link("sys/class/drm/card1", "../../devices/pci/0000:2d:00.0/drm/cardd");
  tree.link("sys/devices/pci/0000:2d:00.0/drm/cardd/device", "../../../0000:2d:00.0");
  tree.write({{"sys/class/drm/card1-DP-1/status", "connected\n"}});
  tree.link("sys/dev/char/226:1", "../../devices/pci/0000:2d:00.0/drm/cardd");
  const auto cards = drm_cards_of(tree.root(), "xe");
  ASSERT_THAT(cards, SizeIs(2));
  EXPECT_EQ(cards[0].prefix, "xe@0000:03:00_0");
  EXPECT_EQ(cards[1].prefix, "xe@0000:2d:00_0");
  EXPECT_EQ(gpu_of_drm_node(tree.root(), 226, 1), "0000:2d:00.0");
  EXPECT_EQ(gpu_of_drm_node(tree.root(), 226, 7), std::nullopt);
}

TEST(DrmCard, TakesTheDriverFromItsLinkAndTheNameFromThePath) {
  const Tree tree{{"sys/devices/platform/fec00000.v3d/power/control", "auto\n"},
                  {"sys/bus/platform/drivers/v3d/module", "\n"}};
  tree.link("sys/class/drm/card0/device", "../../../devices/platform/fec00000.v3d");
  tree.link("sys/devices/platform/fec00000.v3d/driver", "../../../bus/platform/drivers/v3d");
  const auto cards = list_drm_cards(tree.root());
  ASSERT_THAT(cards, SizeIs(1));
  EXPECT_EQ(cards[0].driver, "v3d");
  EXPECT_EQ(cards[0].gpu, "fec00000.v3d");
}

TEST(DrmCard, HasADriverWhereACopyLacksTheDriversDirectory) {
  const Tree tree{{"sys/devices/pci/0000:00:02.0/vendor", "0x8086\n"},
                  {"sys/devices/pci/0000:00:02.0/gt0/freq0/act_freq", "0\n"}};
  tree.link("sys/class/drm/card0/device", "../../../devices/pci/0000:00:02.0");
  tree.link("sys/devices/pci/0000:00:02.0/driver", "../../../bus/pci/drivers/xe");
  const auto cards = list_drm_cards(tree.root());
  ASSERT_THAT(cards, SizeIs(1));
  EXPECT_EQ(cards[0].driver, "xe");
  EXPECT_EQ(cards[0].gpu, "0000:00:02.0");
}

TEST(DrmCard, IsKnownByItsFilesWhereACopyDoesNotNameTheDriver) {
  const Tree tree{{"sys/class/drm/card0/gt_cur_freq_mhz", "300\n"},
                  {"sys/class/drm/card1/device/tile0/gt0/freq0/act_freq", "0\n"},
                  {"sys/class/drm/card2/device/pp_dpm_sclk", "0: 300Mhz *\n"},
                  {"sys/class/drm/card3/device/vendor", "0x1af4\n"}};
  const auto cards = list_drm_cards(tree.root());
  ASSERT_THAT(cards, SizeIs(4));
  EXPECT_EQ(cards[0].driver, "i915");
  EXPECT_EQ(cards[0].gpu, "card0");
  EXPECT_EQ(cards[1].driver, "xe");
  EXPECT_EQ(cards[2].driver, "amdgpu");
  EXPECT_EQ(cards[3].driver, "");
}

TEST(DrmCard, WithoutAChipIsNotTakenForAnIntegratedGpuByItsPlace) {
  Discovery found;
  const Tree tree;
  report_absent_chip(tree.root(), {"sys/class/drm/card0", "i915", "0000:00:02.0"}, found);
  report_absent_chip(tree.root(), {"sys/class/drm/card1", "i915", "0000:03:00.0"}, found);
  ASSERT_THAT(found.missing, SizeIs(2));
  EXPECT_THAT(found.missing[0].reason, testing::HasSubstr("integrated"));
  EXPECT_THAT(found.missing[1].reason, testing::HasSubstr("Linux 6.2"));
}

TEST(DrmCard, IsCalledByItselfWhereItsDeviceIsNoLink) {
  const Tree tree{{"sys/class/drm/card0/device/uevent", "DRIVER=amdgpu\n"},
                  {"sys/class/drm/card1/device/uevent", "DRIVER=amdgpu\n"}};
  const auto cards = drm_cards_of(tree.root(), "amdgpu");
  ASSERT_THAT(cards, SizeIs(2));
  EXPECT_EQ(cards[0].prefix, "amdgpu@card0");
  EXPECT_EQ(cards[1].card.gpu, "card1");
}

}  // namespace
}  // namespace energyprof::probe
