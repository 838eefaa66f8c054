/// The study: every planned trial traced on the device while the sampler runs, all of it recorded.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "app/config.h"

namespace energyprof::app {

struct StudyOptions {
  std::filesystem::path out;    ///< the run directory; must not hold a run yet
  std::string device = "auto";  ///< "auto" or part of a device's name
  std::string root = "/";       ///< where sysfs and procfs are read; not "/": simulated
  bool allow_msr = false;       ///< read /dev/cpu/*/msr
  std::string quick_note;       ///< what --quick changed; empty: a full run
  bool quick = false;
  bool quiet = false;
  bool validation = false;  ///< Vulkan validation; any message fails the study
};

struct StudyResult {
  bool interrupted = false;
  int64_t trial_count = 0;
  int64_t skipped_count = 0;
  std::string first_skip_reason;
};

/// Records `config` into options.out/run.sqlite and writes options.out/images/. Throws
/// std::runtime_error when the study cannot begin, or cannot be recorded any more; what was
/// recorded until then is kept.
StudyResult record_study(const Config& config, const StudyOptions& options);

/// Creates `dir` for a run. Throws std::runtime_error if it cannot be written or already holds one.
void create_run_dir(const std::filesystem::path& dir);

}  // namespace energyprof::app
