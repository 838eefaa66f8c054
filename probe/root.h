/// The file system the sensors are read from: "/" or a directory that mimics it (--root).
#pragma once

#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace energyprof::probe {

/// Resolves "sys/...", "proc/..." and "dev/..." below one directory and never leaves it: links are
/// followed as chroot(2) would, absolute ones and ".." included.
///
/// Trees copied without symbolic links hold each link as a small regular file with the relative
/// target as its one line of text. Below a --root such a file is followed like a link when the
/// target exists; as the last component of a path only if the text has a '/' or is "..", since
/// there a file that names a neighbour may be meant as it is.
class Root {
 public:
  /// `read_errors`: errno by path; reads of these files fail with it. For tests, since a plain
  /// file cannot be made to fail like a sensor. Throws std::runtime_error if `directory` is none.
  explicit Root(const std::string& directory = "/",
                const std::map<std::string, int>& read_errors = {});

  /// Whether this is the machine itself and not a copy or container below a directory.
  [[nodiscard]] bool is_host() const { return directory_.empty(); }
  /// The directory, free of links; empty for "/".
  [[nodiscard]] const std::string& directory() const { return directory_; }

  struct Resolved {
    std::string path;  ///< absolute on the host, free of links; meaningless on error
    int error = 0;     ///< errno
  };
  [[nodiscard]] Resolved resolve(std::string_view path) const;
  [[nodiscard]] bool exists(std::string_view path) const { return resolve(path).error == 0; }
  /// The last part of where a link points, be it there or not: copies of sysfs may lack what their
  /// links lead to. Empty if `path` is no link.
  [[nodiscard]] std::string link_name(std::string_view path) const;
  /// Names in a directory, one level, in natural order, hidden ones left out; empty if unreadable.
  [[nodiscard]] std::vector<std::string> list(std::string_view path) const;
  /// errno of listing the directory; 0: it can be listed.
  [[nodiscard]] int list_error(std::string_view path) const;

  struct Text {
    std::optional<std::string> text;  ///< at most 64 KiB
    int error = 0;                    ///< errno where there is no text
  };
  /// A whole small text file.
  [[nodiscard]] Text read(std::string_view path) const;
  /// The first line of a text file, trimmed; nullopt if unreadable or empty.
  [[nodiscard]] std::optional<std::string> read_line(std::string_view path) const;

  /// The errno that reads of a resolved path are to fail with; 0 = none.
  [[nodiscard]] int read_error(const std::string& resolved_path) const;
  /// The path as a person would write it: with the root in front.
  [[nodiscard]] std::string display(std::string_view path) const;

 private:
  using Components = std::vector<std::string>;
  int walk(Components& at, std::string_view path, int& budget) const;
  std::string host_path(const Components& components) const;

  std::string directory_;  ///< canonical; empty for "/"
  std::map<std::string, int> read_errors_;
};

/// strerror(), safe on any thread.
std::string errno_text(int error);

}  // namespace energyprof::probe
