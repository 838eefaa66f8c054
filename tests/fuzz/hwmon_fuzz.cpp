// Any text in the files of a hwmon chip, and one file of any name. The input is cut at zero bytes.
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "probe/hwmon.h"
#include "probe/root.h"
#include "probe/source.h"

using namespace energyprof::probe;

namespace {

constexpr std::string_view files[] = {
    "name",       "temp1_input",    "temp1_label",   "temp1_crit",  "temp2_input",  "temp2_label",
    "in1_label",  "in1_input",      "in1_enable",    "curr1_input", "power1_input", "power1_label",
    "power1_cap", "power1_average", "energy1_input", "freq1_input"};

void require(bool condition) {
  if (!condition) abort();
}

// A chip in a directory that goes away with the process.
class Machine {
 public:
  Machine() {
    const std::filesystem::path memory = "/dev/shm";
    std::string name =
        ((std::filesystem::is_directory(memory) ? memory : std::filesystem::temp_directory_path()) /
         "energyprof-fuzz-XXXXXX")
            .string();
    path_ = mkdtemp(name.data());
    chip_ = path_ / "sys/class/hwmon/hwmon0";
    std::filesystem::create_directories(chip_);
    root_ = std::make_unique<Root>(path_.string());
  }
  ~Machine() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  Machine(const Machine&) = delete;
  Machine& operator=(const Machine&) = delete;

  void write(std::string_view file, std::string_view text) const {
    std::ofstream(chip_ / file, std::ios::binary) << text;
  }
  void remove(std::string_view file) const {
    std::error_code ignored;
    std::filesystem::remove(chip_ / file, ignored);
  }
  [[nodiscard]] const Root& root() const { return *root_; }

 private:
  std::filesystem::path path_;
  std::filesystem::path chip_;
  std::unique_ptr<Root> root_;
};

bool is_file_name(std::string_view name) {
  return !name.empty() && name.size() < 100 && name.find('/') == std::string_view::npos &&
         name != "." && name != "..";
}

// Up to the next zero byte.
std::string_view take(std::string_view& input) {
  const size_t end = std::min(input.find('\0'), input.size());
  const std::string_view text = input.substr(0, end);
  input.remove_prefix(std::min(end + 1, input.size()));
  return text;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static const Machine machine;
  std::string_view input(reinterpret_cast<const char*>(data), size);
  const std::string_view extra = take(input);
  const std::string_view extra_text = take(input);
  for (const std::string_view file : files) {
    // A file is not there where the input has ended.
    if (input.empty())
      machine.remove(file);
    else
      machine.write(file, take(input));
  }
  if (is_file_name(extra)) machine.write(extra, extra_text);

  Discovery found;
  discover_hwmon(machine.root(), found);
  require(!found.sources.empty() || !found.missing.empty());
  std::set<std::string> names;
  std::vector<Reading> readings;
  for (const auto& source : found.sources) {
    require(!source->channels().empty() && source->period_ns() > 0);
    readings.resize(source->channels().size());
    source->poll(readings);
    for (const energyprof::Channel& channel : source->channels()) {
      require(names.insert(channel.name).second);
      require(channel.name.starts_with("hwmon.") &&
              channel.name.find_first_of(" \t\n\r") == std::string::npos);
    }
  }
  for (const Missing& missing : found.missing)
    require(missing.source == "hwmon" && !missing.reason.empty());
  if (is_file_name(extra)) machine.remove(extra);
  return 0;
}
