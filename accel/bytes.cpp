// Reading whole files, and gzip in memory through libdeflate.
#include "accel/bytes.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <libdeflate.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <stdexcept>

#include "accel/mesh_reader.h"

namespace energyprof::accel {
namespace {

[[noreturn]] void fail_to_read(const std::filesystem::path& file, std::string_view why) {
  throw std::runtime_error(fmt::format("cannot read {}: {}.", quoted_name(file.string()), why));
}

/// A file descriptor that closes itself.
class Descriptor {
 public:
  explicit Descriptor(int fd) : fd_(fd) {}
  ~Descriptor() {
    if (fd_ >= 0) ::close(fd_);
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  [[nodiscard]] int get() const { return fd_; }

 private:
  int fd_;
};

// Deflate cannot expand data by more than this factor (zlib's technical notes, "Maximum Compression
// Factor"), so that no more than that is ever allocated for a file, whatever its trailer says.
constexpr uint64_t max_deflate_ratio = 1032;

std::unique_ptr<char[]> allocate(size_t byte_count) {
  auto data = std::make_unique_for_overwrite<char[]>(byte_count);
  prefer_large_pages(data.get(), byte_count);
  return data;
}

/// Grows `bytes` to `capacity` and keeps the first `byte_count` bytes.
void grow(Bytes& bytes, size_t capacity) {
  auto larger = allocate(capacity);
  if (bytes.byte_count > 0) std::memcpy(larger.get(), bytes.data.get(), bytes.byte_count);
  bytes.data = std::move(larger);
}

/// The size of the last member modulo 2^32, as the last four bytes of a gzip file give it.
uint64_t trailer_size(std::string_view bytes) {
  if (bytes.size() < 4) return 0;
  uint64_t size = 0;
  for (size_t k = 0; k < 4; ++k) {
    size |= uint64_t{static_cast<unsigned char>(bytes[bytes.size() - 4 + k])} << (8 * k);
  }
  return size;
}

}  // namespace

Bytes read_file(const std::filesystem::path& file) {
  const Descriptor descriptor(::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  if (descriptor.get() < 0) fail_to_read(file, std::strerror(errno));
  struct stat status {};
  if (::fstat(descriptor.get(), &status) != 0) fail_to_read(file, std::strerror(errno));
  if (S_ISDIR(status.st_mode)) fail_to_read(file, "it is a directory, not a file");
  if (!S_ISREG(status.st_mode)) fail_to_read(file, "it is not a regular file");

  const auto byte_count = static_cast<size_t>(status.st_size);
  Bytes bytes{allocate(byte_count), 0};
  while (bytes.byte_count < byte_count) {  // one read() gives at most 2 GiB
    const ssize_t got = ::read(descriptor.get(), bytes.data.get() + bytes.byte_count,
                               byte_count - bytes.byte_count);
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) fail_to_read(file, std::strerror(errno));
    if (got == 0) {
      fail_to_read(file, fmt::format("it ended after {} of {} bytes while it was being read",
                                     bytes.byte_count, byte_count));
    }
    bytes.byte_count += static_cast<size_t>(got);
  }
  return bytes;
}

void prefer_large_pages(const void* begin, size_t byte_count) {
  constexpr uintptr_t page_size = 4096;
  constexpr size_t large_page_bytes = 2 << 20;
  if (byte_count < large_page_bytes) return;
  const auto first = (reinterpret_cast<uintptr_t>(begin) + page_size - 1) / page_size * page_size;
  const auto last = (reinterpret_cast<uintptr_t>(begin) + byte_count) / page_size * page_size;
  ::madvise(reinterpret_cast<void*>(first), last - first, MADV_HUGEPAGE);
}

bool is_gzip(std::string_view bytes) { return bytes.starts_with("\x1f\x8b"); }

Bytes inflate_gzip(std::string_view name, std::string_view bytes, uint64_t limit_bytes) {
  const auto fail = [&](size_t offset, std::string_view why) {
    throw std::runtime_error(
        fmt::format("cannot unpack {}: byte {}: {}.", quoted_name(name), offset, why));
  };
  const uint64_t ceiling =
      std::min<uint64_t>(limit_bytes, bytes.size() * max_deflate_ratio + max_deflate_ratio);
  size_t capacity = std::min<uint64_t>(trailer_size(bytes), ceiling);
  Bytes out;
  grow(out, capacity);

  const std::unique_ptr<libdeflate_decompressor, decltype(&libdeflate_free_decompressor)>
      decompressor(libdeflate_alloc_decompressor(), &libdeflate_free_decompressor);
  if (!decompressor) throw std::bad_alloc();
  size_t position = 0;
  while (position < bytes.size()) {
    if (!is_gzip(bytes.substr(position))) fail(position, "what follows is not gzip data");
    size_t used = 0;
    size_t made = 0;
    const libdeflate_result result = libdeflate_gzip_decompress_ex(
        decompressor.get(), bytes.data() + position, bytes.size() - position,
        out.data.get() + out.byte_count, capacity - out.byte_count, &used, &made);
    if (result == LIBDEFLATE_SUCCESS) {
      position += used;
      out.byte_count += made;
    } else if (result != LIBDEFLATE_INSUFFICIENT_SPACE) {
      fail(position, "the gzip data that begins here is damaged or cut off");
    } else if (capacity == ceiling) {
      fail(position,
           fmt::format("the gzip data that begins here holds more than {} bytes", ceiling));
    } else {
      capacity = std::min<uint64_t>(std::max<uint64_t>(2 * uint64_t{capacity}, 1 << 16), ceiling);
      grow(out, capacity);
    }
  }
  return out;
}

}  // namespace energyprof::accel
