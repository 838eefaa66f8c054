#include "probe/file_source.h"

#include <cerrno>
#include <utility>

namespace energyprof::probe {
namespace {

std::vector<Channel> channels_of(const std::vector<FileChannel>& rows) {
  std::vector<Channel> channels;
  for (const FileChannel& row : rows) {
    channels.push_back(row.channel);
    channels.back().origin = row.file.path();
  }
  return channels;
}

}  // namespace

FileSource::FileSource(std::string name, int64_t period_ns, std::vector<FileChannel> rows,
                       SourceTraits traits)
    : SensorSource(std::move(name), period_ns, channels_of(rows), std::move(traits)) {
  files_.reserve(rows.size());
  for (FileChannel& row : rows) files_.push_back({std::move(row.file), row.is_value});
}

void FileSource::poll(std::span<Reading> out) noexcept {
  for (size_t i = 0; i < files_.size(); ++i) {
    out[i] = files_[i].file.read_int();
    if (out[i].status == PollStatus::ok && files_[i].is_value != nullptr &&
        !files_[i].is_value(out[i].value))
      out[i].status = PollStatus::retry;
  }
}

void add_file_row(const Root& root, Discovery& discovery, std::string source,
                  std::vector<FileChannel>& rows, Channel channel, std::string_view path) {
  CheckedFile checked = check_int_file(root, path);
  if (checked.problem.empty())
    rows.push_back({std::move(channel), std::move(checked.file)});
  else if (checked.error != ENOENT)
    discovery.missing.push_back({std::move(source), std::move(checked.problem), ""});
}

void add_file_source(Discovery& discovery, std::string name, int64_t period_ns,
                     std::vector<FileChannel> rows, SourceTraits traits) {
  if (rows.empty()) return;
  discovery.sources.push_back(
      std::make_unique<FileSource>(std::move(name), period_ns, std::move(rows), std::move(traits)));
}

}  // namespace energyprof::probe
