#include "app/results.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <sstream>

#include "app/terminal.h"

namespace energyprof::app {
namespace {

using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;

analysis::Analysis priced_study() {
  analysis::Analysis study;
  int64_t rank = 0;
  for (const char* algorithm : {"BVH_STACKLESS_DF", "GRID"}) {
    analysis::RankingRow row;
    row.algorithm = algorithm;
    row.rank = ++rank;
    row.score_ms = 1234.567;
    row.score_interval_ms = {1230.123, 1240.456};
    study.ranking.push_back(row);
    analysis::EnergyRow energy;
    energy.algorithm = algorithm;
    energy.model = "dragon";
    energy.nj_per_ray = analysis::Estimate{80.04, {79.61, 80.52}};
    study.energy.push_back(energy);
    analysis::Cell cell;
    cell.algorithm = algorithm;
    cell.outlier_count = 123'456;
    study.cells.push_back(cell);
  }
  study.headline = "BVH_STACKLESS_DF is best with a score of 1.23 s.";
  study.flags.push_back({"NOT A GPU",
                         "The device is a CPU that runs Vulkan in software: times compare the "
                         "algorithms on it, and say nothing about a GPU."});
  return study;
}

std::vector<std::string> lines_of(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream in(text);
  for (std::string line; std::getline(in, line);) lines.push_back(line);
  return lines;
}

TEST(Summary, FitsATerminalOf80Columns) {
  const std::string text = summary_text(priced_study(), 80);
  for (const std::string& line : lines_of(text)) EXPECT_LE(columns_of(line), 80u) << line;
  EXPECT_THAT(text, HasSubstr("1.23 s (1.23 to 1.24)"));
  EXPECT_THAT(text, HasSubstr("80.0 nJ (79.6 to 80.5)"));
  EXPECT_THAT(text, HasSubstr("123456"));
}

TEST(Summary, WritesASentenceALineForPrograms) {
  const std::string text = summary_text(priced_study(), std::nullopt);
  EXPECT_THAT(text,
              HasSubstr("\nNOT A GPU: The device is a CPU that runs Vulkan in software: times "
                        "compare the algorithms on it, and say nothing about a GPU.\n"));
  EXPECT_THAT(text, Not(HasSubstr("\033")));
  const std::vector<std::string> lines = lines_of(text);
  ASSERT_GE(lines.size(), 3u);
  EXPECT_THAT(lines[lines.size() - 3], StartsWith("BVH_STACKLESS_DF is best")) << text;
}

TEST(Wrapped, BreaksAtSpacesAndCountsCharactersNotBytes) {
  EXPECT_EQ(wrapped("aa bb cc", 0, 5), "aa bb\ncc");
  EXPECT_EQ(wrapped("µµ µµ cc", 0, 5), "µµ µµ\ncc");
  EXPECT_EQ(wrapped("aa bbbbbbbb cc", 2, 6), "aa\n  bbbbbbbb\n  cc");
  EXPECT_EQ(wrapped("", 0, 5), "");
}

}  // namespace
}  // namespace energyprof::app
