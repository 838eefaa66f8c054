// SHA-2 through libcrypto.
#include "accel/digest.h"

#include <fmt/format.h>
#include <openssl/evp.h>

#include <stdexcept>
#include <vector>

namespace energyprof::accel {
namespace {

constexpr std::string_view integrity_prefix = "sha512-";

std::vector<unsigned char> digest(const EVP_MD* algorithm, std::string_view bytes) {
  std::vector<unsigned char> result(static_cast<size_t>(EVP_MD_get_size(algorithm)));
  unsigned int length = 0;
  if (EVP_Digest(bytes.data(), bytes.size(), result.data(), &length, algorithm, nullptr) != 1) {
    throw std::runtime_error(
        fmt::format("cannot compute a digest: libcrypto refuses {}.", EVP_MD_get0_name(algorithm)));
  }
  return result;
}

}  // namespace

std::string sha256_hex(std::string_view bytes) {
  std::string hex;
  for (const unsigned char byte : digest(EVP_sha256(), bytes)) hex += fmt::format("{:02x}", byte);
  return hex;
}

std::string sha512_integrity(std::string_view bytes) {
  const std::vector<unsigned char> raw = digest(EVP_sha512(), bytes);
  std::vector<unsigned char> text(4 * ((raw.size() + 2) / 3) + 1);  // a NUL is written too
  const int length = EVP_EncodeBlock(text.data(), raw.data(), static_cast<int>(raw.size()));
  return std::string(integrity_prefix) + std::string(text.begin(), text.begin() + length);
}

std::string digest_like(std::string_view expected, std::string_view bytes) {
  return expected.starts_with(integrity_prefix) ? sha512_integrity(bytes) : sha256_hex(bytes);
}

}  // namespace energyprof::accel
