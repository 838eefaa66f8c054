// Configs: the shipped ones, defaults, settings. Wrong ones are tested through the program.
#include "app/config.h"

#include <gtest/gtest.h>

#include <fstream>

#include "app/usage_error.h"
#include "core/algorithms.h"

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
  const Config config =
      load_config(shipped("teapot.json"),
                  {"image.width=640", "models.0=teapot:3", "frames.pace=fps:59.94",
                   "views=[2,{\"phi\":1,\"theta\":2,\"distance\":3}]", "sampler.sources=[\"psi\"]",
                   "order.design=sequential", "sampler.periods_ms={\"psi\":2.5,\"hwmon\":100}"});
  EXPECT_EQ(config.width, 640u);
  EXPECT_EQ(config.models, std::vector<std::string>{"teapot:3"});
  EXPECT_DOUBLE_EQ(config.frames_per_second.value(), 59.94);
  ASSERT_EQ(config.views.size(), 2u);
  EXPECT_EQ(std::get<int>(config.views[0]), 2);
  EXPECT_EQ(std::get<ViewConfig>(config.views[1]).distance, 3.0);
  EXPECT_EQ(config.sources, std::vector<std::string>{"psi"});
  EXPECT_EQ(config.sampler_periods_ns,
            (std::map<std::string, int64_t>{{"psi", 2'500'000}, {"hwmon", 100'000'000}}));
  EXPECT_TRUE(config.self_check);
  EXPECT_FALSE(config.latin_square);
  EXPECT_EQ(config.json["image"]["width"], 640);
}

TEST(Config, AlgorithmsAreThoseOfTheTable) {
  std::vector<std::string> names;
  for (const AlgorithmInfo& algorithm : algorithm_list) names.emplace_back(algorithm.name);
  std::ifstream in(shipped("schema.json"));
  const auto schema = nlohmann::json::parse(in);
  EXPECT_EQ(schema["properties"]["algorithms"]["items"]["enum"], nlohmann::json(names));
  for (const std::string name : {"teapot", "bunny", "dragon", "paper"})
    EXPECT_EQ(load_config(shipped(name + ".json"), {}).algorithms, names) << name;
}

TEST(Config, BuildsThePapersStructuresUnlessTold) {
  const Config config = load_config(shipped("teapot.json"), {});
  EXPECT_EQ(config.structures, accel::StructureConfig{});
  const Config tuned =
      load_config(shipped("teapot.json"),
                  {"structures.bvh.preset=tuned", "structures.bvh.buckets=7",
                   "structures.kdtree.preset=tuned", "structures.grid={\"lambda\":4.5}"});
  accel::BvhConfig bvh = accel::tuned_bvh();
  bvh.bucket_count = 7;
  EXPECT_EQ(tuned.structures.bvh, bvh);
  EXPECT_EQ(tuned.structures.kdtree, accel::tuned_kdtree());
  EXPECT_EQ(tuned.structures.grid.lambda, 4.5f);
  EXPECT_FALSE(tuned.structures.grid.exact_overlap);
}

TEST(Config, EveryParameterOfABuilderCanBeSet) {
  const Config config = load_config(
      shipped("teapot.json"),
      {R"(structures={"bvh":{"method":"sweep","buckets":2,"axes":"all","max_leaf_size":3,
            "traverse_cost":4.5,"intersect_cost":5.5,"middle_split_count":6},
          "kdtree":{"max_leaf_size":7,"traverse_cost":8.5,"intersect_cost":9.5,"empty_bonus":0.25,
            "bad_refinements":10,"max_depth":11,"clip":true,"keep_touching":false},
          "grid":{"lambda":12.5,"exact_overlap":true}})"});
  const accel::BvhConfig bvh{accel::BvhConfig::Method::sweep, 2, true, 3, 4.5f, 5.5f, 6};
  const accel::KdTreeConfig kdtree{8.5f, 9.5f, 0.25f, 7, 10, 11, true, false};
  EXPECT_EQ(config.structures, (accel::StructureConfig{bvh, kdtree, {12.5f, true}}));
}

TEST(Config, DescribedParametersReadBackAsTheSame) {
  accel::StructureConfig parameters;
  parameters.bvh = accel::tuned_bvh();
  parameters.kdtree.empty_bonus = 0.1f;
  parameters.grid.lambda = 1.0f / 3.0f;
  nlohmann::json document;
  for (const AccelKind kind : {AccelKind::bvh_miss_links, AccelKind::kd_tree, AccelKind::grid})
    document[builder_name(kind)] = describe_parameters(parameters, kind);
  EXPECT_EQ(read_structure_parameters(document), parameters);
  EXPECT_EQ(describe_parameters(parameters, AccelKind::kd_tree)["empty_bonus"].dump(), "0.1");
}

TEST(Config, RecordsThePresetsValues) {
  const Config config = load_config(shipped("teapot.json"), {"structures.kdtree.preset=tuned"});
  EXPECT_EQ(config.json["structures"]["bvh"]["buckets"], 12);
  EXPECT_EQ(config.json["structures"]["bvh"]["preset"], "paper");
  EXPECT_EQ(config.json["structures"]["kdtree"]["preset"], "tuned");
  EXPECT_EQ(config.json["structures"]["kdtree"]["clip"], true);
  EXPECT_EQ(config.json["structures"]["grid"]["lambda"], 3);
  EXPECT_EQ(config.json["structure_cache"], true);
  EXPECT_EQ(config.json["idle"],
            (nlohmann::json{{"before_s", 5}, {"between_s", 1}, {"after_s", 5}}));
}

TEST(Config, CachesAreUnknownUnlessTold) {
  const CacheSettings none = load_config(shipped("teapot.json"), {}).cache_model;
  EXPECT_FALSE(none.l1_kib || none.l1_ways || none.llc_kib || none.llc_ways || none.line_bytes);
  const CacheSettings some =
      load_config(shipped("teapot.json"), {"cache_model={\"l1_kib\":16,\"line_bytes\":128}"})
          .cache_model;
  EXPECT_EQ(some.l1_kib, 16);
  EXPECT_EQ(some.line_bytes, 128);
  EXPECT_FALSE(some.l1_ways);
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
  EXPECT_EQ(config.idle.before_s, 1.0);
  EXPECT_EQ(config.idle.between_s, 0.0);
  EXPECT_EQ(config.idle.after_s, 1.0);
  EXPECT_EQ(config.json["idle"]["between_s"], 0.0);
  EXPECT_NE(note.find("idle before (s) 1 instead of 5"), std::string::npos) << note;
  Config small =
      load_config(shipped("teapot.json"),
                  {"image={\"width\":10,\"height\":10}", "frames.timed=3", "frames.warmup=0",
                   "cooldown.max_s=0", "idle={\"before_s\":0,\"between_s\":0,\"after_s\":1}"});
  EXPECT_EQ(apply_quick(small), "");
}

TEST(Config, MistakesAreUsageErrors) {
  EXPECT_THROW(load_config(shipped("teapot.json"), {"bounces=2"}), UsageError);
  EXPECT_THROW(load_config(shipped("teapot.json"), {"algorithms=[\"BVH_FTB_DF\",\"BVH_FTB_DF\"]"}),
               UsageError);
  EXPECT_THROW(load_config(shipped("teapot.json"), {"name=a/b"}), UsageError);
  for (const char* setting :
       {"structures.bvh.buckets=1", "structures.bvh.max_leaf_size=17", "structures.bvh.axes=x",
        "structures.kdtree.empty_bonus=1.5", "structures.kdtree.max_depth=121",
        "structures.kdtree.clip=1", "structures.grid.lambda=0", "structures.octree={}",
        "cache_model.line_bytes=48", "cache_model.l1_kib=0", "structure_cache=1",
        "idle.before_s=-1", "sampler.sources=[]", "sampler.periods_ms.psi=0"})
    EXPECT_THROW(load_config(shipped("teapot.json"), {setting}), UsageError) << setting;
  EXPECT_THROW(load_config("/no/such/file.json", {}), std::runtime_error);
}

}  // namespace
}  // namespace energyprof::app
