/// A source whose channels are one file with one integer each.
#pragma once

#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "probe/source.h"
#include "probe/text_file.h"

namespace energyprof::probe {

/// Temperatures beyond these are of inputs where nothing is connected, or of zones that are not
/// set; limits beyond them, as drives give 65261 C, are none.
inline constexpr int64_t lowest_temp_mc = -40'000;
inline constexpr int64_t highest_temp_mc = 200'000;

/// What can be a value of a channel: no clock and no counter is negative, no share above 1, no
/// flag above 1.
struct Plausible {
  int64_t lowest = std::numeric_limits<int64_t>::min();
  int64_t highest = std::numeric_limits<int64_t>::max();
  bool is_temp_mc = false;

  [[nodiscard]] constexpr bool has(int64_t value) const {
    if (value < lowest || value > highest) return false;
    // Zones that are not set and inputs where nothing is connected say exactly 0 C, or the most
    // that eight bits hold.
    return !is_temp_mc || (value != 0 && value != 127'000 && value != 127'500);
  }
};
Plausible plausible_values(const Channel& channel);

/// A channel and the file its value comes from.
struct FileChannel {
  Channel channel;
  TextFile file;
};

class FileSource final : public SensorSource {
 public:
  FileSource(std::string name, int64_t period_ns, std::vector<FileChannel> rows,
             SourceTraits traits = {});
  void poll(std::span<Reading> out) noexcept override;

 private:
  struct File {
    TextFile file;
    Plausible plausible;
  };
  std::vector<File> files_;
};

/// Adds the file as a row, or says in `discovery` why `source` cannot use it. An absent file is no
/// news.
void add_file_row(const Root& root, Discovery& discovery, std::string source,
                  std::vector<FileChannel>& rows, Channel channel, std::string_view path);

/// Adds a FileSource of these rows to `discovery`; nothing for no rows. A row whose file holds what
/// cannot be a value of it becomes a Missing.
void add_file_source(Discovery& discovery, std::string name, int64_t period_ns,
                     std::vector<FileChannel> rows, SourceTraits traits = {});

}  // namespace energyprof::probe
