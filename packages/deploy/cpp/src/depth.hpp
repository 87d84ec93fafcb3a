// From a depth frame to what the network reads; the same as deploy/depth in Python, pixel by pixel.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "bundle.hpp"

namespace legged {

struct DepthFrame {
  long height, width;
  std::vector<float> metres;             // row by row; 0 or NaN: no measurement, inf: nothing in sight
  std::optional<Intrinsics> intrinsics;  // none: the field of view of the manifest's sensor
};

struct DepthReading {
  std::vector<float> image;  // rows * columns, from -0.5 (near) to 0.5 (far, or no measurement)
  double measured;           // share of the pixels with a measurement
  std::string fault;         // why the frame shows nothing at all; empty for one that can be used
};

// Throws std::runtime_error where the camera's field of view is not that of the policy.
DepthReading preprocess(const DepthOptics& optics, const DepthFrame& frame);

}  // namespace legged
