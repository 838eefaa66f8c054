#include "app/commands.h"

#include <fmt/format.h>

#include <cstdio>
#include <cstdlib>
#include <filesystem>

#include "accel/models.h"
#include "analysis/analyze_frames.h"
#include "analysis/compare.h"
#include "analysis/write_reports.h"
#include "app/config.h"
#include "app/interrupt.h"
#include "app/results.h"
#include "app/study.h"
#include "app/usage_error.h"
#include "core/run_db.h"

namespace energyprof::app {
namespace {

namespace fs = std::filesystem;

fs::path dir_of(const fs::path& run) {
  if (fs::is_directory(run)) return run;
  return run.has_parent_path() ? run.parent_path() : fs::path(".");
}

/// Exit code of --fail-if-slower.
constexpr int exit_slower = 3;

bool validation_wanted() {
  const char* value = std::getenv("ENERGYPROF_VALIDATION");
  return value != nullptr && std::string_view(value) == "1";
}

}  // namespace

int run_command(const RunOptions& options) {
  Config config = load_config(options.config, options.settings);
  StudyOptions study;
  study.quick = options.quick;
  if (options.quick) study.quick_note = apply_quick(config);
  study.out = options.out.empty() ? default_run_dir(config.name) : fs::path(options.out);
  study.device = options.device;
  study.root = options.root;
  study.allow_msr = options.allow_msr;
  study.quiet = options.quiet;
  study.validation = validation_wanted();

  const InterruptGuard interrupts;
  const StudyResult result = record_study(config, study);
  write_all_reports(study.out, study.out / "run.sqlite", stdout);
  if (result.interrupted) return exit_interrupted;
  if (result.skipped_count == result.trial_count)
    throw std::runtime_error(fmt::format("no trial could be traced: {}", result.first_skip_reason));
  return 0;
}

int analyze_command(const std::string& run) {
  write_all_reports(dir_of(run), run_file(run), stdout);
  return 0;
}

int export_command(const ExportOptions& options) {
  const RunRecord run = read_run(options.run);
  const fs::path dir = dir_of(options.run);
  if (options.format == "timeline") {
    const fs::path file = options.out.empty() ? dir / "timeline.json" : fs::path(options.out);
    analysis::TimelineConfig config;
    config.full = options.full;
    const analysis::Analysis result = analysis::analyze_frames(run);
    analysis::export_timeline(run, file, config, &result);
    fmt::print("{}\n", file.string());
    return 0;
  }
  for (const fs::path& file :
       analysis::export_csv(run, options.out.empty() ? dir : fs::path(options.out)))
    fmt::print("{}\n", file.string());
  return 0;
}

int compare_command(const CompareOptions& options) {
  const analysis::Comparison comparison =
      analysis::compare(read_run(options.a), read_run(options.b));
  std::optional<analysis::SlowerVerdict> slower;
  if (options.fail_if_slower_percent)
    slower = analysis::slower_by(comparison, *options.fail_if_slower_percent);
  if (options.json) {
    nlohmann::json report = analysis::compare_json(comparison);
    report["fail_if_slower"] = nullptr;
    if (slower)
      report["fail_if_slower"] = {{"percent", *options.fail_if_slower_percent},
                                  {"slower", slower->slower},
                                  {"measure", slower->in_cycles ? "cycles" : "time"},
                                  {"text", slower->text}};
    using nlohmann::json;
    fmt::print("{}\n", report.dump(2, ' ', false, json::error_handler_t::replace));
  } else {
    fmt::print("{}", analysis::compare_text(comparison));
    if (slower) fmt::print("{}\n", slower->text);
  }
  return slower && slower->slower ? exit_slower : 0;
}

int list_models_command() {
  fmt::print("{:<8} {:>9}  {:<10} {}\n", "name", "triangles", "here", "what and from where");
  for (const accel::ModelInfo& model : accel::catalogue()) {
    const char* here = model.file_name.empty()      ? "generated"
                       : accel::is_available(model) ? "yes"
                                                    : "no";
    fmt::print("{:<8} {:>9}  {:<10} {}\n", model.name, model.triangle_count, here,
               model.description);
    fmt::print("{:<30} from {}\n{:<30} {}\n", "", model.source, "", model.license);
    if (!model.digest.empty()) fmt::print("{:<30} sha256 {}\n", "", model.digest);
  }
  fmt::print(
      "teapot:N is the teapot with N x N quads per patch; a path to .ply, .ply.gz or .obj "
      "works in every place of a name.\n");
  return 0;
}

int fetch_model_command(const std::string& name) {
  const accel::ModelInfo* model = accel::find_model(name);
  if (model == nullptr) {
    std::string names;
    for (const accel::ModelInfo& known : accel::catalogue())
      names += (names.empty() ? "" : ", ") + std::string(known.name);
    throw UsageError(fmt::format("models fetch: '{}' is not a model; expected {}", name, names));
  }
  accel::fetch_model(*model, [](std::string_view text) { fmt::print(stderr, "{}\n", text); });
  const fs::path file = accel::model_file(*model);
  if (file.empty())
    fmt::print("{} is generated; there is nothing to fetch\n", name);
  else
    fmt::print("{}\n", file.string());
  return 0;
}

}  // namespace energyprof::app
