// Machines whose files hold nothing, noise or far too much, and whose links go in circles: nothing
// throws, hangs or crashes, and no value is made up.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <random>
#include <set>
#include <thread>

#include "probe/characterize.h"
#include "tree.h"

namespace energyprof::probe {
namespace {

using testing::Contains;
using testing::IsEmpty;
using testing::Not;
namespace fs = std::filesystem;

std::vector<std::string> machines() {
  std::vector<std::string> names;
  for (const auto& entry : fs::directory_iterator(Tree::machine_dir("")))
    if (entry.is_directory()) names.push_back(entry.path().filename().string());
  return names;
}

constexpr size_t huge_bytes = 10'000'000;

struct Content {
  std::string_view name;
  std::string (*make)();
};

std::string make_noise() {
  std::mt19937 random(1);
  std::string text(600, '\0');
  for (char& c : text) c = static_cast<char>(random());
  text[0] = '\x9c';  // neither a digit nor the size of a table
  return text;
}

constexpr std::array contents{
    Content{"Empty", [] { return std::string(); }},
    Content{"Blank", [] { return std::string(" \n\n"); }},
    Content{"Noise", make_noise},
    Content{"HugeZeros", [] { return std::string(huge_bytes, '\0'); }},
    Content{"HugeDigits", [] { return std::string(huge_bytes, '7'); }},
    Content{"HugeLine", [] { return std::string(huge_bytes, 'x') + "\n0\n"; }},
};

// Whether the file stands for a link, as in trees that were copied without.
bool is_link(const fs::path& file) {
  constexpr size_t longest = 200;
  if (fs::file_size(file) > longest) return false;
  std::string line;
  std::ifstream(file) >> line;
  if (line.empty() || line.front() == '/') return false;
  std::error_code error;
  return (line == ".." || line.find('/') != std::string::npos) &&
         fs::exists(file.parent_path() / line, error);
}

// Every file below sys, proc and dev becomes the same one, which has this content.
void replace_files(const Tree& tree, const Content& content, bool keep_links) {
  const fs::path top = tree.path();
  const fs::path model = top / "content";
  fs::remove(model);
  std::ofstream(model, std::ios::binary) << content.make();
  std::vector<fs::path> files;
  for (const char* part : {"sys", "proc", "dev"})
    if (fs::exists(top / part))
      for (const auto& entry : fs::recursive_directory_iterator(top / part))
        if (entry.is_regular_file() && !(keep_links && is_link(entry.path())))
          files.push_back(entry.path());
  for (const fs::path& file : files) {
    fs::remove(file);
    fs::create_hard_link(model, file);
  }
  std::this_thread::sleep_for(std::chrono::milliseconds(55));  // until readers notice
}

// Names of channels that give a value.
std::vector<std::string> names_with_values(const Discovery& found) {
  std::vector<std::string> names;
  for (const auto& [name, reading] : poll_all(found))
    if (reading.status == PollStatus::ok)
      names.push_back(name + "=" + std::to_string(reading.value));
  return names;
}

bool is_printable(const std::string& text) {
  return std::all_of(text.begin(), text.end(), [](char c) { return c >= ' ' && c <= '~'; });
}

class HostileTree : public testing::TestWithParam<std::tuple<std::string, size_t>> {};

TEST_P(HostileTree, GivesReasonsInsteadOfValues) {
  const auto& [machine, index] = GetParam();
  for (const bool keep_links : {true, false}) {
    SCOPED_TRACE(keep_links ? "links kept" : "links replaced");
    const Tree tree(machine);
    replace_files(tree, contents[index], keep_links);
    const Root root = tree.root();
    Discovery found = discover(root);
    characterize(found, root, {ns_per_ms, ns_per_ms});
    EXPECT_THAT(names_with_values(found), IsEmpty());
    std::set<std::string> heard_of;
    for (const auto& source : found.sources) heard_of.emplace(source->name());
    for (const Missing& missing : found.missing) {
      heard_of.insert(missing.source);
      EXPECT_NE(missing.reason, "") << missing.source;
      EXPECT_TRUE(is_printable(missing.reason)) << missing.source;
      EXPECT_LT(missing.reason.size(), 1000u) << missing.source;
    }
    for (const std::string& name : source_names()) EXPECT_THAT(heard_of, Contains(name));
    EXPECT_NE(verdict(found), "");
  }
}

TEST_P(HostileTree, TakesValuesAwayThatWereThere) {
  const auto& [machine, index] = GetParam();
  const Tree tree(machine);
  const Discovery found = discover(tree.root());
  ASSERT_THAT(names_with_values(found), Not(IsEmpty()));
  replace_files(tree, contents[index], true);
  EXPECT_THAT(names_with_values(found), IsEmpty());
}

INSTANTIATE_TEST_SUITE_P(All, HostileTree,
                         testing::Combine(testing::ValuesIn(machines()),
                                          testing::Range(size_t{0}, contents.size())),
                         [](const auto& parameters) {
                           std::string name = std::get<0>(parameters.param) + "_";
                           for (char& c : name)
                             if (c == '-') c = '_';
                           return name.append(contents[std::get<1>(parameters.param)].name);
                         });

class LinksInCircles : public testing::TestWithParam<std::string> {};

TEST_P(LinksInCircles, ChangeNothing) {
  const Tree tree(GetParam());
  const std::vector<std::string> expected = names_of(discover(tree.root()));
  std::vector<fs::path> directories;
  for (const char* part : {"sys", "proc", "dev"})
    if (fs::exists(fs::path(tree.path()) / part))
      for (const auto& entry : fs::recursive_directory_iterator(fs::path(tree.path()) / part))
        if (entry.is_directory()) directories.push_back(entry.path());
  for (const fs::path& directory : directories) {
    fs::create_directory_symlink("selfish", directory / "selfish");
    fs::create_directory_symlink(".", directory / "here");
    fs::create_directory_symlink("..", directory / "up");
    fs::create_directory_symlink("/sys", directory / "top");
  }
  // Members of the classes that lead nowhere.
  for (const char* member :
       {"hwmon/hwmon98", "drm/card98", "thermal/thermal_zone98", "thermal/cooling_device98",
        "powercap/intel-rapl:98", "devfreq/98.gpu", "power_supply/BAT98"}) {
    const fs::path path = fs::path(tree.path()) / "sys/class" / member;
    if (fs::is_directory(path.parent_path())) fs::create_directory_symlink(path.filename(), path);
  }
  EXPECT_EQ(names_of(discover(tree.root())), expected);
}

INSTANTIATE_TEST_SUITE_P(All, LinksInCircles, testing::ValuesIn(machines()),
                         [](const auto& machine) {
                           std::string name = machine.param;
                           for (char& c : name)
                             if (c == '-') c = '_';
                           return name;
                         });

TEST(LinksInCircles, AreFollowedOnceByHwmon) {
  // As in sysfs: a chip's device has a directory of chips, with the chip in it.
  const Tree tree{{"sys/devices/gpu/hwmon/hwmon4/name", "chip\n"},
                  {"sys/devices/gpu/hwmon/hwmon4/temp1_input", "40000\n"}};
  tree.link("sys/devices/gpu/hwmon/hwmon4/device", "../../../gpu");
  tree.link("sys/devices/gpu/hwmon/hwmon4/subsystem", "../../../../class/hwmon");
  tree.link("sys/class/hwmon/hwmon4", "../../devices/gpu/hwmon/hwmon4");
  tree.link("sys/class/hwmon/hwmon5", "hwmon6");
  tree.link("sys/class/hwmon/hwmon6", "hwmon5");
  const Discovery found = discover(tree.root(), Selection{.sources = {"hwmon"}});
  EXPECT_THAT(names_of(found), testing::ElementsAre("hwmon.chip.temp1.temp"));
  EXPECT_EQ(poll_all(found)["hwmon.chip.temp1.temp"].value, 40000);
}

}  // namespace
}  // namespace energyprof::probe
