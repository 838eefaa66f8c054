/// Compute pipelines of this folder: all share one set of seven storage buffers and 128 bytes of
/// push constants.
#pragma once

#include <array>
#include <string_view>

#include "kernels/buffer.h"
#include "kernels/context.h"

namespace energyprof::kernels {

/// Bindings 0..6 of every shader: nodes, refs, triangles, hits, counts, partials, lanes.
inline constexpr uint32_t binding_count = 7;

/// What all pipelines of one TraceProgram share.
class PipelineLayout {
 public:
  explicit PipelineLayout(Context& context);

  [[nodiscard]] VkDescriptorSetLayout set_layout() const { return set_layout_.get(); }
  [[nodiscard]] VkPipelineLayout get() const { return layout_.get(); }

 private:
  Owned<VkDescriptorSetLayout> set_layout_;
  Owned<VkPipelineLayout> layout_;
};

/// The buffers of one TraceProgram, bound in order.
class DescriptorSet {
 public:
  DescriptorSet(Context& context, const PipelineLayout& layout,
                const std::array<const Buffer*, binding_count>& buffers);

  [[nodiscard]] VkDescriptorSet get() const { return set_; }

 private:
  Owned<VkDescriptorPool> pool_;
  VkDescriptorSet set_ = VK_NULL_HANDLE;
};

/// The specialization constants of shaders/scene.glsl, by constant_id.
struct Specialization {
  uint32_t local_x = 8;
  uint32_t local_y = 8;
  VkBool32 count_work = VK_FALSE;
  uint32_t stack_size = 0;
  VkBool32 has_refs = VK_FALSE;
  uint32_t row_interleave = 1;
};

/// `name` is for errors. Constants a shader does not have are ignored.
Owned<VkPipeline> make_pipeline(Context& context, const PipelineLayout& layout,
                                std::string_view name, std::string_view spirv,
                                const Specialization& constants);

}  // namespace energyprof::kernels
