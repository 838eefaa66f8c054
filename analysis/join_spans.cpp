#include "analysis/join_spans.h"

#include <algorithm>

namespace energyprof::analysis {

std::pair<std::vector<Span>, int64_t> join_spans(const std::vector<Span>& spans, std::size_t most) {
  if (spans.size() <= most) return {spans, 0};
  std::vector<int64_t> gaps_ns;
  for (std::size_t i = 1; i < spans.size(); ++i)
    gaps_ns.push_back(spans[i].begin_ns - spans[i - 1].end_ns);
  const auto closed = gaps_ns.begin() + static_cast<std::ptrdiff_t>(gaps_ns.size() - most);
  std::nth_element(gaps_ns.begin(), closed, gaps_ns.end());
  std::vector<Span> joined{spans.front()};
  for (std::size_t i = 1; i < spans.size(); ++i)
    if (spans[i].begin_ns - joined.back().end_ns <= *closed)
      joined.back().end_ns = spans[i].end_ns;
    else
      joined.push_back(spans[i]);
  return {std::move(joined), *closed};
}

}  // namespace energyprof::analysis
