/// What explains, across cells, how long frames take and what they cost.
#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "analysis/stats.h"

namespace energyprof::analysis {

/// One cell: what it took, and what may explain it. All but what is marked is positive.
struct FactorCell {
  std::optional<double> time;                ///< per ray
  std::optional<double> energy;              ///< per ray, net of idle
  std::vector<std::optional<double>> value;  ///< by factor
};

struct FactorName {
  std::string name;
  bool as_is = false;  ///< taken as it is, not its logarithm: temperatures
};

/// What one factor explains.
struct Factor {
  std::string name;
  std::optional<double> share_of_time_variance;
  std::optional<Interval> time_interval;  ///< 95 %
  std::optional<double> share_of_energy_variance;
  std::optional<Interval> energy_interval;  ///< 95 %
  /// 1 / (1 - R^2) of this factor on the others: 1 is independent of them, beyond 10 it cannot be
  /// told from them. Absent for a factor that is not in the model.
  std::optional<double> variance_inflation;
  std::string note;  ///< why there is no number, or why not to trust it; empty: all is well
};

struct FactorReport {
  std::vector<Factor> factors;                 ///< in the order given
  std::size_t cell_count = 0;                  ///< that the model rests on
  std::optional<double> explained_time_ratio;  ///< R^2: the shares add up to it
  std::optional<double> explained_energy_ratio;
  std::vector<std::string> notes;
};

struct FactorConfig {
  std::size_t spare_cell_count = 4;  ///< cells needed beyond one per factor
  double max_variance_inflation = 10;
};

/// Fits log time and log energy as a linear model of the factors and splits R^2 between them: each
/// factor's share is what adding it explains, averaged over all orders in which the factors can be
/// added. See "Introduction to Bivariate and Multivariate Analysis", by R. Lindeman, P. Merenda and
/// R. Gold, Scott Foresman 1980; "Relative Importance for Linear Regression in R", by U. Grömping,
/// Journal of Statistical Software 17(1), 2006.
///
/// Factors that are unknown or the same everywhere are not in the model, and say so. At most 12
/// are.
FactorReport explain(std::span<const FactorName> names, std::span<const FactorCell> cells,
                     const FactorConfig& config = {});

}  // namespace energyprof::analysis
