// Configs: the shipped ones, defaults, settings. Wrong ones are tested through the program.
#include "app/config.h"

#include <gtest/gtest.h>

#include "app/usage_error.h"

namespace energyprof::app {
namespace {

std::string shipped(const std::string& name) {
  return std::string(ENERGYPROF_CONFIGS) + "/" + name;
}

TEST(Config, ShippedOnesAreThePapersStudy) {
  for (const std::string name : {"teapot", "bunny", "dragon", "paper"}) {
    SCOPED_TRACE(name);
    const Config config = load_config(shipped(name + ".json"), {});
    EXPECT_EQ(config.name, name);
    EXPECT_FALSE(config.question.empty());
    EXPECT_EQ(config.models.size(), name == "paper" ? 3u : 1u);
    EXPECT_EQ(config.views.size(), 3u);
    EXPECT_EQ(config.width, 1280u);
    EXPECT_EQ(config.height, 720u);
    EXPECT_EQ(config.timed_frames, 64);
    EXPECT_EQ(config.bounces, 1u);
    EXPECT_FALSE(config.frames_per_second);
  }
}

TEST(Config, SettingsChangeOneKeyEach) {
  const Config config = load_config(
      shipped("teapot.json"), {"image.width=640", "models.0=teapot:3", "frames.pace=fps:59.94",
                               "views=[2,{\"phi\":1,\"theta\":2,\"distance\":3}]",
                               "sampler.sources=[\"psi\"]", "order.design=sequential"});
  EXPECT_EQ(config.width, 640u);
  EXPECT_EQ(config.models, std::vector<std::string>{"teapot:3"});
  EXPECT_DOUBLE_EQ(config.frames_per_second.value(), 59.94);
  ASSERT_EQ(config.views.size(), 2u);
  EXPECT_EQ(std::get<int>(config.views[0]), 2);
  EXPECT_EQ(std::get<ViewConfig>(config.views[1]).distance, 3.0);
  EXPECT_EQ(config.sources, std::vector<std::string>{"psi"});
  EXPECT_FALSE(config.latin_square);
  EXPECT_EQ(config.json["image"]["width"], 640);
}

TEST(Config, RecordsItsDefaults) {
  const Config config = load_config(shipped("teapot.json"), {"order={}"});
  EXPECT_EQ(config.json["order"]["seed"], 1);
  EXPECT_EQ(config.json["order"]["design"], "latin-square");
  EXPECT_EQ(config.seed, 1u);
}

TEST(Config, QuickCapsAndSaysWhat) {
  Config config = load_config(shipped("dragon.json"), {"image={\"width\":1000,\"height\":2000}"});
  const std::string note = apply_quick(config);
  EXPECT_EQ(config.height, 180u);
  EXPECT_EQ(config.width, 90u);
  EXPECT_EQ(config.timed_frames, 16);
  EXPECT_NE(note.find("image 90x180 instead of 1000x2000"), std::string::npos) << note;
  EXPECT_EQ(config.json["frames"]["timed"], 16);
  Config small =
      load_config(shipped("teapot.json"), {"image={\"width\":10,\"height\":10}", "frames.timed=3",
                                           "frames.warmup=0", "cooldown.max_s=0"});
  EXPECT_EQ(apply_quick(small), "");
}

TEST(Config, MistakesAreUsageErrors) {
  EXPECT_THROW(load_config(shipped("teapot.json"), {"bounces=2"}), UsageError);
  EXPECT_THROW(load_config(shipped("teapot.json"), {"algorithms=[\"BVH_FTB_DF\",\"BVH_FTB_DF\"]"}),
               UsageError);
  EXPECT_THROW(load_config(shipped("teapot.json"), {"name=a/b"}), UsageError);
  EXPECT_THROW(load_config("/no/such/file.json", {}), std::runtime_error);
}

}  // namespace
}  // namespace energyprof::app
