#include "app/host.h"

#include <sys/utsname.h>

#include <charconv>
#include <ctime>
#include <fstream>
#include <optional>
#include <thread>

namespace energyprof::app {
namespace {

std::optional<std::string> first_line(const std::filesystem::path& file) {
  std::ifstream in(file);
  std::string line;
  if (!std::getline(in, line) || line.empty()) return std::nullopt;
  return line;
}

/// The value behind `key` in a file of "key<tabs>: value" or key=value lines, without quotes.
std::optional<std::string> value_of(const char* file, const std::string& key, char separator) {
  std::ifstream in(file);
  for (std::string line; std::getline(in, line);) {
    if (line.rfind(key, 0) != 0) continue;
    const size_t at = line.find(separator);
    if (at == std::string::npos) continue;
    const size_t begin = line.find_first_not_of(" \t\"", at + 1);
    const size_t end = line.find_last_not_of(" \t\"");
    if (begin != std::string::npos) return line.substr(begin, end - begin + 1);
  }
  return std::nullopt;
}

/// The number at the beginning of a file's first line; absent unless it is above 0.
std::optional<int64_t> number_in(const std::filesystem::path& file) {
  const std::string line = first_line(file).value_or("");
  int64_t value = 0;
  std::from_chars(line.data(), line.data() + line.size(), value);
  return value > 0 ? std::optional(value) : std::nullopt;
}

/// "48K", "32768K": sizes are in KiB.
std::optional<HostCache> read_cache(const std::filesystem::path& dir) {
  const auto size_kib = number_in(dir / "size");
  const auto ways = number_in(dir / "ways_of_associativity");
  const auto line_bytes = number_in(dir / "coherency_line_size");
  if (!size_kib || !ways || !line_bytes) return std::nullopt;
  return HostCache{*size_kib * 1024, *ways, *line_bytes};
}

nlohmann::json or_null(const std::optional<std::string>& text) {
  return text ? nlohmann::json(*text) : nlohmann::json(nullptr);
}

}  // namespace

nlohmann::json describe_host() {
  utsname system{};
  uname(&system);
  auto cpu = value_of("/proc/cpuinfo", "model name", ':');
  if (!cpu) cpu = value_of("/proc/cpuinfo", "Model", ':');  // ARM boards
  const auto flags = value_of("/proc/cpuinfo", "flags", ':');
  nlohmann::json host;
  host["cpu"] = or_null(cpu);
  host["cores"] = std::thread::hardware_concurrency();
  host["kernel"] = std::string(system.sysname) + " " + system.release + " " + system.machine;
  host["os"] = or_null(value_of("/etc/os-release", "PRETTY_NAME", '='));
  host["virtual_machine"] = flags ? nlohmann::json(flags->find("hypervisor") != std::string::npos)
                                  : nlohmann::json(nullptr);
  host["governor"] = or_null(first_line("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor"));
  host["platform_profile"] = or_null(first_line("/sys/firmware/acpi/platform_profile"));
  return host;
}

HostCaches read_host_caches(const std::filesystem::path& root) {
  HostCaches caches;
  int64_t last_level = 1;
  for (int i = 0;; ++i) {
    const std::filesystem::path dir =
        root / "sys/devices/system/cpu/cpu0/cache" / ("index" + std::to_string(i));
    const auto level = number_in(dir / "level");
    if (!level) return caches;
    if (first_line(dir / "type") == "Instruction") continue;
    if (*level == 1) caches.l1 = read_cache(dir);
    if (*level <= last_level) continue;
    last_level = *level;
    caches.last_level = read_cache(dir);
  }
}

std::string utc_now() {
  const std::time_t now = std::time(nullptr);
  std::tm utc{};
  gmtime_r(&now, &utc);
  char text[32];
  std::strftime(text, sizeof text, "%Y-%m-%dT%H:%M:%SZ", &utc);
  return text;
}

}  // namespace energyprof::app
