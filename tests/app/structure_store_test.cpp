// Structures: built once, kept on disk, never trusted from there.
#include "app/structure_store.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>

#include "accel/blob_cache.h"
#include "accel/gpu_triangles.h"

namespace energyprof::app {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;
using testing::IsEmpty;

class StructureStoreTest : public testing::Test {
 protected:
  StructureStoreTest() {
    std::string pattern = (fs::temp_directory_path() / "energyprof_store_XXXXXX").string();
    dir_ = mkdtemp(pattern.data());
    if (const char* before = std::getenv("XDG_CACHE_HOME")) before_ = before;
    setenv("XDG_CACHE_HOME", dir_.c_str(), 1);
    scene_.model = "teapot:2";
    scene_.mesh = accel::make_teapot(2);
  }
  ~StructureStoreTest() override {
    if (before_)
      setenv("XDG_CACHE_HOME", before_->c_str(), 1);
    else
      unsetenv("XDG_CACHE_HOME");
    fs::remove_all(dir_);
  }

  StructureStore store(bool use_disk = true, const accel::StructureConfig& parameters = {}) {
    return StructureStore(
        {parameters, use_disk, [this](const std::string& why) { warnings_.push_back(why); }});
  }
  [[nodiscard]] static std::vector<fs::path> files() {
    std::vector<fs::path> found;
    std::error_code none;
    for (fs::directory_iterator entry(accel::blob_cache_dir(), none), end; entry != end; ++entry)
      found.push_back(entry->path());
    return found;
  }

  fs::path dir_;
  std::optional<std::string> before_;
  Scene scene_;
  std::vector<std::string> warnings_;
};

TEST_F(StructureStoreTest, BuildsOnceAndTheDiskRemembers) {
  StructureStore first = store();
  const Structure& built = first.get(scene_, AccelKind::bvh_depth_first);
  EXPECT_FALSE(built.cached);
  EXPECT_EQ(&first.get(scene_, AccelKind::bvh_depth_first), &built);
  EXPECT_EQ(nlohmann::json::parse(built.parameters)["buckets"], 12);
  EXPECT_EQ(files().size(), 1u);

  StructureStore second = store();
  const Structure& loaded = second.get(scene_, AccelKind::bvh_depth_first);
  EXPECT_TRUE(loaded.cached);
  EXPECT_EQ(loaded.built.stats.build_ns, built.built.stats.build_ns);
  EXPECT_EQ(loaded.built.blob.nodes, built.built.blob.nodes);
  EXPECT_THAT(warnings_, IsEmpty());
}

TEST_F(StructureStoreTest, OtherParametersAreAnotherStructure) {
  store().get(scene_, AccelKind::bvh_depth_first);
  accel::StructureConfig parameters;
  parameters.bvh.bucket_count = 5;
  StructureStore other = store(true, parameters);
  EXPECT_FALSE(other.get(scene_, AccelKind::bvh_depth_first).cached);
  EXPECT_EQ(files().size(), 2u);
}

TEST_F(StructureStoreTest, WithoutTheDiskNothingIsWritten) {
  StructureStore memory_only = store(false);
  EXPECT_FALSE(memory_only.get(scene_, AccelKind::bvh_depth_first).cached);
  EXPECT_THAT(files(), IsEmpty());
}

TEST_F(StructureStoreTest, ADamagedEntryIsReportedAndReplaced) {
  store().get(scene_, AccelKind::bvh_depth_first);
  ASSERT_EQ(files().size(), 1u);
  fs::resize_file(files().front(), fs::file_size(files().front()) - 1);
  StructureStore after = store();
  EXPECT_FALSE(after.get(scene_, AccelKind::bvh_depth_first).cached);
  ASSERT_EQ(warnings_.size(), 1u);
  EXPECT_THAT(warnings_.front(), HasSubstr(files().front().string()));
  StructureStore later = store();
  EXPECT_TRUE(later.get(scene_, AccelKind::bvh_depth_first).cached);
  EXPECT_EQ(warnings_.size(), 1u);
}

TEST_F(StructureStoreTest, AWellFormedEntryOfAnotherMeshIsNotUsed) {
  // Somebody stores a structure under a key that is not its own: the checksum is right, the
  // structure would read outside the mesh.
  const std::string parameters = describe_parameters({}, AccelKind::bvh_depth_first).dump();
  const std::string key =
      accel::blob_key(accel::mesh_digest(scene_.mesh), parameters, AccelKind::bvh_depth_first);
  accel::store_blob(accel::blob_cache_dir(), key, accel::build_bvh(accel::make_teapot(3)));
  StructureStore careful = store();
  const Structure& structure = careful.get(scene_, AccelKind::bvh_depth_first);
  EXPECT_FALSE(structure.cached);
  EXPECT_EQ(structure.built.blob.nodes, accel::build_bvh(scene_.mesh).blob.nodes);
  ASSERT_EQ(warnings_.size(), 1u);
  EXPECT_THAT(warnings_.front(), HasSubstr("It is built again."));
}

TEST_F(StructureStoreTest, ACacheThatCannotBeWrittenIsOneWarning) {
  fs::create_symlink("/nowhere/at/all", dir_ / "energyprof");
  StructureStore blocked = store();
  EXPECT_FALSE(blocked.get(scene_, AccelKind::bvh_depth_first).cached);
  Scene other;
  other.model = "teapot:3";
  other.mesh = accel::make_teapot(3);
  EXPECT_FALSE(blocked.get(other, AccelKind::bvh_depth_first).cached);
  ASSERT_EQ(warnings_.size(), 1u);
  EXPECT_THAT(warnings_.front(), HasSubstr("Structures are not kept."));
}

TEST_F(StructureStoreTest, WhatCannotBeBuiltSaysWhyEachTime) {
  accel::StructureConfig parameters;
  parameters.bvh.bucket_count = -1;  // no config can say so
  StructureStore failing = store(false, parameters);
  EXPECT_THROW(failing.get(scene_, AccelKind::bvh_depth_first), std::runtime_error);
  EXPECT_THROW(failing.get(scene_, AccelKind::bvh_depth_first), std::runtime_error);
}

}  // namespace
}  // namespace energyprof::app
