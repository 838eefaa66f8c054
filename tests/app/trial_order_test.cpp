// The order of trials: complete, balanced, and the same for the same seed.
#include "app/trial_order.h"

#include <gtest/gtest.h>

#include <map>
#include <set>
#include <tuple>

namespace energyprof::app {
namespace {

using Cell = std::tuple<size_t, size_t, size_t, int64_t>;

std::vector<Cell> cells(const std::vector<PlannedTrial>& plan) {
  std::vector<Cell> result;
  for (const PlannedTrial& t : plan)
    result.emplace_back(t.model, t.view, t.algorithm, t.repetition);
  return result;
}

TEST(TrialOrder, EveryCellRunsOncePerRepetition) {
  for (const bool latin_square : {true, false}) {
    const auto plan = cells(plan_trials({2, 3, 5, 4}, latin_square, 1));
    EXPECT_EQ(plan.size(), 2u * 3 * 5 * 4);
    EXPECT_EQ(std::set<Cell>(plan.begin(), plan.end()).size(), plan.size());
  }
}

TEST(TrialOrder, EachAlgorithmStandsInEachPlaceEquallyOften) {
  // 5 models x 3 views = 15 blocks of 5 algorithms: each place sees each algorithm 3 times.
  const auto plan = plan_trials({5, 3, 5, 1}, true, 42);
  std::map<std::pair<size_t, size_t>, int> count;  // place in block, algorithm
  for (size_t i = 0; i < plan.size(); ++i) ++count[{i % 5, plan[i].algorithm}];
  EXPECT_EQ(count.size(), 25u);
  for (const auto& [place, n] : count) EXPECT_EQ(n, 3);
}

TEST(TrialOrder, AnySixBlocksInARowAreALatinSquare) {
  // Six algorithms on 3 models x 3 views, twice: 18 blocks, across the seam of the repetitions too.
  constexpr size_t n = 6;
  for (uint32_t seed = 0; seed < 50; ++seed) {
    SCOPED_TRACE(seed);
    const auto plan = plan_trials({3, 3, n, 2}, true, seed);
    for (size_t block = 0; block + n <= plan.size() / n; ++block)
      for (size_t i = 0; i < n; ++i) {
        std::set<size_t> row;     // one block, all places
        std::set<size_t> column;  // one place, all blocks
        for (size_t j = 0; j < n; ++j) {
          row.insert(plan[(block + i) * n + j].algorithm);
          column.insert(plan[(block + j) * n + i].algorithm);
        }
        ASSERT_EQ(row.size(), n);
        ASSERT_EQ(column.size(), n);
      }
  }
}

TEST(TrialOrder, BlocksStayTogether) {
  const auto plan = plan_trials({3, 3, 4, 2}, true, 7);
  for (size_t i = 0; i < plan.size(); i += 4)
    for (size_t j = 1; j < 4; ++j) {
      EXPECT_EQ(plan[i].model, plan[i + j].model);
      EXPECT_EQ(plan[i].view, plan[i + j].view);
    }
}

TEST(TrialOrder, SeedDecides) {
  EXPECT_EQ(cells(plan_trials({3, 3, 5, 1}, true, 1)), cells(plan_trials({3, 3, 5, 1}, true, 1)));
  EXPECT_NE(cells(plan_trials({3, 3, 5, 1}, true, 1)), cells(plan_trials({3, 3, 5, 1}, true, 2)));
  EXPECT_EQ(cells(plan_trials({3, 3, 5, 1}, false, 1)), cells(plan_trials({3, 3, 5, 1}, false, 2)));
}

}  // namespace
}  // namespace energyprof::app
