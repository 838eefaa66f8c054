#include "core/record.h"

namespace energyprof {

std::string_view to_string(Phase phase) {
  switch (phase) {
    case Phase::warmup:
      return "warmup";
    case Phase::timed:
      return "timed";
    case Phase::counted:
      return "counted";
  }
  return "timed";
}

std::string_view to_string(Severity severity) {
  switch (severity) {
    case Severity::info:
      return "info";
    case Severity::warning:
      return "warning";
    case Severity::error:
      return "error";
  }
  return "info";
}

}  // namespace energyprof
