#include "analysis/fft.h"

#include <algorithm>
#include <bit>
#include <cassert>
#include <numbers>
#include <utility>

namespace energyprof::analysis {
namespace {

/// a * b. std::complex's own product looks for infinities, which costs three times as much.
std::complex<double> product(std::complex<double> a, std::complex<double> b) {
  return {a.real() * b.real() - a.imag() * b.imag(), a.real() * b.imag() + a.imag() * b.real()};
}

/// Puts each value where the bits of its index, read backwards, say.
void reverse_bits(std::vector<std::complex<double>>& values) {
  for (std::size_t i = 1, j = 0; i < values.size(); ++i) {
    std::size_t bit = values.size() >> 1;
    for (; (j & bit) != 0; bit >>= 1) j ^= bit;
    j ^= bit;
    if (i < j) std::swap(values[i], values[j]);
  }
}

}  // namespace

CircularCorrelator::CircularCorrelator(std::span<const double> x) : length_(x.size()) {
  const std::size_t padded = std::bit_ceil(std::max<std::size_t>(2 * length_, 2));
  turn_.resize(padded / 2);
  for (std::size_t k = 0; k < turn_.size(); ++k)
    turn_[k] = std::polar(
        1.0, -2 * std::numbers::pi * static_cast<double>(k) / static_cast<double>(padded));
  spectrum_.assign(padded, 0);
  std::copy(x.begin(), x.end(), spectrum_.begin());
  transform(spectrum_, false);
}

void CircularCorrelator::transform(std::vector<Complex>& values, bool inverse) const {
  reverse_bits(values);
  for (std::size_t half = 1; half < values.size(); half *= 2) {
    const std::size_t stride = turn_.size() / half;
    for (std::size_t begin = 0; begin < values.size(); begin += 2 * half)
      for (std::size_t k = 0; k < half; ++k) {
        const Complex turn = inverse ? std::conj(turn_[k * stride]) : turn_[k * stride];
        const Complex odd = product(values[begin + half + k], turn);
        const Complex even = values[begin + k];
        values[begin + k] = even + odd;
        values[begin + half + k] = even - odd;
      }
  }
}

CircularCorrelator::Pair CircularCorrelator::correlate(std::span<const double> first,
                                                       std::span<const double> second) const {
  assert(first.size() == length_ && (second.empty() || second.size() == length_));
  const std::size_t padded = spectrum_.size();
  std::vector<Complex> values(padded);
  for (std::size_t i = 0; i < length_; ++i)
    values[i] = {first[i], second.empty() ? 0.0 : second[i]};
  transform(values, false);
  for (std::size_t k = 0; k < padded; ++k) values[k] = product(std::conj(spectrum_[k]), values[k]);
  transform(values, true);

  Pair result;
  result.first.resize(length_);
  if (!second.empty()) result.second.resize(length_);
  const double scale = 1 / static_cast<double>(padded);
  for (std::size_t s = 0; s < length_; ++s) {
    // The shift s and the shift s - n backwards are the same turn of the circle.
    Complex sum = values[s];
    if (s > 0) sum += values[padded + s - length_];
    result.first[s] = sum.real() * scale;
    if (!second.empty()) result.second[s] = sum.imag() * scale;
  }
  return result;
}

}  // namespace energyprof::analysis
