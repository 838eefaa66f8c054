#include "app/structure_parameters.h"

#include <fmt/format.h>

namespace energyprof::app {
namespace {

using nlohmann::json;

/// The shortest decimal that is this float: 0.2, not 0.20000000298023224.
json number(float value) { return json::parse(fmt::format("{}", value)); }

bool is_tuned(const json& block) { return block.value("preset", "paper") == "tuned"; }

/// Overrides `value` where the config says so.
template <class T>
void read(const json& block, const char* key, T& value) {
  if (const auto found = block.find(key); found != block.end()) found->get_to(value);
}

accel::BvhConfig read_bvh(const json& block) {
  accel::BvhConfig config = is_tuned(block) ? accel::tuned_bvh() : accel::BvhConfig{};
  using Method = accel::BvhConfig::Method;
  if (block.contains("method"))
    config.method = block.at("method") == "sweep" ? Method::sweep : Method::binned;
  if (block.contains("axes")) config.all_axes = block.at("axes") == "all";
  read(block, "buckets", config.bucket_count);
  read(block, "max_leaf_size", config.max_leaf_size);
  read(block, "traverse_cost", config.traverse_cost);
  read(block, "intersect_cost", config.intersect_cost);
  read(block, "middle_split_count", config.middle_split_count);
  return config;
}

accel::KdTreeConfig read_kdtree(const json& block) {
  accel::KdTreeConfig config = is_tuned(block) ? accel::tuned_kdtree() : accel::KdTreeConfig{};
  read(block, "max_leaf_size", config.max_leaf_size);
  read(block, "traverse_cost", config.traverse_cost);
  read(block, "intersect_cost", config.intersect_cost);
  read(block, "empty_bonus", config.empty_bonus);
  read(block, "bad_refinements", config.bad_refinement_count);
  read(block, "max_depth", config.max_depth);
  read(block, "clip", config.clip);
  read(block, "keep_touching", config.keep_touching);
  return config;
}

accel::GridConfig read_grid(const json& block) {
  accel::GridConfig config = is_tuned(block) ? accel::tuned_grid() : accel::GridConfig{};
  read(block, "lambda", config.lambda);
  read(block, "exact_overlap", config.exact_overlap);
  return config;
}

json describe(const accel::BvhConfig& config) {
  return {{"method", config.method == accel::BvhConfig::Method::sweep ? "sweep" : "binned"},
          {"buckets", config.bucket_count},
          {"axes", config.all_axes ? "all" : "longest"},
          {"max_leaf_size", config.max_leaf_size},
          {"traverse_cost", number(config.traverse_cost)},
          {"intersect_cost", number(config.intersect_cost)},
          {"middle_split_count", config.middle_split_count}};
}

json describe(const accel::KdTreeConfig& config) {
  return {{"max_leaf_size", config.max_leaf_size},
          {"traverse_cost", number(config.traverse_cost)},
          {"intersect_cost", number(config.intersect_cost)},
          {"empty_bonus", number(config.empty_bonus)},
          {"bad_refinements", config.bad_refinement_count},
          {"max_depth", config.max_depth},
          {"clip", config.clip},
          {"keep_touching", config.keep_touching}};
}

json describe(const accel::GridConfig& config) {
  return {{"lambda", number(config.lambda)}, {"exact_overlap", config.exact_overlap}};
}

}  // namespace

accel::StructureConfig read_structure_parameters(const json& structures) {
  const auto block = [&](const char* key) { return structures.value(key, json::object()); };
  return {read_bvh(block("bvh")), read_kdtree(block("kdtree")), read_grid(block("grid"))};
}

std::string builder_name(AccelKind kind) {
  switch (kind) {
    case AccelKind::kd_tree:
      return "kdtree";
    case AccelKind::grid:
      return "grid";
    default:
      return "bvh";
  }
}

json describe_parameters(const accel::StructureConfig& parameters, AccelKind kind) {
  switch (kind) {
    case AccelKind::kd_tree:
      return describe(parameters.kdtree);
    case AccelKind::grid:
      return describe(parameters.grid);
    default:
      return describe(parameters.bvh);
  }
}

}  // namespace energyprof::app
