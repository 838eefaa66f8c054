/// Reasons why a GPU runs slower than asked, as i915 and xe give them: one file each, with 0 or 1.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "probe/source.h"
#include "probe/text_file.h"

namespace energyprof::probe {

/// How often reasons are polled. They are the state at the moment of reading, nothing remembers
/// them: what is shorter can be missed.
inline constexpr int64_t throttle_period_ns = 20'000'000;

/// A channel "<prefix>.throttle.<reason>", 0 or 1.
Channel throttle_flag(std::string_view prefix, std::string_view reason, std::string origin);

/// Reads the summary file first and the reasons only while it says that there is one: each file is
/// a register read of its own. Without a summary file, all reasons. A summary of 1 with all reasons
/// 0 happens, since the reads are not made at the same moment.
class ReasonFiles final : public SensorSource {
 public:
  struct Reason {
    std::string name;
    TextFile file;
  };
  /// Channels: "<prefix>.throttle.status" if there is a summary, then one for each reason.
  ReasonFiles(std::string source, std::string_view prefix, std::optional<TextFile> status,
              std::vector<Reason> reasons, SourceTraits traits);
  void poll(std::span<Reading> out) noexcept override;

 private:
  std::optional<TextFile> status_;
  std::vector<Reason> reasons_;
};

/// Adds a ReasonFiles of every "<file_prefix><reason>" in `directory` to `discovery`; the one
/// called "status" is the summary. Files that cannot be read become Missing. Returns whether there
/// was any.
bool add_reason_files(const Root& root, Discovery& discovery, std::string source,
                      std::string_view prefix, const std::string& directory,
                      std::string_view file_prefix, const std::string& status_file,
                      const std::string& gpu);

}  // namespace energyprof::probe
