// Creates layouts, descriptor sets and pipelines.
#include "kernels/pipeline.h"

#include <fmt/format.h>

#include <cstddef>

#include "core/gpu_layout.h"

namespace energyprof::kernels {

PipelineLayout::PipelineLayout(Context& context) {
  std::array<VkDescriptorSetLayoutBinding, binding_count> bindings{};
  for (uint32_t i = 0; i < binding_count; ++i) {
    bindings[i].binding = i;
    bindings[i].descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_BUFFER;
    bindings[i].descriptorCount = 1;
    bindings[i].stageFlags = VK_SHADER_STAGE_COMPUTE_BIT;
  }
  VkDescriptorSetLayoutCreateInfo set_info{};
  set_info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO;
  set_info.bindingCount = binding_count;
  set_info.pBindings = bindings.data();
  VkDescriptorSetLayout set_layout = VK_NULL_HANDLE;
  check(context.api.create_descriptor_set_layout(context.device, &set_info, nullptr, &set_layout),
        "create a descriptor set layout");
  set_layout_ = {context, set_layout, context.api.destroy_descriptor_set_layout};

  // 128 bytes is what every device has.
  const VkPushConstantRange range{VK_SHADER_STAGE_COMPUTE_BIT, 0, sizeof(gpu::FrameConstants)};
  VkPipelineLayoutCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO;
  info.setLayoutCount = 1;
  info.pSetLayouts = &set_layout;
  info.pushConstantRangeCount = 1;
  info.pPushConstantRanges = &range;
  VkPipelineLayout layout = VK_NULL_HANDLE;
  check(context.api.create_pipeline_layout(context.device, &info, nullptr, &layout),
        "create a pipeline layout");
  layout_ = {context, layout, context.api.destroy_pipeline_layout};
}

DescriptorSet::DescriptorSet(Context& context, const PipelineLayout& layout,
                             const std::array<const Buffer*, binding_count>& buffers) {
  const VkDescriptorPoolSize size{VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, binding_count};
  VkDescriptorPoolCreateInfo pool_info{};
  pool_info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO;
  pool_info.maxSets = 1;
  pool_info.poolSizeCount = 1;
  pool_info.pPoolSizes = &size;
  VkDescriptorPool pool = VK_NULL_HANDLE;
  check(context.api.create_descriptor_pool(context.device, &pool_info, nullptr, &pool),
        "create a descriptor pool");
  pool_ = {context, pool, context.api.destroy_descriptor_pool};

  const VkDescriptorSetLayout set_layout = layout.set_layout();
  VkDescriptorSetAllocateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO;
  info.descriptorPool = pool;
  info.descriptorSetCount = 1;
  info.pSetLayouts = &set_layout;
  check(context.api.allocate_descriptor_sets(context.device, &info, &set_),
        "allocate a descriptor set");

  std::array<VkDescriptorBufferInfo, binding_count> infos{};
  std::array<VkWriteDescriptorSet, binding_count> writes{};
  for (uint32_t i = 0; i < binding_count; ++i) {
    infos[i] = {buffers[i]->get(), 0, VK_WHOLE_SIZE};
    writes[i].sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET;
    writes[i].dstSet = set_;
    writes[i].dstBinding = i;
    writes[i].descriptorCount = 1;
    writes[i].descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_BUFFER;
    writes[i].pBufferInfo = &infos[i];
  }
  context.api.update_descriptor_sets(context.device, binding_count, writes.data(), 0, nullptr);
}

Owned<VkPipeline> make_pipeline(Context& context, const PipelineLayout& layout,
                                std::string_view name, std::string_view spirv,
                                const Specialization& constants) {
  VkShaderModuleCreateInfo module_info{};
  module_info.sType = VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO;
  module_info.codeSize = spirv.size();
  // Embedded files are 16-byte aligned.
  module_info.pCode = reinterpret_cast<const uint32_t*>(spirv.data());
  VkShaderModule module = VK_NULL_HANDLE;
  check(context.api.create_shader_module(context.device, &module_info, nullptr, &module),
        fmt::format("load the shader of {}", name));
  const Owned<VkShaderModule> owned_module(context, module, context.api.destroy_shader_module);

  const std::array<VkSpecializationMapEntry, 6> entries{{
      {0, offsetof(Specialization, local_x), sizeof constants.local_x},
      {1, offsetof(Specialization, local_y), sizeof constants.local_y},
      {2, offsetof(Specialization, count_work), sizeof constants.count_work},
      {3, offsetof(Specialization, stack_size), sizeof constants.stack_size},
      {4, offsetof(Specialization, has_refs), sizeof constants.has_refs},
      {5, offsetof(Specialization, row_interleave), sizeof constants.row_interleave},
  }};
  const VkSpecializationInfo specialization{static_cast<uint32_t>(entries.size()), entries.data(),
                                            sizeof constants, &constants};
  VkComputePipelineCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO;
  info.stage.sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO;
  info.stage.stage = VK_SHADER_STAGE_COMPUTE_BIT;
  info.stage.module = module;
  info.stage.pName = "main";
  info.stage.pSpecializationInfo = &specialization;
  info.layout = layout.get();
  VkPipeline pipeline = VK_NULL_HANDLE;
  check(context.api.create_compute_pipelines(context.device, VK_NULL_HANDLE, 1, &info, nullptr,
                                             &pipeline),
        fmt::format("compile the shader of {} on '{}'", name, context.info.name));
  return {context, pipeline, context.api.destroy_pipeline};
}

}  // namespace energyprof::kernels
