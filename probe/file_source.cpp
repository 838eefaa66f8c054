#include "probe/file_source.h"

#include <fmt/format.h>

#include <cerrno>
#include <cmath>
#include <map>
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

std::string why_implausible(const FileChannel& row, int64_t value) {
  const UnitInfo& unit = unit_info(row.channel.unit);
  if (unit.si == "C")
    return fmt::format("'{}' reads {} C: it is not measuring", row.file.path(),
                       static_cast<double>(value) * unit.to_si);
  return fmt::format("'{}' reads {} {}, which cannot be", row.file.path(), value, unit.name);
}

}  // namespace

Plausible plausible_values(const Channel& channel) {
  constexpr double highest_hz = 1e11;
  constexpr double highest_w = 1e6;
  const UnitInfo& unit = unit_info(channel.unit);
  const auto in_unit = [&](double si) { return std::llround(si / unit.to_si); };
  Plausible plausible;
  if (channel.quantity == Quantity::temperature)
    return {in_unit(lowest_temp_mc * 1e-3), in_unit(highest_temp_mc * 1e-3),
            channel.unit == Unit::millicelsius};
  if (channel.kind == Kind::cumulative || channel.quantity == Quantity::limit) plausible.lowest = 0;
  if (unit.si == "Hz") plausible = {0, in_unit(highest_hz)};
  if (unit.si == "W" && channel.quantity == Quantity::power)
    plausible = {-in_unit(highest_w), in_unit(highest_w)};
  if (unit.si == "1" && unit.to_si < 1) plausible = {0, in_unit(1)};
  if (channel.kind == Kind::flag) plausible = {0, 1};
  return plausible;
}

FileSource::FileSource(std::string name, int64_t period_ns, std::vector<FileChannel> rows,
                       SourceTraits traits)
    : SensorSource(std::move(name), period_ns, channels_of(rows), std::move(traits)) {
  files_.reserve(rows.size());
  for (FileChannel& row : rows)
    files_.push_back({std::move(row.file), plausible_values(row.channel)});
}

void FileSource::poll(std::span<Reading> out) noexcept {
  for (size_t i = 0; i < files_.size(); ++i) {
    out[i] = files_[i].file.read_int();
    if (out[i].status == PollStatus::ok && !files_[i].plausible.has(out[i].value))
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
  std::vector<FileChannel> usable;
  struct Refused {
    std::string reason;  // of the first one
    int more = 0;
  };
  std::map<std::pair<Unit, int64_t>, Refused> refused;  // chips repeat the same for all of a kind
  for (FileChannel& row : rows) {
    const Reading first = row.file.read_int();
    if (first.status != PollStatus::ok || plausible_values(row.channel).has(first.value)) {
      usable.push_back(std::move(row));
      continue;
    }
    Refused& same = refused[{row.channel.unit, first.value}];
    if (same.reason.empty())
      same.reason = why_implausible(row, first.value);
    else
      ++same.more;
  }
  for (auto& [value, same] : refused) {
    if (same.more > 0) same.reason += fmt::format(", and {} more like it", same.more);
    discovery.missing.push_back({name, std::move(same.reason), ""});
  }
  if (usable.empty()) return;
  discovery.sources.push_back(std::make_unique<FileSource>(std::move(name), period_ns,
                                                           std::move(usable), std::move(traits)));
}

}  // namespace energyprof::probe
