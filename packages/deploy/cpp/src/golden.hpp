// Replays the recorded trace of a bundle.
#pragma once

#include "policy.hpp"

namespace legged {

// Prints the largest differences. Returns whether all are within the tolerance of the manifest; throws
// std::runtime_error where the trace cannot be read.
bool check_golden(Policy& policy);

}  // namespace legged
