/// What the readers of mesh files share: messages that say where, and numbers that are exact.
#pragma once

#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <string>
#include <string_view>

#include "accel/mesh.h"

namespace energyprof::accel {

/// A text from outside, in quotes, fit for one line of a message: cut short, control characters
/// and bytes above ASCII as \xNN.
std::string quoted(std::string_view text);
/// The same for the name of a file: never cut short, UTF-8 left alone.
std::string quoted_name(std::string_view name);

/// The contents of a mesh file under the name that messages use.
struct MeshText {
  std::string_view name;
  std::string_view text;

  /// Throws std::runtime_error: "cannot read mesh 'name': line N: why."
  [[noreturn]] void fail_at_line(const char* at, std::string_view why) const;
  /// Throws std::runtime_error: "cannot read mesh 'name': byte N: why."
  [[noreturn]] void fail_at_byte(const char* at, std::string_view why) const;
  /// Throws std::runtime_error: "cannot read mesh 'name': why."
  [[noreturn]] void fail(std::string_view why) const;
};

/// The mesh as the file has it, not yet welded. Throw std::runtime_error.
Mesh parse_ply(const MeshText& file);
Mesh parse_obj(const MeshText& file);

inline bool is_digit(char c) { return static_cast<unsigned char>(c - '0') < 10; }

/// Appends the decimal digits at `p` to `value` (modulo 2^64) and returns where they end.
///
/// Eight characters at a time, without a branch per digit: see "Number Parsing at a Gigabyte per
/// Second", by D. Lemire, Software: Practice and Experience 51(8), 2021.
inline const char* scan_digits(const char* p, const char* end, uint64_t& value) {
  static_assert(std::endian::native == std::endian::little);
  static constexpr uint64_t powers_of_ten[] = {1,      10,      100,      1000,     10000,
                                               100000, 1000000, 10000000, 100000000};
  while (end - p >= 8) {
    uint64_t bytes = 0;
    std::memcpy(&bytes, p, 8);
    bytes ^= 0x3030303030303030u;  // digits become 0 to 9
    const uint64_t others = (bytes | (bytes + 0x7676767676767676u)) & 0x8080808080808080u;
    const int count = std::countr_zero(others) / 8;  // 8 if there are only digits
    if (count == 0) return p;
    bytes <<= 64 - 8 * count;  // the digits that are missing become leading zeros
    bytes = (bytes & 0x0f0f0f0f0f0f0f0fu) * (1 + (10 << 8)) >> 8;
    bytes = (bytes & 0x00ff00ff00ff00ffu) * (1 + (100 << 16)) >> 16;
    bytes = (bytes & 0x0000ffff0000ffffu) * (1 + (uint64_t{10000} << 32)) >> 32;
    value = value * powers_of_ten[count] + bytes;
    p += count;
    if (count < 8) return p;
  }
  for (; p != end && is_digit(*p); ++p) value = value * 10 + static_cast<uint64_t>(*p - '0');
  return p;
}

/// scan_float() for the few numbers that its short way does not settle.
const char* scan_float_exactly(const char* p, const char* end, float& value);

/// Why scan_float() refused `token`, in words, with what is allowed.
std::string why_not_a_float(std::string_view token);

/// Reads a decimal number at `p`, correctly rounded to float. Returns where it ends, or nullptr if
/// there is none or it is NaN, infinite or beyond float; what is too small becomes 0.
///
/// A mantissa below 2^53 and a power of ten up to 22 are exact doubles, so that one multiplication
/// or division rounds correctly ("How to Read Floating Point Numbers Accurately", by W. D. Clinger,
/// PLDI 1990). Rounding that double once more to float goes wrong only if it lies just between two
/// floats; then, and for all other numbers, scan_float_exactly() decides.
inline const char* scan_float(const char* begin, const char* end, float& value) {
  static constexpr double powers_of_ten[] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,
                                             1e8,  1e9,  1e10, 1e11, 1e12, 1e13, 1e14, 1e15,
                                             1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};
  if (begin == end) return nullptr;
  const bool negative = *begin == '-';
  const char* const digits = begin + (int{negative} | int{*begin == '+'});

  uint64_t mantissa = 0;
  const char* p = digits;  // few digits as a rule
  for (; p != end && is_digit(*p); ++p) mantissa = mantissa * 10 + static_cast<uint64_t>(*p - '0');
  ptrdiff_t digit_count = p - digits;
  ptrdiff_t exponent = 0;
  if (p != end && *p == '.') {
    const char* const fraction = p + 1;
    p = scan_digits(fraction, end, mantissa);
    exponent = fraction - p;
    digit_count -= exponent;
  }
  if (p != end && (*p == 'e' || *p == 'E')) {
    const char* q = p + 1;
    const bool below_one = q != end && *q == '-';
    if (q != end && (*q == '-' || *q == '+')) ++q;
    ptrdiff_t written = 0;
    const char* const exponent_digits = q;
    for (; q != end && is_digit(*q) && written < 1000; ++q) written = written * 10 + (*q - '0');
    if (q == exponent_digits) return nullptr;
    exponent += below_one ? -written : written;
    p = q;
  }
  // 19 digits fit into 64 bits.
  if (digit_count == 0 || digit_count > 19 || mantissa > (uint64_t{1} << 53) || exponent < -22 ||
      exponent > 22) {
    return scan_float_exactly(begin, end, value);
  }
  const double m = static_cast<double>(mantissa);
  const double wide = exponent < 0 ? m / powers_of_ten[-exponent] : m * powers_of_ten[exponent];
  const bool halfway = (std::bit_cast<uint64_t>(wide) & 0x1fffffff) == 0x10000000;
  const bool normal = wide >= double{std::numeric_limits<float>::min()} &&
                      wide <= double{std::numeric_limits<float>::max()};
  if (halfway || (!normal && mantissa != 0)) return scan_float_exactly(begin, end, value);
  value = static_cast<float>(std::copysign(wide, negative ? -1.0 : 1.0));
  return p;
}

}  // namespace energyprof::accel
