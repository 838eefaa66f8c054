// Paths below a --root: links of both kinds are followed, and none leads out.
#include "probe/root.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <cerrno>
#include <fstream>
#include <stdexcept>

#include "probe/text_file.h"
#include "tree.h"

namespace energyprof::probe {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

TEST(Root, RefusesWhatIsNoDirectory) {
  const Tree tree{{"file", "text"}};
  EXPECT_THROW(Root(tree.path() + "/absent"), std::runtime_error);
  try {
    Root root(tree.path() + "/file");
    FAIL() << "a file was taken as root";
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), HasSubstr("Not a directory"));
  }
}

TEST(Root, KnowsTheMachineItselfFromACopy) {
  EXPECT_TRUE(Root().is_host());
  EXPECT_TRUE(Root("/tmp/..").is_host());
  EXPECT_EQ(Root().display("sys/class"), "/sys/class");
  const Tree tree;
  EXPECT_FALSE(tree.root().is_host());
  EXPECT_EQ(tree.root().display("sys/class"), tree.path() + "/sys/class");
}

TEST(Root, FollowsSymbolicLinksRelativeAndAbsolute) {
  const Tree tree{{"sys/devices/zone/energy_uj", "7\n"}};
  tree.link("sys/class/powercap/zone", "../../devices/zone");
  tree.link("sys/class/powercap/absolute", "/sys/devices/zone");
  tree.link("sys/class/powercap/chain", "absolute");
  const Root root = tree.root();
  for (const std::string name : {"zone", "absolute", "chain"})
    EXPECT_EQ(root.read_line("sys/class/powercap/" + name + "/energy_uj"), "7") << name;
  EXPECT_EQ(root.resolve("sys/class/powercap/chain").path, tree.path() + "/sys/devices/zone");
}

TEST(Root, FollowsTextFilesThatStandForLinks) {
  const Tree tree{{"sys/devices/zone/energy_uj", "7\n"},
                  {"sys/class/powercap/zone", "../../devices/zone"},
                  {"sys/class/powercap/with-newline", "../../devices/zone\n"},
                  {"sys/class/powercap/neighbour", "zone"}};
  const Root root = tree.root();
  for (const std::string name : {"zone", "with-newline", "neighbour"})
    EXPECT_EQ(root.read_line("sys/class/powercap/" + name + "/energy_uj"), "7") << name;
  EXPECT_EQ(root.resolve("sys/class/powercap/zone").path, tree.path() + "/sys/devices/zone");
}

TEST(Root, DoesNotTakeTextForALinkWithoutNeed) {
  const Tree tree{{"chip/name", "power"},     {"chip/power/control", "auto"},
                  {"chip/type", "a/b/c"},     {"chip/two-lines", "../chip\n../chip\n"},
                  {"chip/absolute", "/chip"}, {"chip/empty", ""}};
  const Root root = tree.root();
  EXPECT_EQ(root.read_line("chip/name"), "power");  // names a neighbour
  EXPECT_EQ(root.read_line("chip/type"), "a/b/c");  // leads nowhere
  EXPECT_EQ(root.resolve("chip/two-lines/power").error, ENOTDIR);
  EXPECT_EQ(root.resolve("chip/absolute/power").error, ENOTDIR);
  EXPECT_EQ(root.resolve("chip/empty/power").error, ENOTDIR);
}

TEST(Root, IsNeverLeft) {
  const Tree outside{{"secret", "1"}};
  const Tree tree{{"here", "2"}};
  tree.link("up", "../../../../../../../../" + outside.path());
  tree.link("absolute", outside.path());
  tree.write({{"text-up", "../../../../../../.." + outside.path()}});
  const Root root = tree.root();
  EXPECT_EQ(root.resolve("up/secret").error, ENOENT);
  EXPECT_EQ(root.resolve("absolute/secret").error, ENOENT);
  EXPECT_NE(root.resolve("text-up/secret").error, 0);
  EXPECT_EQ(root.read_line("../../../../here"), "2");
  EXPECT_EQ(root.resolve("../..").path, tree.path());
}

TEST(Root, EndsLoops) {
  const Tree tree{{"text-a/x", ""}};
  tree.link("a", "b");
  tree.link("b", "a");
  tree.write({{"c", "../root/d"}, {"d", "./c"}});
  tree.link("self", "self/self");
  const Root root = tree.root();
  EXPECT_EQ(root.resolve("a/x").error, ELOOP);
  EXPECT_EQ(root.resolve("self").error, ELOOP);
  EXPECT_NE(root.resolve("d/x").error, 0);
}

TEST(Root, EndsLinksThatDoubleWithEachStep) {
  const Tree tree{{"link0/x", ""}};
  for (int i = 1; i <= 30; ++i) {
    const std::string before = "link" + std::to_string(i - 1);
    tree.link("link" + std::to_string(i), before + "/../" + before);
  }
  EXPECT_EQ(tree.root().resolve("link3/x").error, 0);
  EXPECT_EQ(tree.root().resolve("link30/x").error, ELOOP);  // not after 2^30 steps
}

TEST(Root, DoesNotWaitForAPipe) {
  const Tree tree;
  const std::string pipe = tree.path() + "/pipe";
  ASSERT_EQ(mkfifo(pipe.c_str(), 0600), 0);
  const Root root = tree.root();
  EXPECT_EQ(root.read_line("pipe"), std::nullopt);
  EXPECT_NE(check_int_file(root, "pipe").problem, "");
}

TEST(Root, NamesWhereALinkPointsToThoughItIsNotThere) {
  const Tree tree{{"device/here/uevent", ""}, {"device/text", "../../drivers/xe\n"}};
  tree.link("device/driver", "../../../bus/pci/drivers/i915");
  tree.link("card/device", "../device");
  const Root root = tree.root();
  EXPECT_EQ(root.link_name("device/driver"), "i915");
  EXPECT_EQ(root.link_name("card/device/driver"), "i915");
  EXPECT_EQ(root.link_name("card/device"), "device");
  EXPECT_EQ(root.link_name("device/text"), "xe");
  EXPECT_EQ(root.link_name("device/here"), "");
  EXPECT_EQ(root.link_name("absent/driver"), "");
}

TEST(Root, ListsOneLevelInNaturalOrder) {
  const Tree tree{{"d/cpu10", ""}, {"d/cpu2", ""}, {"d/.hidden", ""}, {"d/cpu1/deeper", ""}};
  EXPECT_THAT(tree.root().list("d"), ElementsAre("cpu1", "cpu2", "cpu10"));
  EXPECT_THAT(tree.root().list("absent"), ElementsAre());
  EXPECT_THAT(tree.root().list("d/cpu2"), ElementsAre());
}

TEST(Root, ReadsTextOrSaysWhyNot) {
  const Tree tree{{"file", " one \ntwo\n"}, {"empty", ""}, {"blank", "  \n"}};
  const Root root = tree.root({{"file2", EAGAIN}, {"empty", EIO}});
  EXPECT_EQ(root.read("file").text, " one \ntwo\n");
  EXPECT_EQ(root.read_line("file"), "one");
  EXPECT_EQ(root.read_line("blank"), std::nullopt);
  EXPECT_EQ(root.read("absent").error, ENOENT);
  EXPECT_EQ(root.read(".").error, EISDIR);
  EXPECT_EQ(root.read("empty").error, EIO);
}

}  // namespace
}  // namespace energyprof::probe
