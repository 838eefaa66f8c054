// Expects in a device's directory, GTs below tiles or, in early kernels, without them:
//
//   tile0/gt0/freq0/act_freq  cur_freq  max_freq  rp0_freq  rpn_freq     1350
//   tile0/gt0/freq0/throttle/reasons                                     "pl1 pl2", or "none"
//   tile0/gt0/freq0/throttle/status  reason_pl1  reason_pl2 ...          0 or 1; older kernels
//   tile0/gt0/gtidle/idle_residency_ms                                   2547784
#include "probe/xe.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <utility>

#include "core/clock.h"
#include "probe/drm_card.h"
#include "probe/file_source.h"
#include "probe/names.h"
#include "probe/throttle_reasons.h"

namespace energyprof::probe {
namespace {

constexpr int64_t clock_period_ns = 20 * ns_per_ms;
constexpr int64_t requested_period_ns = ns_per_s;
constexpr int64_t limit_period_ns = ns_per_s;
constexpr int64_t constant_period_ns = 60 * ns_per_s;
constexpr int64_t idle_period_ns = 100 * ns_per_ms;

struct Gt {
  std::string prefix;  // of channel names: "xe.gt0"
  std::string path;
};

std::vector<Gt> list_gts(const Root& root, const NamedCard& named) {
  std::vector<Gt> gts;
  const auto add_gts_of = [&](const std::string& parent) {
    for (const std::string& entry : root.list(parent))
      if (is_numbered(entry, "gt") && root.exists(fmt::format("{}/{}/freq0", parent, entry)))
        gts.push_back(
            {fmt::format("{}.{}", named.prefix, entry), fmt::format("{}/{}", parent, entry)});
  };
  const std::string device = named.card.path + "/device";
  for (const std::string& entry : root.list(device))
    if (is_numbered(entry, "tile")) add_gts_of(fmt::format("{}/{}", device, entry));
  if (gts.empty()) add_gts_of(device);
  return gts;
}

// The next word of `text`, which loses it; empty at the end.
std::string_view next_word(std::string_view& text) {
  constexpr std::string_view space = " \t\r\n";
  text.remove_prefix(std::min(text.find_first_not_of(space), text.size()));
  const std::string_view word = text.substr(0, std::min(text.find_first_of(space), text.size()));
  text.remove_prefix(word.size());
  return word;
}

// A word that can be the name of a reason; others are no list of reasons.
bool is_reason(std::string_view word) {
  constexpr size_t longest = 32;
  return word.size() <= longest && std::all_of(word.begin(), word.end(), [](char c) {
           return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '_';
         });
}

// Whether `text` is a list of reasons. One without active reasons has the word "none": an empty
// file says nothing.
bool is_reason_list(std::string_view text) {
  std::string_view word = next_word(text);
  if (word.empty()) return false;
  for (; !word.empty(); word = next_word(text))
    if (!is_reason(word)) return false;
  return true;
}

// Enough for every reason there is; what a longer list says behind that is not read.
using ListBuffer = std::array<char, 1024>;

// One file that lists the active reasons: one register read for all of them.
class ReasonList final : public SensorSource {
 public:
  ReasonList(std::string_view prefix, std::vector<std::string> names, TextFile file,
             SourceTraits traits)
      : SensorSource("xe", throttle_period_ns, flag_channels(prefix, names, file.path()),
                     std::move(traits)),
        names_(std::move(names)),
        file_(std::move(file)) {}

  void poll(std::span<Reading> out) noexcept override {
    ListBuffer buffer;
    const TextFile::Read read = file_.read(buffer);
    const bool is_list = read.error == 0 && is_reason_list(read.text);
    for (Reading& reading : out)
      reading = read.reading(is_list ? std::optional<int64_t>(0) : std::nullopt);
    if (!is_list) return;
    std::string_view text = read.text;
    for (std::string_view word = next_word(text); !word.empty(); word = next_word(text)) {
      if (word == none) continue;
      const auto known = std::find(names_.begin(), names_.end(), word);
      out.front().value = 1;
      out[1 + static_cast<size_t>(known - names_.begin())].value = 1;  // the last one is "other"
    }
  }

  static constexpr std::string_view none = "none";

 private:
  static std::vector<Channel> flag_channels(std::string_view prefix,
                                            const std::vector<std::string>& names,
                                            const std::string& origin) {
    std::vector<Channel> channels{throttle_flag(prefix, "status", origin + ": any")};
    for (const std::string& name : names)
      channels.push_back(throttle_flag(prefix, name, origin + ": " + name));
    channels.push_back(throttle_flag(prefix, "other", origin + ": any other name"));
    return channels;
  }

  std::vector<std::string> names_;
  TextFile file_;
};

// Reasons that hardware is known to give, for kernels that have the list only.
constexpr std::array<std::string_view, 18> all_reasons{"pl1",
                                                       "pl2",
                                                       "pl4",
                                                       "thermal",
                                                       "prochot",
                                                       "ratl",
                                                       "vr_thermalert",
                                                       "vr_tdc",
                                                       "soc_thermal",
                                                       "mem_thermal",
                                                       "vr_thermal",
                                                       "iccmax",
                                                       "soc_avg_thermal",
                                                       "fastvmode",
                                                       "psys_pl1",
                                                       "psys_pl2",
                                                       "p0_freq",
                                                       "psys_crit"};

// The reasons that have a file of their own, else all that are known; and those active now.
std::vector<std::string> known_reasons(const Root& root, const std::string& directory,
                                       std::string_view active) {
  constexpr std::string_view file_prefix = "reason_";
  std::vector<std::string> names;
  for (const std::string& entry : root.list(directory))
    if (entry.starts_with(file_prefix) && is_reason(entry))
      names.push_back(entry.substr(file_prefix.size()));
  if (names.empty()) names.assign(all_reasons.begin(), all_reasons.end());
  for (std::string_view word = next_word(active); !word.empty(); word = next_word(active))
    if (word != ReasonList::none && std::find(names.begin(), names.end(), word) == names.end())
      names.emplace_back(word);
  return names;
}

void discover_throttle(const Root& root, const Gt& gt, const std::string& gpu,
                       Discovery& discovery) {
  const std::string directory = gt.path + "/freq0/throttle";
  TextFile list(root, directory + "/reasons");
  ListBuffer buffer;
  const TextFile::Read read = list.read(buffer);
  if (is_transient(read.error) || (read.error == 0 && is_reason_list(read.text))) {
    discovery.sources.push_back(std::make_unique<ReasonList>(
        gt.prefix, known_reasons(root, directory, read.text), std::move(list),
        SourceTraits{.slow = true, .wakes_device = true, .gpu = gpu}));
    return;
  }
  if (!add_reason_files(root, discovery, "xe", gt.prefix, directory, "reason_", "status", gpu))
    discovery.missing.push_back(
        {"xe", fmt::format("no throttle reasons of {} in '{}'", gt.prefix, root.display(directory)),
         ""});
}

void discover_gt(const Root& root, const Gt& gt, const NamedCard& named, Discovery& discovery) {
  const std::string& gpu = named.card.gpu;
  const SourceTraits waking{.slow = true, .wakes_device = true, .gpu = gpu};
  // The actual clock is a register, which wakes no GT but the device, where that may sleep.
  const bool sleeps = may_sleep(root, named.card.path + "/device");
  const SourceTraits light{.slow = sleeps, .wakes_device = sleeps, .gpu = gpu};
  auto highest = check_int_file(root, gt.path + "/freq0/rp0_freq").value;
  if (highest == 0) highest.reset();
  const auto clock = [&](const char* name, Quantity quantity) {
    Channel channel =
        make_channel(fmt::format("{}.{}", gt.prefix, name), quantity, Unit::megahertz);
    channel.limit = highest;
    return channel;
  };
  const auto add_clock = [&](const char* name, const char* file, Quantity quantity,
                             int64_t period_ns, const SourceTraits& traits) {
    std::vector<FileChannel> rows;
    add_file_row(root, discovery, "xe", rows, clock(name, quantity),
                 fmt::format("{}/freq0/{}", gt.path, file));
    add_file_source(discovery, "xe", period_ns, std::move(rows), traits);
  };
  add_clock("act_freq", "act_freq", Quantity::frequency, clock_period_ns, light);
  add_clock("requested_freq", "cur_freq", Quantity::frequency, requested_period_ns, waking);
  // The firmware is asked for it.
  add_clock("max_freq", "max_freq", Quantity::limit, limit_period_ns, waking);
  for (const char* name : {"rp0_freq", "rpn_freq"})
    add_clock(name, name, Quantity::limit, constant_period_ns, waking);

  discover_throttle(root, gt, gpu, discovery);

  std::vector<FileChannel> residency;
  add_file_row(root, discovery, "xe", residency,
               make_channel(gt.prefix + ".c6_residency", Quantity::utilization, Unit::millisecond,
                            Kind::cumulative),
               gt.path + "/gtidle/idle_residency_ms");
  add_file_source(discovery, "xe", idle_period_ns, std::move(residency), waking);
}

}  // namespace

void discover_xe(const Root& root, Discovery& discovery) {
  const std::vector<NamedCard> cards = drm_cards_of(root, "xe");
  if (cards.empty()) discovery.missing.push_back({"xe", "no GPU runs under the xe driver", ""});
  for (const NamedCard& named : cards) {
    const std::vector<Gt> gts = list_gts(root, named);
    if (gts.empty())
      discovery.missing.push_back(
          {"xe", fmt::format("no GT with clocks in '{}/device'", root.display(named.card.path)),
           ""});
    for (const Gt& gt : gts) discover_gt(root, gt, named, discovery);
    report_absent_chip(root, named.card, discovery);
  }
}

}  // namespace energyprof::probe
