// Structures on disk: what was stored comes back, and nothing else.
#include "accel/blob_cache.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cmath>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <set>
#include <thread>

#include "accel/grid.h"
#include "tests/accel/scenes.h"

namespace energyprof::accel {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

void expect_equal(const Built& a, const Built& b) {
  EXPECT_EQ(a.blob.kind, b.blob.kind);
  EXPECT_EQ(a.blob.nodes, b.blob.nodes);
  EXPECT_EQ(a.blob.refs, b.blob.refs);
  EXPECT_EQ(a.blob.bounds_min, b.blob.bounds_min);
  EXPECT_EQ(a.blob.bounds_max, b.blob.bounds_max);
  EXPECT_EQ(a.blob.max_depth, b.blob.max_depth);
  EXPECT_EQ(a.blob.grid_size, b.blob.grid_size);
  EXPECT_EQ(a.stats.build_ns, b.stats.build_ns);
  EXPECT_EQ(a.stats.blob_bytes, b.stats.blob_bytes);
  EXPECT_EQ(a.stats.node_count, b.stats.node_count);
  EXPECT_EQ(a.stats.leaf_count, b.stats.leaf_count);
  EXPECT_EQ(a.stats.ref_count, b.stats.ref_count);
  EXPECT_EQ(a.stats.max_depth, b.stats.max_depth);
  EXPECT_EQ(a.stats.sah_cost, b.stats.sah_cost);
}

/// A structure with a value of its own in every field.
Built sample() {
  Built built = build_grid(test::triangle_soup(3, 0.5f, 7));
  built.blob.max_depth = 17;
  built.stats.max_depth = 18;
  built.stats.build_ns = 123'456'789'012;
  built.stats.sah_cost = 12.5;
  return built;
}

class BlobCache : public testing::Test {
 protected:
  void SetUp() override {
    std::string name = (std::filesystem::temp_directory_path() / "blob-cache-XXXXXX").string();
    ASSERT_NE(::mkdtemp(name.data()), nullptr);
    root_ = name;
    dir_ = root_ / "energyprof" / "structures";
  }
  void TearDown() override {
    std::filesystem::permissions(root_, std::filesystem::perms::owner_all);
    std::filesystem::remove_all(root_);
  }

  [[nodiscard]] std::filesystem::path file() const { return dir_ / (key_ + ".blob"); }
  [[nodiscard]] std::string contents() const {
    std::ifstream in(file(), std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }
  void overwrite(std::string_view bytes) const {
    std::filesystem::remove(file());  // some file systems sync a file that is written over
    std::ofstream(file(), std::ios::binary) << bytes;
  }
  std::optional<Built> load() { return load_blob(dir_, key_, warning_); }

  std::filesystem::path root_;
  std::filesystem::path dir_;
  std::string key_ = blob_key("some mesh", "{}", AccelKind::grid);
  std::string warning_ = "of the call before";
};

TEST_F(BlobCache, GivesBackWhatWasStored) {
  const Built built = sample();
  store_blob(dir_, key_, built);
  const std::optional<Built> loaded = load();
  ASSERT_TRUE(loaded) << warning_;
  EXPECT_THAT(warning_, IsEmpty());
  expect_equal(*loaded, built);
}

TEST_F(BlobCache, GivesBackAStructureOverNothingAndOneWithoutReferences) {
  Built built = build_grid({});
  store_blob(dir_, key_, built);
  std::optional<Built> loaded = load();
  ASSERT_TRUE(loaded) << warning_;
  expect_equal(*loaded, built);

  built = sample();
  built.blob.refs.clear();
  built.blob.kind = AccelKind::bvh_miss_links;
  built.stats.blob_bytes = static_cast<int64_t>(built.blob.byte_count());
  built.stats.sah_cost.reset();
  store_blob(dir_, key_, built);
  loaded = load();
  ASSERT_TRUE(loaded) << warning_;
  expect_equal(*loaded, built);
}

TEST_F(BlobCache, HasNothingToSayWhereThereIsNothing) {
  EXPECT_FALSE(load());
  EXPECT_THAT(warning_, IsEmpty());
  std::filesystem::create_directories(dir_);
  EXPECT_FALSE(load());
  EXPECT_THAT(warning_, IsEmpty());
}

TEST_F(BlobCache, RefusesAFileThatIsCutOff) {
  store_blob(dir_, key_, sample());
  const std::string whole = contents();
  for (size_t length = 0; length < whole.size(); ++length) {
    SCOPED_TRACE(length);
    overwrite(std::string_view(whole).substr(0, length));
    EXPECT_FALSE(load());
    EXPECT_THAT(warning_, AllOf(HasSubstr(file().string()), Not(HasSubstr("\n"))));
  }
  overwrite(whole + "x");
  EXPECT_FALSE(load());
  EXPECT_THAT(warning_, HasSubstr("expected a header of 192"));
}

TEST_F(BlobCache, RefusesAFileWithAnyByteChanged) {
  store_blob(dir_, key_, sample());
  const std::string whole = contents();
  for (size_t i = 0; i < whole.size(); ++i)
    for (const char change : {'\x01', '\x80', '\xff'}) {
      SCOPED_TRACE(i);
      std::string damaged = whole;
      damaged[i] = static_cast<char>(damaged[i] ^ change);
      overwrite(damaged);
      EXPECT_FALSE(load());
      EXPECT_THAT(warning_, HasSubstr(file().string()));
    }
}

TEST_F(BlobCache, SaysWhyAFileIsOfNoUse) {
  store_blob(dir_, key_, sample());
  const std::string whole = contents();
  overwrite(std::string(1000, 'x'));
  EXPECT_FALSE(load());
  EXPECT_THAT(warning_, HasSubstr("it is not a structure of energyprof"));

  std::string other = whole;
  other[8] = 77;
  overwrite(other);
  EXPECT_FALSE(load());
  EXPECT_THAT(warning_, HasSubstr("it has format version 77, expected 1"));

  overwrite(whole);
  const std::string other_key = blob_key("some mesh", "{}", AccelKind::kd_tree);
  std::filesystem::rename(file(), dir_ / (other_key + ".blob"));
  EXPECT_FALSE(load_blob(dir_, other_key, warning_));
  EXPECT_THAT(warning_, HasSubstr("it is the structure of another mesh or other parameters"));

  std::filesystem::create_directory(file());
  EXPECT_FALSE(load());
  EXPECT_THAT(warning_, HasSubstr("it is not a regular file"));
}

TEST_F(BlobCache, HugeSizesInAHeaderAllocateNothing) {
  store_blob(dir_, key_, sample());
  const std::string whole = contents();
  for (const size_t field : {80u, 88u}) {  // node_bytes, ref_count
    std::string damaged = whole;
    for (size_t i = 0; i < 8; ++i) damaged[field + i] = '\xff';
    overwrite(damaged);
    EXPECT_FALSE(load());
    EXPECT_THAT(warning_, HasSubstr("18446744073709551615"));
  }
}

TEST_F(BlobCache, ReplacesADamagedFile) {
  store_blob(dir_, key_, sample());
  overwrite("damaged");
  EXPECT_FALSE(load());
  store_blob(dir_, key_, sample());
  EXPECT_TRUE(load());
}

TEST_F(BlobCache, RefusesAFolderThatCannotBeWrittenTo) {
  std::ofstream(root_ / "energyprof") << "a file where a folder should be";
  try {
    store_blob(dir_, key_, sample());
    FAIL() << "stored";
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), AllOf(HasSubstr(file().string()), HasSubstr("Not a directory")));
  }
  EXPECT_FALSE(load());
  EXPECT_THAT(warning_, HasSubstr("Not a directory"));
}

TEST_F(BlobCache, RefusesWhatPermissionsForbid) {
  if (::geteuid() == 0) GTEST_SKIP() << "root may read and write everything";
  store_blob(dir_, key_, sample());
  std::filesystem::permissions(file(), std::filesystem::perms::none);
  EXPECT_FALSE(load());
  EXPECT_THAT(warning_, HasSubstr("Permission denied"));
  std::filesystem::permissions(dir_, std::filesystem::perms::none);
  EXPECT_THROW(store_blob(dir_, key_, sample()), std::runtime_error);
  std::filesystem::permissions(dir_, std::filesystem::perms::owner_all);
}

TEST_F(BlobCache, SaysThatTheDiskIsFull) {
  // A file that cannot be finished is not left behind.
  Built large = sample();
  large.blob.nodes.resize(size_t{1} << 20);
  const auto run_limited = [&] {
    std::signal(SIGXFSZ, SIG_IGN);
    const rlimit limit{1 << 16, 1 << 16};
    ::setrlimit(RLIMIT_FSIZE, &limit);
    try {
      store_blob(dir_, key_, large);
      std::_Exit(1);
    } catch (const std::runtime_error& error) {
      const bool is_clean = std::filesystem::is_empty(dir_);
      std::_Exit(is_clean && std::string(error.what()).ends_with("File too large.") ? 0 : 2);
    }
  };
  EXPECT_EXIT(run_limited(), testing::ExitedWithCode(0), "");
}

TEST_F(BlobCache, TwoWritersLeaveOneWholeFile) {
  Built one = sample();
  Built two = sample();
  one.blob.nodes.assign(size_t{1} << 18, std::byte{1});
  two.blob.nodes.assign(size_t{1} << 19, std::byte{2});
  store_blob(dir_, key_, one);
  const auto write_often = [&](const Built& built) {
    for (int i = 0; i < 30; ++i) store_blob(dir_, key_, built);
  };
  std::jthread first([&] { write_often(one); });
  std::jthread second([&] { write_often(two); });
  for (int i = 0; i < 30; ++i) {
    const std::optional<Built> loaded = load();
    ASSERT_TRUE(loaded) << warning_;
    EXPECT_TRUE(loaded->blob.nodes == one.blob.nodes || loaded->blob.nodes == two.blob.nodes);
  }
  first.join();
  second.join();
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(dir_), {}), 1);
}

TEST_F(BlobCache, TheDefaultFolderFollowsTheEnvironment) {
  const auto with_environment = [](const char* cache_home, const char* home) {
    cache_home != nullptr ? ::setenv("XDG_CACHE_HOME", cache_home, 1)
                          : ::unsetenv("XDG_CACHE_HOME");
    home != nullptr ? ::setenv("HOME", home, 1) : ::unsetenv("HOME");
    return blob_cache_dir();
  };
  const char* const old_cache_home = std::getenv("XDG_CACHE_HOME");
  const char* const old_home = std::getenv("HOME");
  const std::optional<std::string> cache_home =
      old_cache_home != nullptr ? std::optional<std::string>(old_cache_home) : std::nullopt;
  const std::optional<std::string> home =
      old_home != nullptr ? std::optional<std::string>(old_home) : std::nullopt;

  EXPECT_EQ(with_environment("/a/cache", "/b"), "/a/cache/energyprof/structures");
  EXPECT_EQ(with_environment("relative", "/b"), "/b/.cache/energyprof/structures");
  EXPECT_EQ(with_environment(nullptr, "/b"), "/b/.cache/energyprof/structures");
  EXPECT_THROW(with_environment(nullptr, ""), std::runtime_error);
  EXPECT_THROW(with_environment(nullptr, nullptr), std::runtime_error);

  if (cache_home) ::setenv("XDG_CACHE_HOME", cache_home->c_str(), 1);
  if (home) ::setenv("HOME", home->c_str(), 1);
}

TEST(BlobKey, DiffersWhereAnythingDiffers) {
  const Mesh mesh = make_teapot();
  Mesh moved = mesh;
  moved.positions[100].y = std::nextafter(moved.positions[100].y, 10.0f);
  Mesh turned = mesh;
  std::swap(turned.triangles[5].x, turned.triangles[5].y);
  Mesh longer = mesh;
  longer.positions.emplace_back(0.0f);
  std::set<std::string> keys;
  for (const Mesh& m : {mesh, moved, turned, longer}) {
    const std::string digest = mesh_digest(m);
    EXPECT_EQ(digest.size(), 64u);
    for (const std::string_view parameters : {"", "{}", "{\"lambda\":3}"})
      for (const AccelKind kind : {AccelKind::bvh_depth_first, AccelKind::grid})
        keys.insert(blob_key(digest, parameters, kind));
  }
  EXPECT_EQ(keys.size(), 4u * 3u * 2u);
  EXPECT_EQ(mesh_digest(mesh), mesh_digest(make_teapot()));
  EXPECT_EQ(keys.begin()->size(), 64u);
  EXPECT_EQ(keys.begin()->find_first_not_of("0123456789abcdef"), std::string::npos);
}

}  // namespace
}  // namespace energyprof::accel
