/// Collects what validate() finds, and the checks of each structure.
#pragma once

#include <fmt/format.h>

#include <string>
#include <utility>
#include <vector>

#include "accel/mesh.h"
#include "core/accel_blob.h"

namespace energyprof::accel {

/// Violations in words; after the 20th only counted.
class Violations {
 public:
  template <class... Args>
  void report(fmt::format_string<Args...> text, Args&&... args) {
    if (++count_ <= max_listed_count)
      listed_.push_back(fmt::format(text, std::forward<Args>(args)...));
  }
  [[nodiscard]] bool empty() const { return count_ == 0; }
  [[nodiscard]] std::vector<std::string> take() {
    if (count_ > max_listed_count)
      listed_.push_back(fmt::format("... {} violations in all", count_));
    return std::move(listed_);
  }

 private:
  static constexpr size_t max_listed_count = 20;
  std::vector<std::string> listed_;
  size_t count_ = 0;
};

/// validate() for each family of structures. Byte counts are whole numbers of nodes already.
void validate_bvh(const AccelBlob& blob, const Mesh& mesh, Violations& violations);
void validate_kdtree(const AccelBlob& blob, const Mesh& mesh, Violations& violations);
void validate_grid(const AccelBlob& blob, const Mesh& mesh, Violations& violations);

}  // namespace energyprof::accel
