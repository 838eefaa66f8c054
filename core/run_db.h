/// run.sqlite: the one file everything recorded goes into (layout: docs/run-format.md).
///
/// The database is in WAL mode while recording and every quarter of a second is one transaction, so
/// that a process killed at any moment leaves a database that opens and lacks at most that much.
#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "core/record.h"

namespace energyprof {

inline constexpr int schema_version = 1;
/// PRAGMA application_id of a run: "EPrf".
inline constexpr int32_t run_application_id = 0x45507266;

/// Records a run. Every call only appends to memory; one thread of its own writes.
///
/// All calls are safe from any thread. When the database cannot be written any more (disk full),
/// failure() says why, later calls are ignored, and what was committed stays readable.
class RunWriter {
 public:
  struct Config {
    int64_t commit_period_ns = 250'000'000;
    /// SQLite's max_page_count; 0 = no limit. Tests use it to fill the "disk".
    int64_t max_page_count = 0;
    /// Called on the writer's thread before each commit: samples to be recorded are appended.
    std::function<void(std::vector<Sample>&)> pull_samples;
  };

  /// Creates `file`, which must not exist. Throws std::runtime_error.
  explicit RunWriter(const std::filesystem::path& file) : RunWriter(file, Config{}) {}
  RunWriter(const std::filesystem::path& file, Config config);
  /// Writes what is left. Errors are lost here; call close() to hear of them.
  ~RunWriter();
  RunWriter(const RunWriter&) = delete;
  RunWriter& operator=(const RunWriter&) = delete;

  void set_meta(std::string key, std::string value);
  void add_channel(Channel channel);
  void add_samples(std::span<const Sample> samples);
  /// Inserts the trial, or replaces the one of the same id.
  void put_trial(Trial trial);
  void add_frame(FrameRecord frame);
  void add_self_check_frame(const SelfCheckFrame& frame);
  void add_event(Event event);

  /// Blocks until everything added before is committed (or the writer has failed).
  void flush();
  /// Why nothing can be recorded any more; empty while all is well.
  [[nodiscard]] std::string failure() const;
  /// Commits the rest, ends WAL mode so that one file remains, and closes.
  /// Throws std::runtime_error if anything could not be written.
  void close();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// The database of `run`: a run directory, or the database file itself.
std::filesystem::path run_file(const std::filesystem::path& run);

/// Reads a run back. Any database with the tables and columns of docs/run-format.md will do;
/// columns it does not have are taken as unknown. Throws std::runtime_error naming file and reason.
RunRecord read_run(const std::filesystem::path& run);

}  // namespace energyprof
