// Value files: what counts as an integer, and what each failure means.
#include "probe/text_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/un.h>

#include <array>
#include <cerrno>
#include <cstdio>
#include <limits>

#include "core/clock.h"
#include "tree.h"

namespace energyprof::probe {
namespace {

using testing::HasSubstr;

TEST(ParseInt, TakesIntegersOnly) {
  EXPECT_EQ(parse_int("42\n"), 42);
  EXPECT_EQ(parse_int(" -44000 \n"), -44000);
  EXPECT_EQ(parse_int("9223372036854775807"), std::numeric_limits<int64_t>::max());
  for (const char* text : {"", "\n", "9223372036854775808", "18446744073709551615", "4x", "4 5",
                           "0x10", "1.5", "+1", "nan", "-", "--1"})
    EXPECT_EQ(parse_int(text), std::nullopt) << text;
}

RC_GTEST_PROP(ParseInt, ReadsBackEveryInteger, (int64_t value)) {
  RC_ASSERT(parse_int(std::to_string(value) + "\n") == value);
}

TEST(FindInt, TakesTheLineOfThatKey) {
  const std::string text = "nr_periods 10\nnr_throttled 2\nthrottled_usec 156161\n";
  EXPECT_EQ(find_int(text, "nr_throttled"), 2);
  EXPECT_EQ(find_int(text, "throttled_usec"), 156161);
  EXPECT_EQ(find_int(text, "throttled"), std::nullopt);
  EXPECT_EQ(find_int(text, "nr_bursts"), std::nullopt);
  EXPECT_EQ(find_int("nr_throttled", "nr_throttled"), std::nullopt);
}

TEST(StatusOf, TellsWhatPassesFromWhatIsOver) {
  EXPECT_EQ(status_of(0), PollStatus::ok);
  for (const int error : {ENOENT, ENODEV, ENXIO, ENOTDIR})
    EXPECT_EQ(status_of(error), PollStatus::gone) << errno_text(error);
  for (const int error :
       {EAGAIN, EBUSY, ETIMEDOUT, ENODATA, EPERM, EACCES, EIO, EINVAL, EOPNOTSUPP, EMFILE, EINTR})
    EXPECT_EQ(status_of(error), PollStatus::retry) << errno_text(error);
}

TEST(TextFile, StampsTheReadWithTheClockAroundIt) {
  const Tree tree{{"value", "5\n"}};
  TextFile file(tree.root(), "value");
  const int64_t before_ns = now_ns();
  const Reading reading = file.read_int();
  EXPECT_EQ(reading.status, PollStatus::ok);
  EXPECT_EQ(reading.value, 5);
  EXPECT_GE(reading.t_ns, before_ns);
  EXPECT_LE(reading.t_ns, now_ns());
}

TEST(TextFile, FollowsFilesReplacedBelowARoot) {
  const Tree tree{{"value", "5\n"}};
  TextFile file(tree.root(), "value");
  EXPECT_EQ(file.read_int().value, 5);
  tree.write({{"value.new", "6\n"}});
  std::filesystem::rename(tree.path() + "/value.new", tree.path() + "/value");
  EXPECT_EQ(file.read_int().value, 6);
  tree.write({{"value", "7\n"}});
  EXPECT_EQ(file.read_int().value, 7);
}

TEST(TextFile, KeepsOneDescriptorOpenOnTheMachineItself) {
  // Leaves no descriptor to spare: a file that were opened anew could not be read.
  TextFile file(Root(), "proc/self/stat");
  std::array<char, 512> first{};
  ASSERT_EQ(file.read(first).error, 0);
  rlimit old{};
  getrlimit(RLIMIT_NOFILE, &old);
  const rlimit none{0, old.rlim_max};
  setrlimit(RLIMIT_NOFILE, &none);
  std::array<char, 512> second{};
  const TextFile::Read again = file.read(second);
  TextFile other(Root(), "proc/self/stat");
  std::array<char, 512> third{};
  const TextFile::Read refused = other.read(third);
  setrlimit(RLIMIT_NOFILE, &old);
  EXPECT_EQ(again.error, 0);
  EXPECT_GT(again.text.size(), 10u);
  EXPECT_EQ(refused.error, EMFILE);
}

TEST(TextFile, IsGoneForGoodOnceItIsGone) {
  const Tree tree{{"value", "5\n"}};
  TextFile file(tree.root(), "value");
  EXPECT_EQ(file.read_int().status, PollStatus::ok);
  tree.remove("value");
  EXPECT_EQ(file.read_int().status, PollStatus::gone);
  tree.write({{"value", "6\n"}});
  EXPECT_EQ(file.read_int().status, PollStatus::gone);
}

TEST(TextFile, TriesAgainAfterTextThatIsNoNumber) {
  const Tree tree{{"value", ""}};
  TextFile file(tree.root(), "value");
  EXPECT_EQ(file.read_int().status, PollStatus::retry);
  tree.write({{"value", "garbage\n"}});
  EXPECT_EQ(file.read_int().status, PollStatus::retry);
  tree.write({{"value", "99999999999999999999\n"}});
  EXPECT_EQ(file.read_int().status, PollStatus::retry);
  tree.write({{"value", "8\n"}});
  EXPECT_EQ(file.read_int().status, PollStatus::ok);
}

TEST(TextFile, DoesNotFollowALinkPutInItsPlace) {
  const Tree outside{{"secret", "1"}};
  const Tree tree{{"value", "5\n"}};
  TextFile file(tree.root(), "value");
  tree.remove("value");
  tree.link("value", outside.path() + "/secret");
  EXPECT_NE(file.read_int().status, PollStatus::ok);
}

TEST(CheckIntFile, SaysWhyAFileIsNoUse) {
  const Tree tree{{"ok", "-3\n"},
                  {"empty", ""},
                  {"garbage", "abc def\nmore\n"},
                  {"big", "99999999999999999999\n"},
                  {"directory/file", ""},
                  {"busy", ""},
                  {"no-data", ""}};
  const Root root = tree.root({{"busy", EAGAIN}, {"no-data", ENODATA}});
  EXPECT_EQ(check_int_file(root, "ok").value, -3);
  EXPECT_EQ(check_int_file(root, "ok").problem, "");
  EXPECT_THAT(check_int_file(root, "absent").problem, HasSubstr("No such file"));
  EXPECT_THAT(check_int_file(root, "empty").problem, HasSubstr("is empty"));
  EXPECT_THAT(check_int_file(root, "garbage").problem, HasSubstr("'abc def'"));
  EXPECT_THAT(check_int_file(root, "big").problem, HasSubstr("63 bits"));
  EXPECT_THAT(check_int_file(root, "directory").problem, HasSubstr("Is a directory"));
  EXPECT_THAT(check_int_file(root, "no-data").problem, HasSubstr("No data available"));
  EXPECT_THAT(check_int_file(root, "garbage").problem, HasSubstr(tree.path() + "/garbage"));
  const CheckedFile busy = check_int_file(root, "busy");
  EXPECT_EQ(busy.problem, "");  // it may answer later
  EXPECT_EQ(busy.value, std::nullopt);
}

TEST(TextFile, TriesAgainWhereAnErrorIsExpectedToPass) {
  const Tree tree;
  const std::string path = tree.path() + "/socket";
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  path.copy(address.sun_path, sizeof address.sun_path - 1);
  const int fd = socket(AF_UNIX, SOCK_STREAM, 0);
  ASSERT_EQ(bind(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
  TextFile file(tree.root(), "socket");
  EXPECT_EQ(file.read_int().status, PollStatus::gone);  // ENXIO
  TextFile patient(tree.root(), "socket");
  patient.expect(ENXIO);
  EXPECT_EQ(patient.read_int().status, PollStatus::retry);
  close(fd);
}

}  // namespace
}  // namespace energyprof::probe
