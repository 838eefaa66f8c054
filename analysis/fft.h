/// Correlating one series with another at every shift at once.
#pragma once

#include <complex>
#include <cstddef>
#include <span>
#include <vector>

namespace energyprof::analysis {

/// Circular cross-correlations of a series x of any length n with others of the same length:
/// result[s] = sum over i of x[i] * y[(i + s) mod n], for all s in n log n steps.
///
/// Through the convolution theorem, on series padded with zeros to a power of two of at least 2 n
/// and folded back. See "An Algorithm for the Machine Calculation of Complex Fourier Series", by J.
/// Cooley and J. Tukey, Mathematics of Computation 19(90), 1965.
class CircularCorrelator {
 public:
  explicit CircularCorrelator(std::span<const double> x);

  /// The correlations with two series, which cost as much as one: the second travels as imaginary
  /// part.
  struct Pair {
    std::vector<double> first, second;
  };
  [[nodiscard]] Pair correlate(std::span<const double> first, std::span<const double> second) const;
  [[nodiscard]] std::vector<double> correlate(std::span<const double> y) const {
    return correlate(y, {}).first;
  }

 private:
  using Complex = std::complex<double>;

  std::size_t length_;         // n
  std::vector<Complex> turn_;  // by level: [half + k] is exp(-pi i k / half), k < half
  std::vector<Complex> spectrum_;
};

}  // namespace energyprof::analysis
