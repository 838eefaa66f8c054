/// Child processes: argument vectors, never a shell.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace energyprof::accel {

struct ProcessResult {
  int exit_code = 0;   ///< 128 + n if signal n ended it
  std::string errors;  ///< what it wrote to stderr, the first 64 KiB
};

/// Runs `arguments[0]`, found on PATH, in `directory` and waits for its end. It reads nothing, and
/// what it writes to stdout is lost. Throws std::runtime_error if it cannot be started.
ProcessResult run_process(const std::vector<std::string>& arguments,
                          const std::filesystem::path& directory);

}  // namespace energyprof::accel
