// energyprof: command line, and the one place where errors become exit codes.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <exception>
#include <functional>
#include <new>
#include <string_view>

#include "app/child.h"
#include "app/commands.h"
#include "app/record.h"
#include "app/usage_error.h"

namespace energyprof::app {
namespace {

constexpr int exit_failed = 1;
constexpr int exit_usage = 2;

/// Errors are one line, whatever a library put into them.
int fail(const std::string& text, int code) {
  std::string line = text;
  for (char& c : line)
    if (c == '\n' || c == '\r') c = ' ';
  while (!line.empty() && line.back() == ' ') line.pop_back();
  fmt::print(stderr, "energyprof: {}\n", line);
  return code;
}

/// All commands and their options. Each sets `action` when it is the one that was asked for.
class CommandLine {
 public:
  CommandLine() {
    cli_.set_version_flag("--version", "energyprof " ENERGYPROF_VERSION, "Print the version");
    cli_.set_help_flag("-h,--help", "Print this help");
    add_run();
    add_probe();
    add_record();
    add_analyze();
    add_export();
    add_compare();
    add_models();
    cli_.require_subcommand(0, 1);
  }

  int run(int argc, char** argv) {
    // What follows "--" belongs to the recorded program and is taken word by word.
    if (argc > 1 && argv[1] == std::string_view("record")) {
      char** const end = argv + argc;
      char** const mark = std::find(argv, end, std::string_view("--"));
      if (mark != end) record_.command.assign(mark + 1, end);
      argc = static_cast<int>(mark - argv);
    }
    try {
      cli_.parse(argc, argv);
    } catch (const CLI::Success& wanted) {  // --help, --version
      return cli_.exit(wanted);
    } catch (const CLI::ParseError& error) {
      return fail(fmt::format("{}. See energyprof --help.", trimmed(error.what())), exit_usage);
    }
    if (!action_) {
      if (run_.config.empty())
        return fail("nothing to do: give --config FILE or a command. See energyprof --help.",
                    exit_usage);
      action_ = [this] { return run_command(run_); };
    }
    return action_();
  }

 private:
  static std::string trimmed(std::string text) {
    while (!text.empty() && (text.back() == '\n' || text.back() == '.' || text.back() == ' '))
      text.pop_back();
    return text;
  }

  void add_run() {
    cli_.footer(
        "Example: energyprof --config configs/dragon.json --quick\n"
        "  runs the study in about a minute and leaves run.sqlite, timeline.json, report.html,\n"
        "  report.json, report.md and images/ in runs/dragon-<time>.");
    cli_.add_option("--config", run_.config,
                    "The experiment: a JSON file, or the name of a shipped one")
        ->type_name("FILE");
    cli_.add_option("--out", run_.out, "Run directory; must not hold a run yet")->type_name("DIR");
    cli_.add_option("--set", run_.settings, "Change the config: --set image.width=640")
        ->type_name("KEY.PATH=VALUE")
        ->take_all()
        ->allow_extra_args(false);
    cli_.add_flag("--quick", run_.quick, "Cap the work to about a minute; every output says so");
    cli_.add_option("--device", run_.device, "Vulkan device: auto, or part of its name")
        ->type_name("NAME");
    cli_.add_option("--root", run_.root, "Read sensors below DIR instead of / (marked simulated)")
        ->type_name("DIR");
    cli_.add_flag("--allow-msr", run_.allow_msr, "Read /dev/cpu/*/msr, too");
    cli_.add_flag("--quiet", run_.quiet, "No progress on stderr");
  }

  void add_probe() {
    CLI::App* command =
        cli_.add_subcommand("probe", "What can be sensed here, what cannot, and why");
    command->footer("Example: energyprof probe --json");
    command->add_option("--root", probe_.root, "Read sensors below DIR instead of /")
        ->type_name("DIR");
    command->add_flag("--allow-msr", probe_.allow_msr, "Read /dev/cpu/*/msr, too");
    command->add_flag("--all", probe_.all, "Every core and CPU on a line of its own");
    command->add_flag("--json", probe_.json, "All of it as JSON");
    command->callback([this] { action_ = [this] { return probe_command(probe_); }; });
  }

  void add_record() {
    CLI::App* command =
        cli_.add_subcommand("record", "The sensors while any other program runs: record -- CMD");
    command->footer(
        "Example: energyprof record --out runs/vkcube -- vkcube --c 600\n"
        "  leaves run.sqlite, timeline.json and the reports, without frames, and the exit code of\n"
        "  the program.");
    command->add_option("--out", record_.out, "Run directory; must not hold a run yet")
        ->type_name("DIR");
    command->add_option("--rate", record_.rate_hz, "Sensor ticks per second, 1 to 10000")
        ->type_name("HZ")
        ->check(CLI::Range(1.0, 10'000.0));
    command
        ->add_option("--root", record_.root,
                     "Read sensors below DIR instead of / (marked simulated)")
        ->type_name("DIR");
    command->add_flag("--allow-msr", record_.allow_msr, "Read /dev/cpu/*/msr, too");
    command->add_flag("--quiet", record_.quiet, "Say nothing when the program has ended");
    command->callback([this] {
      if (record_.command.empty())
        throw UsageError("record: no program is given; expected -- CMD [ARGS] at the end");
      action_ = [this] { return record_command(record_); };
    });
  }

  void add_analyze() {
    CLI::App* command = cli_.add_subcommand("analyze", "The reports again, from a recorded run");
    command->footer("Example: energyprof analyze runs/dragon-20260131-120000");
    add_run_argument(command, analyze_run_);
    command->callback([this] { action_ = [this] { return analyze_command(analyze_run_); }; });
  }

  void add_export() {
    CLI::App* command = cli_.add_subcommand("export", "A recorded run in another format");
    command->footer("Example: energyprof export runs/dragon-20260131-120000 --format csv");
    add_run_argument(command, export_.run);
    command->add_option("--format", export_.format, "timeline (Chrome Trace Event JSON) or csv")
        ->required()
        ->check(CLI::IsMember({"timeline", "csv"}));
    command
        ->add_option("--out", export_.out,
                     "timeline: the file; csv: the folder. Default: the run directory")
        ->type_name("PATH");
    command->add_flag("--full", export_.full, "timeline: every sample, not thinned");
    command->callback([this] { action_ = [this] { return export_command(export_); }; });
  }

  void add_compare() {
    CLI::App* command =
        cli_.add_subcommand("compare", "Two runs: is B slower, and is it the code?");
    command->footer(
        "Example: energyprof compare runs/before runs/after --fail-if-slower 2\n"
        "  exits 3 if any cell, or all on average, takes more than 2 % more GPU cycles beyond "
        "doubt.");
    command->add_option("RUN_A", compare_.a, "A run directory, or the run.sqlite inside it")
        ->required();
    command->add_option("RUN_B", compare_.b, "What is compared with it")->required();
    command->add_flag("--json", compare_.json, "The same as JSON");
    command
        ->add_option("--fail-if-slower", compare_.fail_if_slower_percent,
                     "Exit 3 if B is slower by more than this, beyond doubt")
        ->type_name("PCT")
        ->check(CLI::Range(0.0, 10'000.0));
    command->callback([this] { action_ = [this] { return compare_command(compare_); }; });
  }

  void add_models() {
    CLI::App* command = cli_.add_subcommand("models", "The models that have a name");
    command->footer("Example: energyprof models fetch dragon");
    command->callback([this] {
      if (!action_) action_ = [] { return list_models_command(); };
    });
    CLI::App* fetch = command->add_subcommand("fetch", "Get a model into the cache");
    fetch->footer("Example: energyprof models fetch dragon");
    fetch->add_option("NAME", model_, "As listed by energyprof models")->required();
    fetch->callback([this] { action_ = [this] { return fetch_model_command(model_); }; });
  }

  static void add_run_argument(CLI::App* command, std::string& run) {
    command->add_option("RUN", run, "A run directory, or the run.sqlite inside it")->required();
  }

  CLI::App cli_{
      "energyprof: where does the energy of a GPU workload go, and why did that frame "
      "stutter?",
      "energyprof"};
  RunOptions run_;
  ProbeOptions probe_;
  RecordOptions record_;
  std::string analyze_run_;
  ExportOptions export_;
  CompareOptions compare_;
  std::string model_;
  std::function<int()> action_;
};

}  // namespace
}  // namespace energyprof::app

int main(int argc, char** argv) {
  using namespace energyprof::app;
  try {
    return CommandLine().run(argc, argv);
  } catch (const UsageError& error) {
    return fail(error.what(), exit_usage);
  } catch (const CannotRun& error) {
    return fail(error.what(), error.exit_code);
  } catch (const std::bad_alloc&) {
    return fail("cannot go on: the machine is out of memory. Try a smaller model or image.",
                exit_failed);
  } catch (const std::exception& error) {
    return fail(error.what(), exit_failed);
  }
}
