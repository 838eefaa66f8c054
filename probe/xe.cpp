// Expects in a device's directory, GTs below tiles or, in early kernels, without them:
//
//   tile0/gt0/freq0/act_freq  cur_freq  max_freq  rp0_freq          1350
//   tile0/gt0/freq0/throttle/reasons                                "pl1 pl2", or "none"; newer
//   kernels tile0/gt0/freq0/throttle/status  reason_pl1  reason_pl2 ...     0 or 1
//   tile0/gt0/gtidle/idle_residency_ms                              2547784
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
constexpr int64_t idle_period_ns = 100 * ns_per_ms;

struct Gt {
  std::string prefix;  // of channel names: "xe.gt0"
  std::string path;
};

std::vector<Gt> list_gts(const Root& root, const NamedCard& named) {
  const std::string device = named.card.path + "/device";
  std::vector<std::string> parents{device};
  for (const std::string& entry : root.list(device))
    if (entry.starts_with("tile")) parents.push_back(fmt::format("{}/{}", device, entry));
  std::vector<Gt> gts;
  for (const std::string& parent : parents)
    for (const std::string& entry : root.list(parent))
      if (entry.starts_with("gt") && root.exists(fmt::format("{}/{}/freq0", parent, entry)))
        gts.push_back(
            {fmt::format("{}.{}", named.prefix, entry), fmt::format("{}/{}", parent, entry)});
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
    std::array<char, 1024> buffer;
    const TextFile::Read read = file_.read(buffer);
    std::string_view text = read.text;
    // "none" is always there: an empty file says nothing.
    const bool is_list = read.error == 0 && !next_word(text).empty();
    for (Reading& reading : out)
      reading = read.reading(is_list ? std::optional<int64_t>(0) : std::nullopt);
    if (!is_list) return;
    text = read.text;
    for (std::string_view word = next_word(text); !word.empty(); word = next_word(text)) {
      if (word == "none") continue;
      const auto known = std::find(names_.begin(), names_.end(), word);
      out[static_cast<size_t>(known - names_.begin())].value = 1;  // the last one is "other"
    }
  }

 private:
  static std::vector<Channel> flag_channels(std::string_view prefix,
                                            const std::vector<std::string>& names,
                                            const std::string& origin) {
    std::vector<Channel> channels;
    for (const std::string& name : names)
      channels.push_back(throttle_flag(prefix, slug(name), origin + ": " + name));
    channels.push_back(throttle_flag(prefix, "other", origin + ": any other name"));
    return channels;
  }

  std::vector<std::string> names_;
  TextFile file_;
};

// The reasons that have a file of their own, and those that are active now.
std::vector<std::string> known_reasons(const Root& root, const std::string& directory,
                                       std::string_view active) {
  constexpr std::string_view file_prefix = "reason_";
  std::vector<std::string> names;
  for (const std::string& entry : root.list(directory))
    if (entry.starts_with(file_prefix)) names.push_back(entry.substr(file_prefix.size()));
  for (std::string_view word = next_word(active); !word.empty(); word = next_word(active))
    if (word != "none" && std::find(names.begin(), names.end(), word) == names.end())
      names.emplace_back(word);
  return names;
}

void discover_throttle(const Root& root, const Gt& gt, const std::string& gpu,
                       Discovery& discovery) {
  const std::string directory = gt.path + "/freq0/throttle";
  const std::string list = directory + "/reasons";
  const std::optional<std::string> active = root.read_line(list);
  if (active) {
    discovery.sources.push_back(std::make_unique<ReasonList>(
        gt.prefix, known_reasons(root, directory, *active), TextFile(root, list),
        SourceTraits{.slow = true, .wakes_device = true, .gpu = gpu}));
    return;
  }
  if (!add_reason_files(root, discovery, "xe", gt.prefix, directory, "reason_", "status", gpu))
    discovery.missing.push_back(
        {"xe", fmt::format("no throttle reasons of {} in '{}'", gt.prefix, root.display(directory)),
         ""});
}

// A source of one file; an absent one is no news.
void discover_file(const Root& root, Channel channel, const std::string& path, int64_t period_ns,
                   SourceTraits traits, Discovery& discovery) {
  if (!root.exists(path)) return;
  CheckedFile checked = check_int_file(root, path);
  if (!checked.problem.empty()) {
    discovery.missing.push_back({"xe", checked.problem, ""});
    return;
  }
  std::vector<FileChannel> rows;
  rows.push_back({std::move(channel), std::move(checked.file)});
  add_file_source(discovery, "xe", period_ns, std::move(rows), std::move(traits));
}

void discover_gt(const Root& root, const Gt& gt, const std::string& gpu, Discovery& discovery) {
  const std::string freq = gt.path + "/freq0";
  Channel clock;
  clock.name = gt.prefix + ".act_freq";
  clock.quantity = Quantity::frequency;
  clock.unit = Unit::megahertz;
  clock.limit = check_int_file(root, freq + "/rp0_freq").value;
  const SourceTraits quiet{.gpu = gpu};
  const SourceTraits waking{.slow = true, .wakes_device = true, .gpu = gpu};
  discover_file(root, clock, freq + "/act_freq", clock_period_ns, quiet, discovery);
  clock.name = gt.prefix + ".requested_freq";
  discover_file(root, clock, freq + "/cur_freq", requested_period_ns, waking, discovery);
  clock.name = gt.prefix + ".max_freq";
  clock.quantity = Quantity::limit;
  discover_file(root, clock, freq + "/max_freq", limit_period_ns, quiet, discovery);

  discover_throttle(root, gt, gpu, discovery);

  Channel idle;
  idle.name = gt.prefix + ".c6_residency";
  idle.quantity = Quantity::utilization;
  idle.unit = Unit::millisecond;
  idle.kind = Kind::cumulative;
  discover_file(root, std::move(idle), gt.path + "/gtidle/idle_residency_ms", idle_period_ns,
                waking, discovery);
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
    for (const Gt& gt : gts) discover_gt(root, gt, named.card.gpu, discovery);
  }
}

}  // namespace energyprof::probe
