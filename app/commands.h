/// The program's commands: each takes its options and returns the exit code.
#pragma once

#include <optional>
#include <string>
#include <vector>

namespace energyprof::app {

struct RunOptions {
  std::string config;
  std::string out;  ///< empty: runs/<name>-<time>
  std::vector<std::string> settings;
  std::string device = "auto";
  std::string root = "/";
  bool allow_msr = false;
  bool quick = false;
  bool quiet = false;
};

struct ProbeOptions {
  std::string root = "/";
  bool allow_msr = false;
  bool all = false;  ///< every channel on a line of its own
  bool json = false;
};

struct ExportOptions {
  std::string run;
  std::string format;
  std::string out;  ///< empty: in the run directory
  bool full = false;
};

struct CompareOptions {
  std::string a;
  std::string b;
  bool json = false;
  std::optional<double> fail_if_slower_percent;
};

/// `energyprof --config`: the study, its analysis, its reports.
int run_command(const RunOptions& options);
/// `energyprof probe`
int probe_command(const ProbeOptions& options);
/// `energyprof analyze`
int analyze_command(const std::string& run);
/// `energyprof export`
int export_command(const ExportOptions& options);
/// `energyprof compare`
int compare_command(const CompareOptions& options);
/// `energyprof models`
int list_models_command();
/// `energyprof models fetch`
int fetch_model_command(const std::string& name);

}  // namespace energyprof::app
