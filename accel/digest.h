/// Digests that files are checked against.
#pragma once

#include <string>
#include <string_view>

namespace energyprof::accel {

/// SHA-256 in lower-case hexadecimal, as sha256sum prints it.
std::string sha256_hex(std::string_view bytes);

/// SHA-512 as package registries write it: "sha512-" and base64 (W3C Subresource Integrity).
std::string sha512_integrity(std::string_view bytes);

/// The digest of `bytes` in the form of `expected`: sha512_integrity() if that is its form, else
/// sha256_hex().
std::string digest_like(std::string_view expected, std::string_view bytes);

}  // namespace energyprof::accel
