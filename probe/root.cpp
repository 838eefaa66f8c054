#include "probe/root.h"

#include <dirent.h>
#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <climits>
#include <cstdlib>
#include <memory>
#include <stdexcept>
#include <system_error>

#include "probe/names.h"

namespace energyprof::probe {
namespace {

constexpr int max_links = 40;  // in one path, as in the kernel
constexpr size_t max_text_bytes = size_t{64} << 10;

std::vector<std::string_view> split_path(std::string_view path) {
  std::vector<std::string_view> parts;
  while (!path.empty()) {
    const size_t end = std::min(path.find('/'), path.size());
    if (end > 0 && path.substr(0, end) != ".") parts.push_back(path.substr(0, end));
    path.remove_prefix(std::min(end + 1, path.size()));
  }
  return parts;
}

Root::Text read_whole(const std::string& host_path) {
  // O_NONBLOCK: a pipe below a --root would be waited for.
  const int fd = open(host_path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (fd < 0) return {std::nullopt, errno};
  std::string text;
  std::array<char, 4096> chunk{};
  int error = 0;
  while (text.size() < max_text_bytes) {
    const ssize_t got = ::read(fd, chunk.data(), chunk.size());
    if (got < 0) error = errno;
    if (got <= 0) break;
    text.append(chunk.data(), static_cast<size_t>(got));
  }
  close(fd);
  if (error != 0) return {std::nullopt, error};
  return {std::move(text), 0};
}

std::optional<std::string> link_target(const std::string& host_path) {
  std::array<char, PATH_MAX> target{};
  const ssize_t size = readlink(host_path.c_str(), target.data(), target.size());
  if (size <= 0) return std::nullopt;
  return std::string(target.data(), static_cast<size_t>(size));
}

// The text of a regular file that may stand for a link: one line, a relative path.
std::optional<std::string> link_text(const std::string& host_path, off_t byte_count, bool last) {
  if (byte_count < 1 || byte_count >= PATH_MAX) return std::nullopt;
  std::optional<std::string> text = read_whole(host_path).text;
  if (!text) return std::nullopt;
  if (text->ends_with('\n')) text->pop_back();
  if (text->empty() || text->front() == '/') return std::nullopt;
  if (text->find_first_of(std::string_view("\n\0", 2)) != std::string::npos) return std::nullopt;
  if (last && *text != ".." && text->find('/') == std::string::npos) return std::nullopt;
  return text;
}

}  // namespace

std::string errno_text(int error) { return std::generic_category().message(error); }

Root::Root(const std::string& directory, const std::map<std::string, int>& read_errors) {
  const std::unique_ptr<char, decltype(&std::free)> canonical(realpath(directory.c_str(), nullptr),
                                                              &std::free);
  struct stat info {};
  int error = canonical ? 0 : errno;
  if (canonical && stat(canonical.get(), &info) != 0) error = errno;
  if (error == 0 && !S_ISDIR(info.st_mode)) error = ENOTDIR;
  if (error != 0)
    throw std::runtime_error(
        fmt::format("cannot use '{}' as root: {}. Pass a directory that holds sys/, proc/ or dev/.",
                    directory, errno_text(error)));
  directory_ = canonical.get();
  if (directory_ == "/") directory_.clear();
  for (const auto& [path, read_errno] : read_errors)
    read_errors_.emplace(resolve(path).path, read_errno);
}

std::string Root::host_path(const Components& components) const {
  std::string path = directory_;
  for (const std::string& component : components) path += '/' + component;
  return path.empty() ? "/" : path;
}

// Follows `path` from the directory `at`, which becomes where it leads. Returns errno.
int Root::walk(Components& at, std::string_view path, int& budget) const {
  if (path.starts_with('/')) at.clear();
  const std::vector<std::string_view> parts = split_path(path);
  for (size_t i = 0; i < parts.size(); ++i) {
    if (parts[i] == "..") {
      if (!at.empty()) at.pop_back();
      continue;
    }
    const bool last = i + 1 == parts.size();
    Components target_at = at;
    at.emplace_back(parts[i]);
    const std::string here = host_path(at);
    struct stat info {};
    if (lstat(here.c_str(), &info) != 0) return errno;
    std::optional<std::string> target;
    if (S_ISLNK(info.st_mode)) {
      target = link_target(here);
      if (!target) return ENOENT;
    } else if (!is_host() && S_ISREG(info.st_mode)) {
      target = link_text(here, info.st_size, last);
    }
    if (target) {
      const int error = budget-- > 0 ? walk(target_at, *target, budget) : ELOOP;
      if (error == 0)
        at = std::move(target_at);
      else if (S_ISLNK(info.st_mode))
        return error;
      else if (!last)
        return ENOTDIR;
    } else if (!last && !S_ISDIR(info.st_mode)) {
      return ENOTDIR;
    }
  }
  return 0;
}

Root::Resolved Root::resolve(std::string_view path) const {
  Components at;
  int budget = max_links;
  const int error = walk(at, path, budget);
  return {host_path(at), error};
}

std::string Root::link_name(std::string_view path) const {
  const size_t slash = path.rfind('/');
  const Resolved parent = resolve(path.substr(0, slash == std::string_view::npos ? 0 : slash));
  if (parent.error != 0) return {};
  const std::string here = fmt::format("{}/{}", parent.path, path.substr(slash + 1));
  struct stat info {};
  if (lstat(here.c_str(), &info) != 0) return {};
  std::optional<std::string> target;
  if (S_ISLNK(info.st_mode))
    target = link_target(here);
  else if (!is_host() && S_ISREG(info.st_mode))
    target = link_text(here, info.st_size, true);
  return target ? target->substr(target->rfind('/') + 1) : "";
}

std::vector<std::string> Root::list(std::string_view path) const {
  std::vector<std::string> names;
  const Resolved resolved = resolve(path);
  if (resolved.error != 0) return names;
  const std::unique_ptr<DIR, int (*)(DIR*)> directory(opendir(resolved.path.c_str()), &closedir);
  if (!directory) return names;
  while (const dirent* entry = readdir(directory.get()))
    if (entry->d_name[0] != '.') names.emplace_back(entry->d_name);
  std::sort(names.begin(), names.end(), natural_less);
  return names;
}

int Root::list_error(std::string_view path) const {
  const Resolved resolved = resolve(path);
  if (resolved.error != 0) return resolved.error;
  const std::unique_ptr<DIR, int (*)(DIR*)> directory(opendir(resolved.path.c_str()), &closedir);
  return directory ? 0 : errno;
}

Root::Text Root::read(std::string_view path) const {
  const Resolved resolved = resolve(path);
  if (resolved.error != 0) return {std::nullopt, resolved.error};
  if (const int error = read_error(resolved.path)) return {std::nullopt, error};
  return read_whole(resolved.path);
}

std::optional<std::string> Root::read_line(std::string_view path) const {
  std::optional<std::string> text = read(path).text;
  if (!text) return std::nullopt;
  text->resize(std::min(text->find('\n'), text->size()));
  const size_t begin = text->find_first_not_of(" \t");
  if (begin == std::string::npos) return std::nullopt;
  return text->substr(begin, text->find_last_not_of(" \t\r") - begin + 1);
}

int Root::read_error(const std::string& resolved_path) const {
  const auto found = read_errors_.find(resolved_path);
  return found == read_errors_.end() ? 0 : found->second;
}

std::string Root::display(std::string_view path) const {
  return fmt::format("{}/{}", directory_, path);
}

}  // namespace energyprof::probe
