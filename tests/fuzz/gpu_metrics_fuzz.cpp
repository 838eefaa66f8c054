// Any bytes as gpu_metrics: what is read lies inside them and is plausible, or nothing is read.
#include <cstdint>
#include <cstdlib>
#include <cstring>

#include "probe/gpu_metrics.h"

using namespace energyprof;
using namespace energyprof::probe;

namespace {

void require(bool condition) {
  if (!condition) abort();
}

bool is_plausible(const MetricsField& field, int64_t value) {
  if (value < 0) return false;
  if (field.kind == Kind::flag) return value == 0 || value == 1;
  if (field.unit == Unit::percent) return value <= 100;
  if (field.unit == Unit::centipercent) return value <= 10'000;
  return true;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  uint32_t pci_device = 0;
  if (size < sizeof pci_device) return 0;
  memcpy(&pci_device, data, sizeof pci_device);
  const std::span<const char> table(reinterpret_cast<const char*>(data) + sizeof pci_device,
                                    size - sizeof pci_device);
  const bool is_usable = metrics_problem(table).empty();
  const auto revision = metrics_revision(table);
  require(revision.has_value() == (table.size() >= 4));
  if (!revision) return 0;
  require(is_usable == is_complete(table, *revision));
  const std::vector<MetricsField> fields = metrics_fields(*revision, pci_device);
  require(!is_usable || !fields.empty());
  for (MetricsField field : fields) {
    require(!is_usable || field.offset + field.width <= table.size());
    const auto value = field.value(table);
    if (!value) continue;
    require(is_plausible(field, *value));
    // As discovery does.
    if (field.name == "activity") field.unit = activity_unit(*revision, *value, pci_device);
    if (field.name == "socket_power") field.unit = socket_power_unit(*value, pci_device);
    if (const auto settled = field.value(table)) require(is_plausible(field, *settled));
  }
  return 0;
}
