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

/// Transforms that fit the innermost caches are done level by level, larger ones half by half.
constexpr std::size_t cached_size = 4096;

using Complex = std::complex<double>;

/// One level of a forward transform by decimation in frequency; `turn` has `half` values.
void split(Complex* values, std::size_t half, const Complex* turn) {
  for (std::size_t k = 0; k < half; ++k) {
    const Complex first = values[k];
    const Complex second = values[half + k];
    values[k] = first + second;
    values[half + k] = product(first - second, turn[k]);
  }
}

/// One level of an inverse transform by decimation in time: undoes split(), but for a factor of 2.
void join(Complex* values, std::size_t half, const Complex* turn) {
  for (std::size_t k = 0; k < half; ++k) {
    const Complex even = values[k];
    const Complex odd = product(values[half + k], std::conj(turn[k]));
    values[k] = even + odd;
    values[half + k] = even - odd;
  }
}

/// Leaves the spectrum in the order of indices whose bits are read backwards, which is all the same
/// to a product of two spectra. `turn[half + k]` is exp(-i pi k / half).
void transform(Complex* values, std::size_t size, const Complex* turn) {
  if (size > cached_size) {
    split(values, size / 2, turn + size / 2);
    transform(values, size / 2, turn);
    transform(values + size / 2, size / 2, turn);
    return;
  }
  for (std::size_t half = size / 2; half > 0; half /= 2)
    for (std::size_t begin = 0; begin < size; begin += 2 * half)
      split(values + begin, half, turn + half);
}

/// From that order back, times `size`.
void transform_back(Complex* values, std::size_t size, const Complex* turn) {
  if (size > cached_size) {
    transform_back(values, size / 2, turn);
    transform_back(values + size / 2, size / 2, turn);
    join(values, size / 2, turn + size / 2);
    return;
  }
  for (std::size_t half = 1; half < size; half *= 2)
    for (std::size_t begin = 0; begin < size; begin += 2 * half)
      join(values + begin, half, turn + half);
}

}  // namespace

CircularCorrelator::CircularCorrelator(std::span<const double> x) : length_(x.size()) {
  const std::size_t padded = std::bit_ceil(std::max<std::size_t>(2 * length_, 2));
  turn_.resize(padded);
  for (std::size_t half = padded / 2; half > 0; half /= 2)
    for (std::size_t k = 0; k < half; ++k)
      turn_[half + k] = 2 * half == padded
                            ? std::polar(1.0, -std::numbers::pi * static_cast<double>(k) /
                                                  static_cast<double>(half))
                            : turn_[2 * half + 2 * k];
  spectrum_.assign(padded, 0);
  std::copy(x.begin(), x.end(), spectrum_.begin());
  transform(spectrum_.data(), padded, turn_.data());
}

CircularCorrelator::Pair CircularCorrelator::correlate(std::span<const double> first,
                                                       std::span<const double> second) const {
  assert(first.size() == length_ && (second.empty() || second.size() == length_));
  const std::size_t padded = spectrum_.size();
  std::vector<Complex> values(padded);
  for (std::size_t i = 0; i < length_; ++i)
    values[i] = {first[i], second.empty() ? 0.0 : second[i]};
  transform(values.data(), padded, turn_.data());
  for (std::size_t k = 0; k < padded; ++k) values[k] = product(std::conj(spectrum_[k]), values[k]);
  transform_back(values.data(), padded, turn_.data());

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
