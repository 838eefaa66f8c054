#include "analysis/write_reports.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <stdlib.h>
#include <sys/resource.h>

#include <csignal>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>

#include "analysis/analyze.h"
#include "analysis/report_json.h"
#include "planted_run.h"

namespace energyprof::analysis {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using testing::AllOf;
using testing::HasSubstr;

/// An empty directory for one test.
class WriteReports : public testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "energyprof-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    directory_ = name;
  }
  void TearDown() override { fs::remove_all(directory_); }

  [[nodiscard]] std::set<std::string> names() const {
    std::set<std::string> result;
    for (const auto& entry : fs::directory_iterator(directory_))
      result.insert(entry.path().filename());
    return result;
  }
  [[nodiscard]] json parse(const char* name) const {
    return json::parse(std::ifstream(directory_ / name));
  }

  fs::path directory_;
};

TEST_F(WriteReports, WritesFourFilesAndNothingElse) {
  const RunRecord run = planted::laptop_run();
  const auto files = write_reports(run, analyze(run), directory_);
  EXPECT_EQ(files.size(), 4u);
  EXPECT_EQ(names(),
            (std::set<std::string>{"report.html", "report.json", "report.md", "timeline.json"}));
  EXPECT_EQ(parse("report.json"), report_json(run, analyze(run), {}));
  EXPECT_FALSE(parse("timeline.json").at("traceEvents").empty());
}

TEST_F(WriteReports, TakesThePicturesOfTheRun) {
  fs::create_directory(directory_ / "images");
  std::ofstream(directory_ / "images" / "dragon_view0_reference.png") << "foobar";
  std::ofstream(directory_ / "images" / "dragon_view0_GRID_heat.png") << "fooba";
  std::ofstream(directory_ / "images" / "dragon_view0_montage.png") << "barfoo";
  std::ofstream(directory_ / "images" / "notes.txt") << "no picture";
  write_reports({}, analyze({}), directory_);
  std::ifstream in(directory_ / "report.html");
  const std::string page{std::istreambuf_iterator<char>(in), {}};
  // Reference images and heat maps are shown, the others are named.
  EXPECT_THAT(page, AllOf(HasSubstr("Zm9vYmFy"), HasSubstr("dragon_view0_reference")));
  EXPECT_THAT(page, HasSubstr("base64,Zm9vYmE="));
  EXPECT_THAT(page, AllOf(Not(HasSubstr("YmFyZm9v")), HasSubstr("dragon_view0_montage.png")));
  const json images = parse("report.json").at("images");
  ASSERT_EQ(images.size(), 3u);
  EXPECT_EQ(images[0], (json{{"file", "images/dragon_view0_GRID_heat.png"}, {"kind", "heat"}}));
  EXPECT_EQ(images[2].at("kind"), "reference");
  std::ifstream md(directory_ / "report.md");
  EXPECT_THAT((std::string{std::istreambuf_iterator<char>(md), {}}),
              HasSubstr("](images/dragon_view0_montage.png)"));
}

TEST_F(WriteReports, SaysWhereItCouldNotWrite) {
  try {
    write_reports({}, analyze({}), directory_ / "absent");
    FAIL() << "wrote into a directory that does not exist";
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), AllOf(HasSubstr("absent/timeline.json"), HasSubstr("No such file")));
  }
}

/// Files of this process end at `bytes`, like on a full disk, until this goes out of scope.
class FileSizeLimit {
 public:
  explicit FileSizeLimit(rlim_t bytes) {
    std::signal(SIGXFSZ, SIG_IGN);
    getrlimit(RLIMIT_FSIZE, &before_);
    rlimit limit = before_;
    limit.rlim_cur = bytes;
    setrlimit(RLIMIT_FSIZE, &limit);
  }
  ~FileSizeLimit() {
    setrlimit(RLIMIT_FSIZE, &before_);
    std::signal(SIGXFSZ, SIG_DFL);
  }
  FileSizeLimit(const FileSizeLimit&) = delete;
  FileSizeLimit& operator=(const FileSizeLimit&) = delete;

 private:
  rlimit before_{};
};

TEST_F(WriteReports, LeavesTheOldFileWhenTheDiskIsFull) {
  const RunRecord run = planted::laptop_run();
  std::ofstream(directory_ / "timeline.json") << "old";
  std::string message;
  {
    const FileSizeLimit limit(100'000);
    try {
      write_reports(run, analyze(run), directory_);
    } catch (const std::runtime_error& error) {
      message = error.what();
    }
  }
  EXPECT_THAT(message, AllOf(HasSubstr("timeline.json"), HasSubstr("File too large"),
                             HasSubstr("Free some space")));
  EXPECT_EQ(names(), std::set<std::string>{"timeline.json"});
  EXPECT_EQ(fs::file_size(directory_ / "timeline.json"), 3u);
}

TEST_F(WriteReports, ExportsCsvIntoANewDirectory) {
  const auto files = export_csv(planted::laptop_run(), directory_ / "a" / "b");
  ASSERT_EQ(files.size(), 3u);
  EXPECT_GT(fs::file_size(files[0]), 1000u);
  EXPECT_GT(fs::file_size(files[1]), 1000u);
  EXPECT_EQ(files[2].filename(), "meta.csv");
  EXPECT_TRUE(fs::exists(files[2]));
}

}  // namespace
}  // namespace energyprof::analysis
