// Allocates buffers, maps or stages them.
#include "kernels/buffer.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cassert>
#include <cstring>
#include <optional>

namespace energyprof::kernels {
namespace {

/// Staging copies go in pieces of at most this size, so that they need little extra memory.
constexpr uint64_t staging_bytes = 16u << 20u;
/// An empty mesh still needs something to bind.
constexpr uint64_t smallest_buffer_bytes = 16;

constexpr VkMemoryPropertyFlags host_reaches =
    VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT;

/// The memory types to try for `use`, best first.
std::array<VkMemoryPropertyFlags, 2> wanted_memory(const Context& context, Buffer::Use use) {
  switch (use) {
    case Buffer::Use::readback:
      return {host_reaches | VK_MEMORY_PROPERTY_HOST_CACHED_BIT, host_reaches};
    case Buffer::Use::staging:
      return {host_reaches, host_reaches};
    case Buffer::Use::shader:
      break;
  }
  if (context.shares_memory()) {
    return {host_reaches | VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT, host_reaches};
  }
  return {VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT, 0};
}

/// The driver lists the fastest of equal types first.
std::optional<uint32_t> find_memory(const Context& context, uint32_t allowed,
                                    VkMemoryPropertyFlags flags) {
  for (uint32_t i = 0; i < context.memory.memoryTypeCount; ++i) {
    const bool fits = (context.memory.memoryTypes[i].propertyFlags & flags) == flags;
    if (fits && ((allowed >> i) & 1u) != 0) return i;
  }
  return std::nullopt;
}

VkBufferUsageFlags usage_of(Buffer::Use use) {
  const VkBufferUsageFlags copies =
      VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT;
  return use == Buffer::Use::staging ? copies : copies | VK_BUFFER_USAGE_STORAGE_BUFFER_BIT;
}

/// Copies on the device and waits until the host may read the destination.
void copy_and_wait(Context& context, VkBuffer from, VkBuffer to, VkBufferCopy region) {
  const Owned<VkCommandPool> pool = make_command_pool(context);
  const Owned<VkFence> fence = make_fence(context);
  const VkCommandBuffer commands = make_command_buffers(context, pool.get(), 1).front();
  begin_commands(context, commands);
  context.api.cmd_copy_buffer(commands, from, to, 1, &region);
  VkMemoryBarrier barrier{};
  barrier.sType = VK_STRUCTURE_TYPE_MEMORY_BARRIER;
  barrier.srcAccessMask = VK_ACCESS_TRANSFER_WRITE_BIT;
  barrier.dstAccessMask = VK_ACCESS_HOST_READ_BIT | VK_ACCESS_SHADER_READ_BIT;
  context.api.cmd_pipeline_barrier(
      commands, VK_PIPELINE_STAGE_TRANSFER_BIT,
      VK_PIPELINE_STAGE_HOST_BIT | VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, 0, 1, &barrier, 0, nullptr,
      0, nullptr);
  end_commands(context, commands);
  submit(context, commands, fence.get(), "copy a buffer");
  wait_and_reset(context, fence.get(), "copy a buffer");
}

}  // namespace

Buffer::Buffer(Context& context, std::string_view what, uint64_t byte_count, Use use)
    : context_(&context), byte_count_(byte_count) {
  const uint64_t limit = context.info.max_storage_buffer_bytes;
  if (use != Use::staging && byte_count > limit) {
    const DeviceRefusal refusal{context.info.name,
                                fmt::format("maxStorageBufferRange is {}, the {} needs {}",
                                            size_text(limit), what, size_text(byte_count))};
    throw std::runtime_error(no_device_fits({&refusal, 1}));
  }
  VkBufferCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO;
  info.size = std::max(byte_count, smallest_buffer_bytes);
  info.usage = usage_of(use);
  info.sharingMode = VK_SHARING_MODE_EXCLUSIVE;
  VkBuffer buffer = VK_NULL_HANDLE;
  check(context.api.create_buffer(context.device, &info, nullptr, &buffer),
        fmt::format("create the {} of {}", what, size_text(info.size)));
  buffer_ = {context, buffer, context.api.destroy_buffer};
  allocate(what, use);
}

void Buffer::allocate(std::string_view what, Use use) {
  Context& context = *context_;
  VkMemoryRequirements needs{};
  context.api.get_buffer_memory_requirements(context.device, buffer_.get(), &needs);
  std::optional<uint32_t> type;
  for (const VkMemoryPropertyFlags flags : wanted_memory(context, use)) {
    if (!type) type = find_memory(context, needs.memoryTypeBits, flags);
  }
  if (!type) {
    throw std::runtime_error(
        fmt::format("cannot allocate the {} on '{}': it offers no suitable type of memory.", what,
                    context.info.name));
  }
  VkMemoryAllocateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO;
  info.allocationSize = needs.size;
  info.memoryTypeIndex = *type;
  VkDeviceMemory memory = VK_NULL_HANDLE;
  check(context.api.allocate_memory(context.device, &info, nullptr, &memory),
        fmt::format("allocate {} for the {} on '{}'", size_text(needs.size), what,
                    context.info.name));
  memory_ = {context, memory, context.api.free_memory};
  check(context.api.bind_buffer_memory(context.device, buffer_.get(), memory, 0),
        fmt::format("bind the memory of the {}", what));

  const bool wants_mapping = use != Use::shader || context.shares_memory();
  const VkMemoryPropertyFlags flags = context.memory.memoryTypes[*type].propertyFlags;
  if (wants_mapping && (flags & host_reaches) == host_reaches) {
    void* address = nullptr;
    check(context.api.map_memory(context.device, memory, 0, VK_WHOLE_SIZE, 0, &address),
          fmt::format("map the {}", what));
    mapped_ = static_cast<std::byte*>(address);
  }
}

void Buffer::upload(std::span<const std::byte> bytes) {
  assert(bytes.size() <= byte_count_);
  if (bytes.empty()) return;
  if (mapped_ != nullptr) {
    std::memcpy(mapped_, bytes.data(), bytes.size());
    return;
  }
  Buffer staging(*context_, "staging buffer", std::min<uint64_t>(bytes.size(), staging_bytes),
                 Use::staging);
  for (uint64_t offset = 0; offset < bytes.size(); offset += staging_bytes) {
    const uint64_t count = std::min<uint64_t>(bytes.size() - offset, staging_bytes);
    staging.upload(bytes.subspan(offset, count));
    copy_and_wait(*context_, staging.get(), get(), {0, offset, count});
  }
}

void Buffer::download(std::span<std::byte> bytes) const {
  assert(bytes.size() <= byte_count_);
  if (bytes.empty()) return;
  if (mapped_ != nullptr) {
    std::memcpy(bytes.data(), mapped_, bytes.size());
    return;
  }
  const Buffer staging(*context_, "staging buffer", std::min<uint64_t>(bytes.size(), staging_bytes),
                       Use::readback);
  for (uint64_t offset = 0; offset < bytes.size(); offset += staging_bytes) {
    const uint64_t count = std::min<uint64_t>(bytes.size() - offset, staging_bytes);
    copy_and_wait(*context_, get(), staging.get(), {offset, 0, count});
    staging.download(bytes.subspan(offset, count));
  }
}

}  // namespace energyprof::kernels
