/// Storage buffers in the memory that suits the device, and copies to and from them.
#pragma once

#include <cstddef>
#include <span>
#include <string_view>

#include "kernels/context.h"

namespace energyprof::kernels {

/// A storage buffer with memory of its own.
///
/// On integrated and CPU devices it lies in memory both sides reach and is mapped; elsewhere it is
/// local to the device and upload() and download() go through a staging buffer.
class Buffer {
 public:
  enum class Use : uint8_t {
    shader,    ///< read and written by shaders; the host copies rarely
    staging,   ///< the host writes it, the device copies from it
    readback,  ///< the host reads it, and does so often: in host memory, cached if possible
  };

  /// `what` names the buffer in errors: "node buffer". `byte_count` may be 0.
  /// Throws std::runtime_error if the device cannot bind that much, OutOfMemory if it has no room.
  Buffer(Context& context, std::string_view what, uint64_t byte_count, Use use = Use::shader);

  [[nodiscard]] VkBuffer get() const { return buffer_.get(); }
  [[nodiscard]] uint64_t byte_count() const { return byte_count_; }

  /// Copies `bytes` to the start of the buffer.
  void upload(std::span<const std::byte> bytes);
  /// Copies the start of the buffer to `bytes`; the device must be done writing it.
  void download(std::span<std::byte> bytes) const;

 private:
  void allocate(std::string_view what, Use use);

  Context* context_;
  uint64_t byte_count_;
  // Declared in this order: the buffer goes before the memory it is bound to.
  Owned<VkDeviceMemory> memory_;
  Owned<VkBuffer> buffer_;
  std::byte* mapped_ = nullptr;  ///< null: the host does not reach it
};

}  // namespace energyprof::kernels
