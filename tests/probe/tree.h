/// Small machines for tests: directories written from a table, and what their sources read.
#pragma once

#include <stdlib.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <initializer_list>
#include <map>
#include <ostream>
#include <string>
#include <string_view>
#include <thread>
#include <utility>
#include <vector>

#include "probe/discover.h"

namespace energyprof::probe {

inline void PrintTo(const Missing& missing, std::ostream* out) {
  *out << missing.source << ": " << missing.reason << " [" << missing.fix << "]";
}

/// A directory that is removed again.
class Tree {
 public:
  using Files = std::initializer_list<std::pair<std::string, std::string>>;

  Tree() {
    std::string name = (std::filesystem::temp_directory_path() / "energyprof-XXXXXX").string();
    path_ = mkdtemp(name.data());
    std::filesystem::permissions(path_, std::filesystem::perms(0755));
  }
  explicit Tree(Files files) : Tree() { write(files); }
  /// A copy of a machine in tests/data/sysfs.
  explicit Tree(std::string_view machine) : Tree() { overlay(machine, "."); }
  ~Tree() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  Tree(const Tree&) = delete;
  Tree& operator=(const Tree&) = delete;

  void write(Files files) const {
    for (const auto& [file, text] : files) {
      std::filesystem::create_directories((path_ / file).parent_path());
      std::ofstream(path_ / file) << text;
    }
  }
  void overlay(std::string_view machine, std::string_view step) const {
    std::filesystem::copy(machine_dir(machine) / step, path_,
                          std::filesystem::copy_options::recursive |
                              std::filesystem::copy_options::overwrite_existing);
  }
  void link(const std::string& file, const std::string& target) const {
    std::filesystem::create_directories((path_ / file).parent_path());
    std::filesystem::create_symlink(target, path_ / file);
  }
  /// Returns when readers of the file notice.
  void remove(const std::string& file) const {
    std::filesystem::remove_all(path_ / file);
    std::this_thread::sleep_for(std::chrono::milliseconds(55));
  }

  static std::filesystem::path machine_dir(std::string_view machine) {
    return std::filesystem::path(ENERGYPROF_TEST_DATA) / "sysfs" / machine;
  }

  [[nodiscard]] std::string path() const { return path_.string(); }
  [[nodiscard]] Root root(std::map<std::string, int> read_errors = {}) const {
    return Root(path(), std::move(read_errors));
  }

 private:
  std::filesystem::path path_;
};

/// Every channel's reading, by name.
inline std::map<std::string, Reading> poll_all(const Discovery& discovery) {
  std::map<std::string, Reading> readings;
  for (const auto& source : discovery.sources) {
    std::vector<Reading> out(source->channels().size());
    source->poll(out);
    for (size_t i = 0; i < out.size(); ++i) readings[source->channels()[i].name] = out[i];
  }
  return readings;
}

/// The channel called `name`; one with id 0 if there is none.
inline Channel channel_called(const Discovery& discovery, std::string_view name) {
  for (const auto& source : discovery.sources)
    for (const Channel& channel : source->channels())
      if (channel.name == name) return channel;
  return {};
}

inline std::vector<std::string> names_of(const Discovery& discovery) {
  std::vector<std::string> names;
  for (const auto& source : discovery.sources)
    for (const Channel& channel : source->channels()) names.push_back(channel.name);
  return names;
}

}  // namespace energyprof::probe
