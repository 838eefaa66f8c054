// The Vulkan device of this machine, and machines without one.
#include "kernels/device.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "kernels/buffer.h"
#include "kernels/context.h"
#include "scene.h"

namespace energyprof::kernels {
namespace {

using testing::AnyOf;
using testing::HasSubstr;
using testing::Not;

class DeviceTest : public testing::Test {
 protected:
  void SetUp() override {
    if (const std::string reason = no_device_reason(); !reason.empty()) GTEST_SKIP() << reason;
  }
};

template <typename Call>
std::string error_of(Call&& call) {
  try {
    call();
  } catch (const std::runtime_error& error) {
    return error.what();
  }
  return "no error";
}

TEST_F(DeviceTest, SaysWhatItIs) {
  ValidatedDevice device;
  const DeviceInfo& info = device->info();
  EXPECT_FALSE(info.name.empty());
  EXPECT_THAT(info.type, AnyOf("integrated", "discrete", "virtual", "cpu", "other"));
  EXPECT_THAT(info.api_version, testing::MatchesRegex("1\\.[0-9]+\\.[0-9]+"));
  EXPECT_THAT(info.uuid, testing::MatchesRegex("[0-9a-f-]+"));
  EXPECT_EQ(info.uuid.size(), 36u);
  EXPECT_GE(info.max_storage_buffer_bytes, uint64_t{1} << 27);  // what Vulkan guarantees
  EXPECT_GE(info.max_workgroup_invocations, 128u);
  EXPECT_GE(info.max_workgroup_count_x, 65'535u);
  EXPECT_GT(info.timestamp_period_ns, 0.0);
  EXPECT_GE(info.timestamp_valid_bits, 36u);
  EXPECT_GE(info.subgroup_size, 1u);
  EXPECT_FALSE(info.clock_note.empty());
}

TEST_F(DeviceTest, ListAgreesWithTheDeviceOpened) {
  ValidatedDevice device;
  const DeviceList list = list_devices();
  ASSERT_FALSE(list.usable.empty());
  EXPECT_EQ(list.usable.front().name, device->info().name);
  EXPECT_EQ(list.usable.front().uuid, device->info().uuid);
  EXPECT_EQ(list.usable.size() + list.unusable.size(), device->refusals().size() + 1);
}

TEST_F(DeviceTest, UnknownNameIsAnErrorThatListsDevices) {
  const std::string name = list_devices().usable.front().name;
  const std::string error = error_of([] { const Device device({.name = "no such GPU"}); });
  EXPECT_THAT(error, HasSubstr(name));
  EXPECT_THAT(error, HasSubstr("name does not contain 'no such GPU'"));
}

TEST_F(DeviceTest, ValidationMessagesAreCollected) {
  std::optional<Device> device;
  try {
    device.emplace(DeviceRequest{.validation = true});
  } catch (const std::runtime_error& error) {
    GTEST_SKIP() << error.what();
  }
  EXPECT_TRUE(device->validation_messages().empty());
  // A buffer without size: not allowed.
  Context& context = device->context();
  VkBufferCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO;
  info.usage = VK_BUFFER_USAGE_STORAGE_BUFFER_BIT;
  VkBuffer buffer = VK_NULL_HANDLE;
  context.api.create_buffer(context.device, &info, nullptr, &buffer);
  const Owned<VkBuffer> owned(context, buffer, context.api.destroy_buffer);
  ASSERT_FALSE(device->validation_messages().empty());
  EXPECT_THAT(device->validation_messages().front(), HasSubstr("VkBufferCreateInfo-size"));
}

TEST_F(DeviceTest, SeveralCanLiveOneAfterTheOther) {
  for (int i = 0; i < 3; ++i) ValidatedDevice device;
}

TEST(NoVulkan, MissingDriverIsOneClearLine) {
  const ScopedEnvironment files("VK_DRIVER_FILES", "/nonexistent.json");
  const ScopedEnvironment old_files("VK_ICD_FILENAMES", "/nonexistent.json");
  if (error_of([] { load_vulkan(); }) != "no error") GTEST_SKIP() << "no Vulkan loader";
  const std::string error = error_of([] { list_devices(); });
  EXPECT_THAT(error, HasSubstr("cannot use Vulkan"));
  EXPECT_THAT(error, HasSubstr("mesa-vulkan-drivers"));
  EXPECT_THAT(error, Not(HasSubstr("\n")));
}

TEST(NoVulkan, MissingLoaderIsOneClearLine) {
  const std::string error = error_of([] { load_vulkan("libno-such-vulkan.so.1"); });
  EXPECT_THAT(error, HasSubstr("cannot load the Vulkan loader 'libno-such-vulkan.so.1'"));
  EXPECT_THAT(error, HasSubstr("Install libvulkan1"));
  EXPECT_THAT(error, Not(HasSubstr("\n")));
}

TEST(NoVulkan, SomethingElseIsNoLoader) {
  const std::string error = error_of([] { load_vulkan("libm.so.6"); });
  EXPECT_THAT(error, HasSubstr("it has no vkGetInstanceProcAddr"));
}

TEST(Results, BecomeTheRightExceptions) {
  EXPECT_NO_THROW(check(VK_SUCCESS, "x"));
  EXPECT_THROW(check(VK_ERROR_DEVICE_LOST, "x"), DeviceLost);
  EXPECT_THROW(check(VK_ERROR_OUT_OF_DEVICE_MEMORY, "x"), OutOfMemory);
  EXPECT_THROW(check(VK_ERROR_OUT_OF_HOST_MEMORY, "x"), OutOfMemory);
  EXPECT_EQ(error_of([] { check(VK_ERROR_INITIALIZATION_FAILED, "open it"); }),
            "cannot open it: VK_ERROR_INITIALIZATION_FAILED.");
}

TEST(SizeText, IsReadableAndNeverRoundsDown) {
  EXPECT_EQ(size_text(96), "96 bytes");
  EXPECT_EQ(size_text(uint64_t{128} << 20), "128 MiB");
  EXPECT_EQ(size_text((uint64_t{128} << 20) + 1), "128.01 MiB");
  EXPECT_EQ(size_text(uint64_t{3} << 19), "1.5 MiB");
}

}  // namespace
}  // namespace energyprof::kernels
