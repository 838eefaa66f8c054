/// A source whose channels are one file with one integer each.
#pragma once

#include <string>
#include <vector>

#include "probe/source.h"
#include "probe/text_file.h"

namespace energyprof::probe {

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
  std::vector<TextFile> files_;
};

/// Which of several files' values is a channel's.
enum class Pick : uint8_t {
  lowest_positive,  ///< of limits, where 0 is one that was never set
  highest,          ///< of counters that mirror each other
};

/// A source whose channels each come from several files that say the same thing in different
/// places. A file that went away counts no more; the channel is gone with the last of them.
class FileGroupSource final : public SensorSource {
 public:
  using FileGroups = std::vector<std::vector<TextFile>>;
  FileGroupSource(std::string name, int64_t period_ns, std::vector<Channel> channels,
                  FileGroups groups, Pick pick, SourceTraits traits = {});
  void poll(std::span<Reading> out) noexcept override;

 private:
  FileGroups groups_;
  Pick pick_;
};

/// Adds the file as a row, or says in `discovery` why `source` cannot use it. An absent file is no
/// news.
void add_file_row(const Root& root, Discovery& discovery, std::string source,
                  std::vector<FileChannel>& rows, Channel channel, std::string_view path);

/// Adds a FileSource of these rows to `discovery`; nothing for no rows.
void add_file_source(Discovery& discovery, std::string name, int64_t period_ns,
                     std::vector<FileChannel> rows, SourceTraits traits = {});

}  // namespace energyprof::probe
