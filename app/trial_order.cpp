#include "app/trial_order.h"

#include <numeric>
#include <random>

namespace energyprof::app {
namespace {

/// Fisher-Yates with a fixed way of drawing: std::shuffle differs between standard libraries.
template <class T>
void shuffle(std::vector<T>& items, std::mt19937_64& random) {
  for (size_t i = items.size(); i > 1; --i) std::swap(items[i - 1], items[random() % i]);
}

}  // namespace

std::vector<PlannedTrial> plan_trials(const StudySize& size, bool latin_square, uint32_t seed) {
  std::mt19937_64 random(seed);
  std::vector<size_t> algorithms(size.algorithm_count);
  std::iota(algorithms.begin(), algorithms.end(), size_t{0});
  if (latin_square) shuffle(algorithms, random);

  std::vector<PlannedTrial> trials;
  size_t rotation = 0;
  for (int64_t repetition = 0; repetition < size.repetition_count; ++repetition) {
    std::vector<PlannedTrial> blocks;
    for (size_t model = 0; model < size.model_count; ++model)
      for (size_t view = 0; view < size.view_count; ++view)
        blocks.push_back({model, view, 0, repetition});
    if (latin_square) shuffle(blocks, random);
    for (PlannedTrial block : blocks) {
      for (size_t i = 0; i < algorithms.size(); ++i) {
        block.algorithm = algorithms[(i + rotation) % algorithms.size()];
        trials.push_back(block);
      }
      if (latin_square) ++rotation;
    }
  }
  return trials;
}

}  // namespace energyprof::app
