/// An energy counter as a curve that only rises, and what is known between its updates.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "analysis/series.h"
#include "core/record.h"

namespace energyprof::analysis {

/// Energy between two moments.
struct Drawn {
  double joules = 0;
  double error_j = 0;  ///< one standard deviation, from the update that either end falls into
};

/// The energy of a counter, wraps undone, as of the moments when the counter moved.
///
/// A counter repeats its last value until it is updated, so only the readings at which it moved say
/// anything; between two of them energy is taken to flow evenly. A moment falls anywhere between
/// two updates D apart, so each end is uncertain by D / sqrt(12) times the power, and both together
/// by D / sqrt(6) = 0.41 D.
class EnergyCurve {
 public:
  /// `channel` counts energy, or measures power, which is then integrated. If nothing can be made
  /// of it, problem() says why.
  EnergyCurve(const Channel& channel, const SampleSeries& series,
              std::span<const Sleep> sleeps = {});

  [[nodiscard]] const std::string& problem() const { return problem_; }
  /// Median time between two updates of the sensor.
  [[nodiscard]] int64_t update_ns() const { return update_ns_; }
  [[nodiscard]] int64_t begin_ns() const { return t_ns_.front(); }
  [[nodiscard]] int64_t end_ns() const { return t_ns_.back(); }
  /// Falls and leaps that are no energy: resets, broken reads, gaps in which the counter may have
  /// wrapped unseen, sleeps of the machine.
  [[nodiscard]] std::size_t break_count() const { return break_count_; }

  /// nullopt where the curve does not reach, or where it is broken in between.
  [[nodiscard]] std::optional<Drawn> between(int64_t begin_ns, int64_t end_ns) const;

  /// Times of the updates, the energy since the first one in joules, and whether the stretch that
  /// ends at each is known.
  [[nodiscard]] const std::vector<int64_t>& t_ns() const { return t_ns_; }
  [[nodiscard]] const std::vector<double>& joules() const { return joules_; }
  /// How far from its time each update may really have been, to either side.
  [[nodiscard]] const std::vector<int64_t>& blur_ns() const { return blur_ns_; }
  [[nodiscard]] bool is_broken(std::size_t i) const {
    return i > 0 && breaks_until_[i] > breaks_until_[i - 1];
  }

 private:
  void read_counter(const Channel& channel, const SampleSeries& series,
                    std::span<const Sleep> sleeps);
  void read_power(const Channel& channel, const SampleSeries& series);

  std::vector<int64_t> t_ns_;
  std::vector<double> joules_;
  std::vector<int64_t> blur_ns_;
  std::vector<std::size_t> breaks_until_;
  std::size_t break_count_ = 0;
  int64_t update_ns_ = 0;
  std::string problem_;
};

}  // namespace energyprof::analysis
