// Expects one of:
//
//   sys/devices/system/cpu/cpufreq/policy0/scaling_cur_freq     600000
//   sys/devices/system/cpu/cpu0/cpufreq/scaling_cur_freq        the same, seen from each CPU
//
// and beside it scaling_max_freq, which the kernel lowers to cool, and cpuinfo_max_freq.
#include "probe/cpufreq.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "core/clock.h"
#include "probe/file_source.h"

namespace energyprof::probe {
namespace {

constexpr std::string_view cpu_dir = "sys/devices/system/cpu";
constexpr int64_t base_period_ns = 10 * ns_per_ms;
constexpr int64_t cap_period_ns = ns_per_s;
constexpr size_t policies_per_period = 16;

struct Policy {
  std::string cpu;   // "0"
  std::string path;  // directory
};

// Entries of `parent` called <prefix><number>.
std::vector<Policy> list_numbered(const Root& root, const std::string& parent,
                                  std::string_view prefix, std::string_view below) {
  std::vector<Policy> policies;
  for (const std::string& entry : root.list(parent)) {
    if (!entry.starts_with(prefix)) continue;
    std::string number = entry.substr(prefix.size());
    if (number.empty() || number.find_first_not_of("0123456789") != std::string::npos) continue;
    std::string path = fmt::format("{}/{}{}", parent, entry, below);
    if (root.exists(path)) policies.push_back({std::move(number), std::move(path)});
  }
  return policies;
}

}  // namespace

void discover_cpufreq(const Root& root, Discovery& discovery) {
  std::vector<Policy> policies =
      list_numbered(root, fmt::format("{}/cpufreq", cpu_dir), "policy", "");
  if (policies.empty()) policies = list_numbered(root, std::string(cpu_dir), "cpu", "/cpufreq");
  if (policies.empty()) {
    discovery.missing.push_back(
        {"cpufreq",
         fmt::format("no frequency policy in '{}/cpufreq'; usual in a virtual machine",
                     root.display(cpu_dir)),
         ""});
    return;
  }
  std::vector<FileChannel> rows;
  std::vector<FileChannel> caps;
  for (const Policy& policy : policies) {
    CheckedFile freq = check_int_file(root, policy.path + "/scaling_cur_freq");
    if (!freq.problem.empty()) {
      discovery.missing.push_back({"cpufreq", freq.problem, ""});
      continue;
    }
    Channel channel;
    channel.name = fmt::format("cpufreq.cpu{}.freq", policy.cpu);
    channel.quantity = Quantity::frequency;
    channel.unit = Unit::kilohertz;
    channel.limit = check_int_file(root, policy.path + "/cpuinfo_max_freq").value;
    Channel cap = channel;
    cap.name = fmt::format("cpufreq.cpu{}.max_freq", policy.cpu);
    cap.quantity = Quantity::limit;
    CheckedFile max = check_int_file(root, policy.path + "/scaling_max_freq");
    if (max.value) caps.push_back({std::move(cap), std::move(max.file)});
    rows.push_back({std::move(channel), std::move(freq.file)});
  }
  const size_t periods = (rows.size() + policies_per_period - 1) / policies_per_period;
  add_file_source(discovery, "cpufreq",
                  base_period_ns * std::max<int64_t>(1, static_cast<int64_t>(periods)),
                  std::move(rows));
  add_file_source(discovery, "cpufreq", cap_period_ns, std::move(caps));
}

}  // namespace energyprof::probe
