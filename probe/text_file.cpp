#include "probe/text_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <charconv>
#include <limits>
#include <system_error>
#include <utility>

#include "core/clock.h"
#include "probe/names.h"

namespace energyprof::probe {
namespace {

constexpr int64_t retry_rarely_ns = ns_per_s;
constexpr int64_t path_check_ns = 50 * ns_per_ms;

int open_to_read(const std::string& path) {
  // O_NOFOLLOW: all links were followed inside the root already; a new one could lead out of it.
  // O_NONBLOCK: a pipe below a --root would be waited for.
  constexpr int flags = O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK;
  // Keeping the time of the last access would cost each read some 5 %. Only owners may go without.
  const int fd = open(path.c_str(), flags | O_NOATIME);
  return fd < 0 && errno == EPERM ? open(path.c_str(), flags) : fd;
}

}  // namespace

bool is_transient(int error) {
  return error == EAGAIN || error == EBUSY || error == ETIMEDOUT || error == EINTR;
}

PollStatus status_of(int error) {
  switch (error) {
    case 0:
      return PollStatus::ok;
    case ENOENT:
    case ENODEV:
    case ENXIO:
    case ENOTDIR:
    case ESTALE:
      return PollStatus::gone;
    default:
      return PollStatus::retry;
  }
}

std::optional<int64_t> parse_int(std::string_view text) {
  const std::string_view digits = trim(text);
  int64_t value = 0;
  const char* const end = digits.data() + digits.size();
  const auto [stop, error] = std::from_chars(digits.data(), end, value);
  if (digits.empty() || error != std::errc{} || stop != end) return std::nullopt;
  return value;
}

std::optional<int64_t> find_int(std::string_view text, std::string_view key) {
  while (!text.empty()) {
    const size_t end = std::min(text.find('\n'), text.size());
    const std::string_view line = text.substr(0, end);
    if (line.starts_with(key) && line.size() > key.size() && line[key.size()] == ' ')
      return parse_int(line.substr(key.size()));
    text.remove_prefix(std::min(end + 1, text.size()));
  }
  return std::nullopt;
}

TextFile::TextFile(const Root& root, std::string_view path)
    : display_path_(root.display(path)), may_be_replaced_(!root.is_host()) {
  Root::Resolved resolved = root.resolve(path);
  host_path_ = std::move(resolved.path);
  error_ = resolved.error != 0 ? resolved.error : root.read_error(host_path_);
  if (error_ != 0) error_until_ns_ = std::numeric_limits<int64_t>::max();
}

TextFile::~TextFile() {
  if (fd_ >= 0) close(fd_);
}

TextFile::TextFile(TextFile&& other) noexcept
    : display_path_(std::move(other.display_path_)),
      host_path_(std::move(other.host_path_)),
      may_be_replaced_(other.may_be_replaced_),
      next_path_check_ns_(other.next_path_check_ns_),
      fd_(std::exchange(other.fd_, -1)),
      device_(other.device_),
      inode_(other.inode_),
      passing_error_(other.passing_error_),
      error_(other.error_),
      error_until_ns_(other.error_until_ns_) {}

void TextFile::expect(int error) {
  passing_error_ = error;
  if (error_ == error) error_ = ENODATA;
}

TextFile::Read TextFile::read(std::span<char> buffer) noexcept {
  const int64_t before_ns = now_ns();
  if (before_ns < error_until_ns_) return {{}, before_ns, 0, error_};
  int error = 0;
  ssize_t got = 0;
  if (fd_ >= 0 && may_be_replaced_ && was_replaced(before_ns)) close(std::exchange(fd_, -1));
  if (fd_ < 0) open_anew();
  if (fd_ < 0) {
    error = errno;
  } else {
    got = pread(fd_, buffer.data(), buffer.size(), 0);
    if (got < 0) error = errno;
  }
  const int64_t after_ns = now_ns();
  if (error != 0 && error == passing_error_) error = ENODATA;
  const bool is_gone = status_of(error) == PollStatus::gone;
  if (fd_ >= 0 && is_gone) close(std::exchange(fd_, -1));
  error_ = error;
  if (is_gone)
    error_until_ns_ = std::numeric_limits<int64_t>::max();
  else if (error != 0 && !is_transient(error))
    error_until_ns_ = after_ns + retry_rarely_ns;
  const size_t byte_count = got > 0 ? static_cast<size_t>(got) : 0;
  return {{buffer.data(), byte_count},
          before_ns + (after_ns - before_ns) / 2,
          after_ns - before_ns,
          error};
}

void TextFile::open_anew() noexcept {
  fd_ = open_to_read(host_path_);
  struct stat open_file {};
  if (fd_ < 0 || !may_be_replaced_ || fstat(fd_, &open_file) != 0) return;
  device_ = open_file.st_dev;
  inode_ = open_file.st_ino;
}

// Whether the path leads elsewhere now; looks every path_check_ns.
bool TextFile::was_replaced(int64_t now_ns) noexcept {
  if (now_ns < next_path_check_ns_) return false;
  next_path_check_ns_ = now_ns + path_check_ns;
  struct stat named_file {};
  return lstat(host_path_.c_str(), &named_file) != 0 || named_file.st_ino != inode_ ||
         named_file.st_dev != device_;
}

Reading TextFile::Read::reading(std::optional<int64_t> value) const {
  PollStatus status = status_of(error);
  if (status == PollStatus::ok && !value) status = PollStatus::retry;
  return {status, t_ns, value.value_or(0), width_ns, error};
}

Reading TextFile::read_int() noexcept {
  std::array<char, 64> buffer;
  const Read read = this->read(buffer);
  return read.reading(read.error == 0 ? parse_int(read.text) : std::nullopt);
}

CheckedFile check_int_file(const Root& root, std::string_view path, int passing_error) {
  CheckedFile checked{TextFile(root, path), std::nullopt, 0, {}};
  if (passing_error != 0) checked.file.expect(passing_error);
  std::array<char, 64> buffer{};
  const TextFile::Read read = checked.file.read(buffer);
  checked.error = read.error;
  if (read.error != 0) {
    if (!is_transient(read.error))
      checked.problem =
          fmt::format("cannot read '{}': {}", checked.file.path(), errno_text(read.error));
    return checked;
  }
  checked.value = parse_int(read.text);
  if (checked.value) return checked;
  const std::string_view text = trim(read.text);
  if (text.empty())
    checked.problem = fmt::format("'{}' is empty", checked.file.path());
  else if (text.find_first_not_of("0123456789") == std::string_view::npos)
    checked.problem =
        fmt::format("'{}' holds {}, more than 63 bits can", checked.file.path(), text);
  else
    checked.problem =
        fmt::format("'{}' holds '{}', which is no integer", checked.file.path(), shown(text));
  return checked;
}

}  // namespace energyprof::probe
