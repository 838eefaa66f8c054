// What building over the dragon takes, and what comes out: our builders in their layouts and, where
// Embree is installed, its builders on the same triangles.
//
//   energyprof models fetch dragon
//   build_bench --benchmark_repetitions=5
//   taskset -c 0 build_bench --benchmark_filter=threads:1
//
// Each build is made once before it is timed. Counters of that one: sah, the SAH cost with both
// constants 1; depth, inner nodes on the longest path; mib, of nodes and references; peak_mib, by
// how much the process grew at most, the result included.
#include <benchmark/benchmark.h>
#include <oneapi/tbb/global_control.h>

#include <algorithm>
#include <bit>
#include <fstream>
#include <functional>
#include <glm/vec3.hpp>
#include <optional>
#include <string>
#include <vector>

#include "accel/bvh.h"
#include "accel/grid.h"
#include "accel/kdtree.h"
#include "accel/models.h"
#include "core/gpu_layout.h"

#ifdef ENERGYPROF_EMBREE
#include <embree3/rtcore.h>

#include <memory>

#include "accel/box.h"
#endif

namespace accel = energyprof::accel;
using energyprof::AccelKind;

namespace {

constexpr double bytes_per_mib = 1024.0 * 1024.0;

/// What came out of a build.
struct Outcome {
  std::optional<double> sah;
  std::optional<double> depth;
  std::optional<double> mib;
};

struct NamedBuild {
  std::string name;
  /// Builds; fills in `outcome` unless it is nullptr.
  std::function<void(const accel::Mesh& mesh, int thread_count, Outcome* outcome)> build;
};

const accel::Mesh& dragon() {
  static const accel::Mesh mesh = accel::load_model("dragon", [](std::string_view) {}).mesh;
  return mesh;
}

double half_area(glm::dvec3 d) { return d.x * d.y + d.y * d.z + d.z * d.x; }

/// SAH cost of a BVH with both constants 1, whatever it was built with.
double unit_sah(const energyprof::AccelBlob& blob) {
  const auto* nodes = reinterpret_cast<const energyprof::gpu::BvhNode*>(blob.nodes.data());
  const auto area = [&](size_t i) {
    return half_area(glm::dvec3(nodes[i].max_link) - glm::dvec3(nodes[i].min_link));
  };
  double sum = 0.0;
  for (size_t i = 0; i < blob.nodes.size() / sizeof *nodes; ++i) {
    const bool is_leaf = std::bit_cast<int32_t>(nodes[i].min_link.w) >= 0;
    sum += area(i) * (is_leaf ? std::bit_cast<int32_t>(nodes[i].max_link.w) : 1);
  }
  return sum / area(0);
}

NamedBuild bvh(std::string name, const accel::BvhConfig& config, AccelKind layout) {
  return {std::move(name), [config, layout](const accel::Mesh& mesh, int, Outcome* outcome) {
            const accel::Built built = accel::build_bvh(mesh, config, layout);
            if (outcome == nullptr) return;
            outcome->sah = unit_sah(built.blob);
            outcome->depth = static_cast<double>(built.stats.max_depth);
            outcome->mib = static_cast<double>(built.blob.byte_count()) / bytes_per_mib;
          }};
}

/// SAH cost with the builder's own constants, which are 1 in all but the paper's tree.
NamedBuild kdtree(std::string name, const accel::KdTreeConfig& config) {
  return {std::move(name), [config](const accel::Mesh& mesh, int, Outcome* outcome) {
            const accel::Built built = accel::build_kdtree(mesh, config);
            if (outcome == nullptr) return;
            outcome->sah = built.stats.sah_cost;
            outcome->depth = static_cast<double>(built.stats.max_depth);
            outcome->mib = static_cast<double>(built.blob.byte_count()) / bytes_per_mib;
          }};
}

NamedBuild grid(std::string name, const accel::GridConfig& config) {
  return {std::move(name), [config](const accel::Mesh& mesh, int, Outcome* outcome) {
            const accel::Built built = accel::build_grid(mesh, config);
            if (outcome == nullptr) return;
            outcome->mib = static_cast<double>(built.blob.byte_count()) / bytes_per_mib;
          }};
}

#ifdef ENERGYPROF_EMBREE

/// Embree's general builder, two children a node and leaves of up to four, which only calls us back
/// for nodes. The leanest nodes that can be checked afterwards: boxes and pointers.
class EmbreeTree {
 public:
  EmbreeTree(const accel::Mesh& mesh, int thread_count)
      : device_(rtcNewDevice(("threads=" + std::to_string(thread_count)).c_str())),
        bvh_(rtcNewBVH(device_)) {
    primitives_.resize(mesh.triangles.size());
    for (size_t i = 0; i < primitives_.size(); ++i) {
      const accel::Box box = accel::triangle_box(mesh, i, 0.0f);
      primitives_[i] = {box.min.x, box.min.y, box.min.z, 0,
                        box.max.x, box.max.y, box.max.z, static_cast<unsigned>(i)};
    }
    RTCBuildArguments arguments = rtcDefaultBuildArguments();
    arguments.maxBranchingFactor = 2;
    arguments.maxLeafSize = 4;
    arguments.maxDepth = 120;
    arguments.bvh = bvh_;
    arguments.primitives = primitives_.data();
    arguments.primitiveCount = primitives_.size();
    arguments.primitiveArrayCapacity = primitives_.size();
    arguments.createNode = [](RTCThreadLocalAllocator allocator, unsigned, void*) -> void* {
      return new (rtcThreadLocalAlloc(allocator, sizeof(Node), 16)) Node;
    };
    arguments.setNodeChildren = [](void* node, void** children, unsigned, void*) {
      for (int i = 0; i < 2; ++i)
        static_cast<Node*>(node)->children[i] = static_cast<Node*>(children[i]);
    };
    arguments.setNodeBounds = [](void* node, const RTCBounds** bounds, unsigned, void*) {
      for (int i = 0; i < 2; ++i) static_cast<Node*>(node)->bounds[i] = *bounds[i];
    };
    arguments.createLeaf = [](RTCThreadLocalAllocator allocator,
                              const RTCBuildPrimitive* primitives, size_t count, void*) -> void* {
      Node* leaf = new (rtcThreadLocalAlloc(allocator, sizeof(Node), 16)) Node;
      leaf->triangle_count = count;
      for (size_t i = 0; i < count && i < 4; ++i) leaf->triangles[i] = primitives[i].primID;
      return leaf;
    };
    root_ = static_cast<const Node*>(rtcBuildBVH(&arguments));
  }
  EmbreeTree(const EmbreeTree&) = delete;
  EmbreeTree& operator=(const EmbreeTree&) = delete;
  ~EmbreeTree() {
    rtcReleaseBVH(bvh_);
    rtcReleaseDevice(device_);
  }

  [[nodiscard]] double unit_sah() const {
    const auto area = [](const RTCBounds& b) {
      return half_area({b.upper_x - b.lower_x, b.upper_y - b.lower_y, b.upper_z - b.lower_z});
    };
    RTCBounds all = root_->bounds[0];
    const RTCBounds& other = root_->bounds[1];
    all.lower_x = std::min(all.lower_x, other.lower_x);
    all.lower_y = std::min(all.lower_y, other.lower_y);
    all.lower_z = std::min(all.lower_z, other.lower_z);
    all.upper_x = std::max(all.upper_x, other.upper_x);
    all.upper_y = std::max(all.upper_y, other.upper_y);
    all.upper_z = std::max(all.upper_z, other.upper_z);
    double sum = area(all);
    std::vector<const Node*> inner{root_};
    while (!inner.empty()) {
      const Node* node = inner.back();
      inner.pop_back();
      for (int i = 0; i < 2; ++i) {
        const Node* child = node->children[i];
        const bool is_leaf = child->triangle_count > 0;
        sum += area(node->bounds[i]) * (is_leaf ? static_cast<double>(child->triangle_count) : 1.0);
        if (!is_leaf) inner.push_back(child);
      }
    }
    return sum / area(all);
  }

 private:
  struct Node {
    size_t triangle_count = 0;  // 0: an inner node
    union {
      Node* children[2];
      unsigned triangles[4];
    };
    RTCBounds bounds[2];
  };

  RTCDevice device_;
  RTCBVH bvh_;
  std::vector<RTCBuildPrimitive> primitives_;
  const Node* root_;
};

NamedBuild embree_tree() {
  return {"embree rtcBuildBVH medium, branching 2",
          [](const accel::Mesh& mesh, int thread_count, Outcome* outcome) {
            const EmbreeTree tree(mesh, thread_count);
            if (outcome != nullptr) outcome->sah = tree.unit_sah();
          }};
}

/// Embree's own scene, as its users get it: a BVH of eight children a node.
NamedBuild embree_scene() {
  return {"embree scene medium", [](const accel::Mesh& mesh, int thread_count, Outcome*) {
            RTCDevice device = rtcNewDevice(("threads=" + std::to_string(thread_count)).c_str());
            RTCScene scene = rtcNewScene(device);
            RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
            // Embree reads 16 bytes at each vertex: the last one is why it gets a copy.
            auto* positions = static_cast<glm::vec3*>(
                rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                        sizeof(glm::vec3), mesh.positions.size()));
            std::copy(mesh.positions.begin(), mesh.positions.end(), positions);
            rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                       mesh.triangles.data(), 0, sizeof(glm::uvec3),
                                       mesh.triangles.size());
            rtcCommitGeometry(geometry);
            rtcAttachGeometry(scene, geometry);
            rtcReleaseGeometry(geometry);
            rtcCommitScene(scene);
            rtcReleaseScene(scene);
            rtcReleaseDevice(device);
          }};
}

#endif

std::vector<NamedBuild> named_builds() {
  accel::BvhConfig swept = accel::tuned_bvh();
  swept.method = accel::BvhConfig::Method::sweep;
  accel::KdTreeConfig like_peers = accel::tuned_kdtree();
  like_peers.keep_touching = false;
  return {
      bvh("bvh paper, depth first", {}, AccelKind::bvh_depth_first),
      bvh("bvh paper, breadth first", {}, AccelKind::bvh_breadth_first),
      bvh("bvh paper, miss links", {}, AccelKind::bvh_miss_links),
      bvh("bvh tuned, depth first", accel::tuned_bvh(), AccelKind::bvh_depth_first),
      bvh("bvh tuned, breadth first", accel::tuned_bvh(), AccelKind::bvh_breadth_first),
      bvh("bvh tuned, miss links", accel::tuned_bvh(), AccelKind::bvh_miss_links),
      bvh("bvh swept, depth first", swept, AccelKind::bvh_depth_first),
      kdtree("kd-tree paper", {}),
      kdtree("kd-tree tuned", accel::tuned_kdtree()),
      kdtree("kd-tree tuned, not keep_touching", like_peers),
      grid("grid paper", {}),
      grid("grid tuned", accel::tuned_grid()),
#ifdef ENERGYPROF_EMBREE
      embree_tree(),
      embree_scene(),
#endif
  };
}

/// A line of /proc/self/status in MiB: "VmRSS", what the process holds; "VmHWM", the most it held.
double status_mib(const std::string& name) {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);)
    if (line.starts_with(name + ":")) return std::stod(line.substr(name.size() + 1)) / 1024.0;
  return 0.0;
}

/// By how much the process grows at most while `build` runs.
template <class Build>
double peak_mib(Build&& build) {
  std::ofstream("/proc/self/clear_refs") << 5;  // forgets VmHWM
  const double before_mib = status_mib("VmRSS");
  build();
  return status_mib("VmHWM") - before_mib;
}

void run(benchmark::State& state, const NamedBuild& named) {
  if (!accel::is_available(*accel::find_model("dragon"))) {
    state.SkipWithError("the dragon is not in the cache: energyprof models fetch dragon");
    return;
  }
  const auto thread_count = static_cast<int>(state.range(0));
  const oneapi::tbb::global_control threads(oneapi::tbb::global_control::max_allowed_parallelism,
                                            static_cast<size_t>(thread_count));
  const accel::Mesh& mesh = dragon();

  Outcome outcome;
  state.counters["peak_mib"] = peak_mib([&] { named.build(mesh, thread_count, &outcome); });
  if (outcome.sah) state.counters["sah"] = *outcome.sah;
  if (outcome.depth) state.counters["depth"] = *outcome.depth;
  if (outcome.mib) state.counters["mib"] = *outcome.mib;

  for (auto _ : state) named.build(mesh, thread_count, nullptr);
}

}  // namespace

int main(int argc, char** argv) {
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 1;
  for (const NamedBuild& named : named_builds())
    benchmark::RegisterBenchmark(named.name.c_str(),
                                 [named](benchmark::State& state) { run(state, named); })
        ->ArgName("threads")
        ->Arg(1)
        ->Arg(2)
        ->Unit(benchmark::kMillisecond)
        ->UseRealTime()
        ->MeasureProcessCPUTime();
  benchmark::RunSpecifiedBenchmarks();
}
