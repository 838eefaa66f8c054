// Any text in the files of two powercap zones. The input is cut at zero bytes.
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <string_view>
#include <vector>

#include "probe/powercap.h"
#include "probe/root.h"
#include "probe/source.h"

using namespace energyprof;
using namespace energyprof::probe;

namespace {

constexpr std::string_view files[] = {
    "intel-rapl:0/name",
    "intel-rapl:0/energy_uj",
    "intel-rapl:0/max_energy_range_uj",
    "intel-rapl:0/enabled",
    "intel-rapl:0/constraint_0_name",
    "intel-rapl:0/constraint_0_power_limit_uw",
    "intel-rapl-mmio:0/name",
    "intel-rapl-mmio:0/energy_uj",
    "intel-rapl-mmio:0/constraint_0_name",
    "intel-rapl-mmio:0/constraint_0_power_limit_uw",
    "intel-rapl:0:0/name",
    "intel-rapl:0:0/energy_uj",
};

// A machine in a directory that goes away with the process.
class Machine {
 public:
  Machine() {
    const std::filesystem::path memory = "/dev/shm";
    std::string name =
        ((std::filesystem::is_directory(memory) ? memory : std::filesystem::temp_directory_path()) /
         "energyprof-fuzz-XXXXXX")
            .string();
    path_ = mkdtemp(name.data());
    for (const std::string_view file : files)
      std::filesystem::create_directories((zones() / file).parent_path());
  }
  ~Machine() { std::filesystem::remove_all(path_); }
  [[nodiscard]] std::filesystem::path zones() const { return path_ / "sys/class/powercap"; }
  [[nodiscard]] std::string root() const { return path_.string(); }

 private:
  std::filesystem::path path_;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static const Machine machine;
  std::string_view text(reinterpret_cast<const char*>(data), size);
  for (const std::string_view file : files) {
    const size_t end = std::min(text.find('\0'), text.size());
    std::ofstream(machine.zones() / file) << text.substr(0, end);
    text.remove_prefix(std::min(end + 1, text.size()));
  }
  Discovery found;
  discover_powercap(Root(machine.root()), found);
  if (found.sources.empty() && found.missing.empty()) abort();
  for (const auto& source : found.sources) {
    std::vector<Reading> readings(source->channels().size());
    source->poll(readings);
    for (size_t i = 0; i < readings.size(); ++i) {
      const Channel& channel = source->channels()[i];
      if (channel.wrap_at && *channel.wrap_at <= 0) abort();
      // A limit of 0 is none.
      if (channel.quantity == Quantity::limit && readings[i].status == PollStatus::ok &&
          readings[i].value <= 0)
        abort();
    }
  }
  return 0;
}
