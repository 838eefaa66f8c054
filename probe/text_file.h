/// Small kernel text files that are read again and again, and what their errors mean.
#pragma once

#include <sys/types.h>

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "probe/root.h"
#include "probe/source.h"

namespace energyprof::probe {

/// What a failed read means for its channel: `gone` for ENOENT, ENODEV, ENXIO, ENOTDIR and ESTALE;
/// `retry` for all others, which come and go (EAGAIN, EBUSY, ETIMEDOUT, ENODATA, EPERM of a
/// sleeping device, EIO of a bus, ...). 0 is ok.
PollStatus status_of(int error);

/// Whether a failed read is nothing to speak of: the sensor is busy or asleep and may answer at the
/// next poll (EAGAIN, EBUSY, ETIMEDOUT, EINTR). Other errors that pass are tried again rarely.
bool is_transient(int error);

/// The integer that is all of `text`, but for white space around it. nullopt for anything else,
/// numbers beyond 64 bits with sign included.
std::optional<int64_t> parse_int(std::string_view text);

/// The integer after `key` at the start of a line ("nr_throttled 2"); nullopt without such a line.
std::optional<int64_t> find_int(std::string_view text, std::string_view key);

/// One file, opened once and read from its start each time, as sysfs wants it. Below a --root a
/// file that was replaced meanwhile is opened anew, so that a run follows what happens there:
/// within 50 ms after a rename or removal, at once when it is written in place.
class TextFile {
 public:
  /// Never fails; a file that cannot be opened says so at each read().
  TextFile(const Root& root, std::string_view path);
  ~TextFile();
  TextFile(TextFile&& other) noexcept;
  TextFile& operator=(TextFile&&) = delete;

  struct Read {
    std::string_view text;  ///< lies in the caller's buffer
    int64_t t_ns = 0;       ///< midpoint of the clock before and after the read
    int64_t width_ns = 0;   ///< time between the two
    int error = 0;          ///< errno

    /// A Reading with this read's time and error; `retry` where there is no value.
    [[nodiscard]] Reading reading(std::optional<int64_t> value) const;
  };
  /// From now on `error`, which means `gone` elsewhere, is "no value now" (ENODATA): it passes.
  void expect(int error);
  /// Reads as much as fits. An error that means `gone` is final: later calls repeat it at no cost.
  /// Other errors, transient ones excepted, are repeated at no cost for a second.
  Read read(std::span<char> buffer) noexcept;
  /// Reads one integer. Text that is none (empty, half-written) is `retry`.
  Reading read_int() noexcept;

  /// As a person would write it.
  [[nodiscard]] const std::string& path() const { return display_path_; }

 private:
  void open_anew() noexcept;
  bool was_replaced(int64_t now_ns) noexcept;

  std::string display_path_;
  std::string host_path_;
  bool may_be_replaced_;
  int64_t next_path_check_ns_ = 0;
  int fd_ = -1;
  dev_t device_ = 0;  // of the open file, with inode_: who it is
  ino_t inode_ = 0;
  int passing_error_ = 0;
  int error_ = 0;               // repeated without a read ...
  int64_t error_until_ns_ = 0;  // ... until then; where it is final, for ever
};

/// A file that should hold one integer, after its first read.
struct CheckedFile {
  TextFile file;
  std::optional<int64_t> value;  ///< absent also when the sensor was only busy or asleep
  int error = 0;                 ///< errno of the first read
  std::string problem;           ///< why it is no use as a channel, in words; empty: it is
};
/// `passing_error`: as for TextFile::expect(); 0: none.
CheckedFile check_int_file(const Root& root, std::string_view path, int passing_error = 0);

}  // namespace energyprof::probe
