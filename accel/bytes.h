/// Whole files as bytes: read in one go, and gzip taken off in one go.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string_view>

namespace energyprof::accel {

/// Bytes that are owned, and never filled with zeros first.
struct Bytes {
  std::unique_ptr<char[]> data;
  size_t byte_count = 0;

  [[nodiscard]] std::string_view view() const { return {data.get(), byte_count}; }
};

/// The most that inflate_gzip() gives: 4 GiB, which as text is some hundred million triangles.
inline constexpr uint64_t max_inflated_bytes = uint64_t{1} << 32;

/// The whole of a regular file. Throws std::runtime_error, naming the file: it does not exist,
/// cannot be read, or is a directory or a device.
Bytes read_file(const std::filesystem::path& file);

/// Asks the system for large pages under memory that has not been written to yet: the first touch
/// of many small ones is a good part of what loading a mesh costs. Only a wish; nothing depends on
/// it.
void prefer_large_pages(const void* begin, size_t byte_count);

/// True if the bytes begin as a gzip file does.
bool is_gzip(std::string_view bytes);

/// The contents of a gzip file of one or more members; `name` stands in messages.
///
/// What the file says about its own size is a hint and never trusted. Throws std::runtime_error
/// when the data is damaged, truncated, followed by something else, or more than `limit_bytes`.
Bytes inflate_gzip(std::string_view name, std::string_view bytes,
                   uint64_t limit_bytes = max_inflated_bytes);

}  // namespace energyprof::accel
