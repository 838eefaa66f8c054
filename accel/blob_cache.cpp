// A file is: FileHeader, nodes, refs. Everything is little-endian.
#include "accel/blob_cache.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <libdeflate.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cerrno>
#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <span>
#include <stdexcept>
#include <system_error>
#include <utility>

#include "accel/bytes.h"
#include "accel/digest.h"
#include "accel/mesh_reader.h"
#include "core/algorithms.h"

namespace energyprof::accel {
namespace {

static_assert(std::endian::native == std::endian::little, "files are written as memory is");

/// Goes up whenever a builder's bytes change for the same mesh and parameters.
constexpr uint32_t builder_revision = 1;
constexpr uint32_t format_version = 1;
constexpr std::array<char, 8> magic{'E', 'P', 'B', 'L', 'O', 'B', '\r', '\n'};
constexpr size_t key_length = 64;

/// Where a file begins: no padding, so that every byte of it is checked.
struct FileHeader {
  std::array<char, 8> magic;
  uint32_t format_version;
  uint32_t checksum;  // CRC-32 of all that follows in the file
  std::array<char, key_length> key;
  uint64_t node_bytes;
  uint64_t ref_count;
  std::array<float, 3> bounds_min;
  std::array<float, 3> bounds_max;
  std::array<uint32_t, 3> grid_size;
  uint32_t max_depth;
  uint32_t kind;
  uint32_t has_sah_cost;
  double sah_cost;
  int64_t build_ns;
  int64_t node_count;
  int64_t leaf_count;
  int64_t stats_ref_count;
  int64_t stats_max_depth;
};
static_assert(sizeof(FileHeader) == 192);
constexpr size_t checked_from = offsetof(FileHeader, key);

FileHeader make_header(std::string_view key, const Built& built) {
  const AccelBlob& blob = built.blob;
  const BuildStats& stats = built.stats;
  FileHeader header{};
  header.magic = magic;
  header.format_version = format_version;
  std::ranges::copy(key.substr(0, key_length), header.key.begin());
  header.node_bytes = blob.nodes.size();
  header.ref_count = blob.refs.size();
  header.bounds_min = {blob.bounds_min.x, blob.bounds_min.y, blob.bounds_min.z};
  header.bounds_max = {blob.bounds_max.x, blob.bounds_max.y, blob.bounds_max.z};
  header.grid_size = {blob.grid_size.x, blob.grid_size.y, blob.grid_size.z};
  header.max_depth = blob.max_depth;
  header.kind = static_cast<uint32_t>(blob.kind);
  header.has_sah_cost = stats.sah_cost ? 1 : 0;
  header.sah_cost = stats.sah_cost.value_or(0.0);
  header.build_ns = stats.build_ns;
  header.node_count = stats.node_count;
  header.leaf_count = stats.leaf_count;
  header.stats_ref_count = stats.ref_count;
  header.stats_max_depth = stats.max_depth;
  return header;
}

/// All but nodes and refs.
Built from_header(const FileHeader& header) {
  Built built;
  AccelBlob& blob = built.blob;
  BuildStats& stats = built.stats;
  blob.kind = static_cast<AccelKind>(header.kind);
  for (int axis = 0; axis < 3; ++axis) {
    blob.bounds_min[axis] = header.bounds_min[static_cast<size_t>(axis)];
    blob.bounds_max[axis] = header.bounds_max[static_cast<size_t>(axis)];
    blob.grid_size[axis] = header.grid_size[static_cast<size_t>(axis)];
  }
  blob.max_depth = header.max_depth;
  if (header.has_sah_cost != 0) stats.sah_cost = header.sah_cost;
  stats.build_ns = header.build_ns;
  stats.blob_bytes = static_cast<int64_t>(header.node_bytes + header.ref_count * sizeof(uint32_t));
  stats.node_count = header.node_count;
  stats.leaf_count = header.leaf_count;
  stats.ref_count = header.stats_ref_count;
  stats.max_depth = header.stats_max_depth;
  return built;
}

/// CRC-32 of the header's checked part, the nodes and the refs.
uint32_t checksum(const FileHeader& header, const AccelBlob& blob) {
  uint32_t crc = libdeflate_crc32(0, reinterpret_cast<const char*>(&header) + checked_from,
                                  sizeof header - checked_from);
  // Without bytes data() may be null, which starts the CRC afresh.
  if (!blob.nodes.empty()) crc = libdeflate_crc32(crc, blob.nodes.data(), blob.nodes.size());
  const auto refs = std::as_bytes(std::span(blob.refs));
  return refs.empty() ? crc : libdeflate_crc32(crc, refs.data(), refs.size());
}

std::filesystem::path file_of(const std::filesystem::path& dir, std::string_view key) {
  return dir / fmt::format("{}.blob", key);
}

/// A file descriptor that closes itself.
class Descriptor {
 public:
  explicit Descriptor(int fd) : fd_(fd) {}
  ~Descriptor() { close(); }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  [[nodiscard]] int get() const { return fd_; }
  /// Returns whether all that was written arrived.
  bool close() { return fd_ < 0 || ::close(std::exchange(fd_, -1)) == 0; }

 private:
  int fd_;
};

/// Why a file is of no use.
class Unusable : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

void read_exactly(int fd, void* out, size_t byte_count) {
  auto* at = static_cast<char*>(out);
  while (byte_count > 0) {
    const ssize_t got = ::read(fd, at, byte_count);
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) throw Unusable(std::strerror(errno));
    if (got == 0) throw Unusable(fmt::format("it ended {} bytes early", byte_count));
    at += got;
    byte_count -= static_cast<size_t>(got);
  }
}

/// Returns whether all of it was written; otherwise errno says why.
bool write_all(int fd, std::span<const std::byte> bytes) {
  while (!bytes.empty()) {
    const ssize_t written = ::write(fd, bytes.data(), bytes.size());
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) return false;
    bytes = bytes.subspan(static_cast<size_t>(written));
  }
  return true;
}

/// Fills an empty vector from the file.
template <class T>
void read_into(std::vector<T>& vector, size_t count, int fd) {
  vector.reserve(count);
  prefer_large_pages(vector.data(), count * sizeof(T));
  vector.resize(count);
  read_exactly(fd, vector.data(), count * sizeof(T));
}

/// Throws Unusable unless the header's sizes are those of a file of `file_bytes`.
void check_header(const FileHeader& header, std::string_view key, uint64_t file_bytes) {
  if (header.magic != magic) throw Unusable("it is not a structure of energyprof");
  if (header.format_version != format_version)
    throw Unusable(fmt::format("it has format version {}, expected {}", header.format_version,
                               format_version));
  if (std::string_view(header.key.data(), key_length) != key)
    throw Unusable("it is the structure of another mesh or other parameters");
  const uint64_t content_bytes = file_bytes - sizeof header;
  if (header.node_bytes > content_bytes ||
      header.ref_count > (content_bytes - header.node_bytes) / sizeof(uint32_t) ||
      header.node_bytes + header.ref_count * sizeof(uint32_t) != content_bytes)
    throw Unusable(
        fmt::format("it has {} bytes, expected a header of {}, {} of nodes and {} references",
                    file_bytes, sizeof header, header.node_bytes, header.ref_count));
  if (header.kind > static_cast<uint32_t>(AccelKind::grid))
    throw Unusable(fmt::format("it holds a structure of unknown kind {}", header.kind));
}

Built read_blob(int fd, std::string_view key) {
  struct stat status {};
  if (::fstat(fd, &status) != 0) throw Unusable(std::strerror(errno));
  if (!S_ISREG(status.st_mode)) throw Unusable("it is not a regular file");
  const auto file_bytes = static_cast<uint64_t>(status.st_size);
  if (file_bytes < sizeof(FileHeader))
    throw Unusable(
        fmt::format("it has {} bytes, its header alone {}", file_bytes, sizeof(FileHeader)));
  FileHeader header;
  read_exactly(fd, &header, sizeof header);
  check_header(header, key, file_bytes);
  Built built = from_header(header);
  read_into(built.blob.nodes, header.node_bytes, fd);
  read_into(built.blob.refs, header.ref_count, fd);
  if (checksum(header, built.blob) != header.checksum)
    throw Unusable("it is damaged: its checksum is wrong");
  return built;
}

}  // namespace

std::filesystem::path blob_cache_dir() {
  const char* const cache_home = std::getenv("XDG_CACHE_HOME");
  // The XDG Base Directory Specification wants relative paths ignored.
  if (cache_home != nullptr && cache_home[0] == '/')
    return std::filesystem::path(cache_home) / "energyprof" / "structures";
  const char* const home = std::getenv("HOME");
  if (home == nullptr || home[0] == '\0')
    throw std::runtime_error(
        "cannot tell where structures are kept: neither XDG_CACHE_HOME nor HOME is set.");
  return std::filesystem::path(home) / ".cache" / "energyprof" / "structures";
}

std::string mesh_digest(const Mesh& mesh) {
  const auto text_of = [](const auto& vector) {
    return std::string_view(reinterpret_cast<const char*>(vector.data()),
                            vector.size() * sizeof(vector[0]));
  };
  return sha256_hex(sha256_hex(text_of(mesh.positions)) + sha256_hex(text_of(mesh.triangles)));
}

std::string blob_key(std::string_view mesh_digest, std::string_view builder_parameters,
                     AccelKind kind) {
  return sha256_hex(fmt::format("format {}\nbuilder {}\nkind {}\nmesh {}\nparameters {}",
                                format_version, builder_revision, static_cast<int>(kind),
                                mesh_digest, builder_parameters));
}

std::optional<Built> load_blob(const std::filesystem::path& dir, std::string_view key,
                               std::string& warning) {
  warning.clear();
  const std::filesystem::path file = file_of(dir, key);
  try {
    const Descriptor descriptor(::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
    if (descriptor.get() < 0 && errno == ENOENT) return std::nullopt;
    if (descriptor.get() < 0) throw Unusable(std::strerror(errno));
    return read_blob(descriptor.get(), key);
  } catch (const Unusable& why) {
    warning = fmt::format("cannot use the structure kept in {}: {}. It is built again.",
                          quoted_name(file.string()), why.what());
    return std::nullopt;
  }
}

void store_blob(const std::filesystem::path& dir, std::string_view key, const Built& built) {
  const std::filesystem::path file = file_of(dir, key);
  const auto fail = [&](std::string_view why) {
    throw std::runtime_error(
        fmt::format("cannot keep a structure in {}: {}.", quoted_name(file.string()), why));
  };
  std::error_code error;
  std::filesystem::create_directories(dir, error);
  if (error) fail(error.message());

  FileHeader header = make_header(key, built);
  header.checksum = checksum(header, built.blob);
  std::string name = (dir / fmt::format(".{}.XXXXXX", key)).string();
  Descriptor descriptor(::mkostemp(name.data(), O_CLOEXEC));
  if (descriptor.get() < 0) fail(std::strerror(errno));
  const int fd = descriptor.get();
  if (::fchmod(fd, 0644) == 0 && write_all(fd, std::as_bytes(std::span(&header, 1))) &&
      write_all(fd, built.blob.nodes) && write_all(fd, std::as_bytes(std::span(built.blob.refs))) &&
      descriptor.close() && ::rename(name.c_str(), file.c_str()) == 0)
    return;
  const int why = errno;
  ::unlink(name.c_str());
  fail(std::strerror(why));
}

}  // namespace energyprof::accel
