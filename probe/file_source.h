/// A source whose channels are one file with one integer each.
#pragma once

#include <string>
#include <vector>

#include "probe/source.h"
#include "probe/text_file.h"

namespace energyprof::probe {

/// Temperatures beyond these are of inputs where nothing is connected, or of zones that are not
/// set; limits beyond them, as drives give 65261 C, are none.
inline constexpr int64_t lowest_temp_mc = -40'000;
inline constexpr int64_t highest_temp_mc = 200'000;
constexpr bool is_plausible_temp(int64_t temp_mc) {
  return temp_mc >= lowest_temp_mc && temp_mc <= highest_temp_mc;
}

/// A channel and the file its value comes from.
struct FileChannel {
  Channel channel;
  TextFile file;
  bool (*is_value)(int64_t) = nullptr;  ///< whether a number is a sample; null: all are
};

class FileSource final : public SensorSource {
 public:
  FileSource(std::string name, int64_t period_ns, std::vector<FileChannel> rows,
             SourceTraits traits = {});
  void poll(std::span<Reading> out) noexcept override;

 private:
  struct File {
    TextFile file;
    bool (*is_value)(int64_t);
  };
  std::vector<File> files_;
};

/// Adds the file as a row, or says in `discovery` why `source` cannot use it. An absent file is no
/// news.
void add_file_row(const Root& root, Discovery& discovery, std::string source,
                  std::vector<FileChannel>& rows, Channel channel, std::string_view path);

/// Adds a FileSource of these rows to `discovery`; nothing for no rows.
void add_file_source(Discovery& discovery, std::string name, int64_t period_ns,
                     std::vector<FileChannel> rows, SourceTraits traits = {});

}  // namespace energyprof::probe
