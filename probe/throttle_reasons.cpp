#include "probe/throttle_reasons.h"

#include <fmt/format.h>

#include <utility>

#include "probe/names.h"

namespace energyprof::probe {
namespace {

std::vector<Channel> flag_channels(std::string_view prefix, const std::optional<TextFile>& status,
                                   const std::vector<ReasonFiles::Reason>& reasons) {
  std::vector<Channel> channels;
  if (status) channels.push_back(throttle_flag(prefix, "status", status->path()));
  for (const ReasonFiles::Reason& reason : reasons)
    channels.push_back(throttle_flag(prefix, reason.name, reason.file.path()));
  return channels;
}

}  // namespace

Channel throttle_flag(std::string_view prefix, std::string_view reason, std::string origin) {
  return make_channel(fmt::format("{}.throttle.{}", prefix, reason), Quantity::throttle,
                      Unit::count, Kind::flag, std::move(origin));
}

ReasonFiles::ReasonFiles(std::string source, std::string_view prefix,
                         std::optional<TextFile> status, std::vector<Reason> reasons,
                         SourceTraits traits)
    : SensorSource(std::move(source), throttle_period_ns, flag_channels(prefix, status, reasons),
                   std::move(traits)),
      status_(std::move(status)),
      reasons_(std::move(reasons)) {}

void ReasonFiles::poll(std::span<Reading> out) noexcept {
  size_t next = 0;
  Reading summary;
  if (status_) {
    summary = status_->read_int();
    out[next++] = summary;
  }
  const bool none = summary.status == PollStatus::ok && summary.value == 0;
  // A summary that went away takes nothing with it: the reasons are still there to be asked.
  for (Reason& reason : reasons_) out[next++] = none ? summary : reason.file.read_int();
}

bool add_reason_files(const Root& root, Discovery& discovery, std::string source,
                      std::string_view prefix, const std::string& directory,
                      std::string_view file_prefix, const std::string& status_file,
                      const std::string& gpu) {
  std::optional<TextFile> status;
  std::vector<ReasonFiles::Reason> reasons;
  bool found = false;
  for (const std::string& entry : root.list(directory)) {
    const bool is_status = entry == status_file;
    if (!is_status && !entry.starts_with(file_prefix)) continue;
    found = true;
    CheckedFile checked = check_int_file(root, fmt::format("{}/{}", directory, entry));
    if (!checked.problem.empty())
      discovery.missing.push_back({source, checked.problem, ""});
    else if (is_status)
      status.emplace(std::move(checked.file));
    else
      reasons.push_back({slug(entry.substr(file_prefix.size())), std::move(checked.file)});
  }
  if (status || !reasons.empty())
    discovery.sources.push_back(std::make_unique<ReasonFiles>(
        std::move(source), prefix, std::move(status), std::move(reasons),
        SourceTraits{.slow = true, .wakes_device = true, .gpu = gpu}));
  return found;
}

}  // namespace energyprof::probe
