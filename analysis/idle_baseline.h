/// What a machine draws at rest, and how that changes over a run.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace energyprof::analysis {

/// A part of an idle stretch.
struct IdlePiece {
  std::size_t stretch = 0;  ///< which one it belongs to
  int64_t begin_ns = 0;
  int64_t end_ns = 0;
  double joules = 0;
  double error_j = 0;  ///< one standard deviation, from the edges
};

/// Power at rest as a polynomial over time, fitted to idle pieces by least squares, each weighted
/// with its length. Its degree, 0 to 3 and at most half of the number of stretches, is what
/// Akaike's criterion prefers: chips leak more as they warm up, so that what is taken off the first
/// trial is not what the last one rests on. Before the first piece and behind the last one it is
/// what it is there.
///
/// See "Regression and Time Series Model Selection in Small Samples", by C. Hurvich and C. Tsai,
/// Biometrika 76(2), 1989.
class IdleBaseline {
 public:
  static constexpr std::size_t max_term_count = 4;
  /// Of the polynomial, in watts.
  using Terms = std::array<double, max_term_count>;
  /// Seconds by term: what a stretch of time is to the polynomial.
  using Shape = std::array<double, max_term_count>;

  IdleBaseline() = default;
  explicit IdleBaseline(const std::vector<IdlePiece>& pieces);

  [[nodiscard]] bool empty() const { return units_.empty(); }
  [[nodiscard]] const Terms& terms() const { return terms_; }
  [[nodiscard]] Shape shape(int64_t begin_ns, int64_t end_ns) const;
  /// What is drawn at rest during what `shape` stands for.
  [[nodiscard]] static double joules(const Shape& shape, const Terms& terms);
  /// Mean power over the pieces.
  [[nodiscard]] double mean_w() const { return mean_w_; }
  /// Pieces, or stretches, beyond what the polynomial takes.
  [[nodiscard]] double freedom() const;
  /// Bootstrap of the residuals: what else the terms may be.
  [[nodiscard]] std::vector<Terms> draw(std::size_t count, uint64_t seed) const;

 private:
  /// What varies independently: stretches where there are enough of them, else pieces.
  struct Unit {
    double u = 0;  // time, -1 to 1 from the first to the last
    double watts = 0;
    double error_w = 0;
    double length_s = 0;
  };
  [[nodiscard]] double scaled_time(double t_ns) const;
  [[nodiscard]] Terms fit(const std::vector<double>& watts) const;
  bool set_degree(std::size_t degree);

  std::vector<Unit> units_;
  double middle_ns_ = 0;
  double half_ns_ = 1;
  std::size_t term_count_ = 0;
  std::vector<Terms> weight_;  // by unit: what a watt of it adds to each term
  Terms terms_{};
  double mean_w_ = 0;
};

}  // namespace energyprof::analysis
