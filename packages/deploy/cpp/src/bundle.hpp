// What manifest.json says; see bundle.schema.json of legged-deploy.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

namespace legged {

struct Joint {
  std::string name;
  double stance, target_offset;  // rad
  double kp, kd;                 // N m/rad, N m s/rad
  double torque_limit;           // N m
  double lower, upper;           // rad
};

struct Term {
  std::string source;
  std::vector<double> scale;  // one factor per element
};

struct Tensor {
  std::string name;
  std::vector<long> shape;
};

// A recurrent state: `output` is fed back to `input`.
struct RecurrentState {
  std::string input, output;
  std::vector<long> shape;
};

struct Graph {
  std::string file;  // TorchScript
  std::vector<Tensor> inputs, outputs;
  std::vector<RecurrentState> state;
};

struct Intrinsics {
  double fx, fy, cx, cy;  // px; pixel (i, j) looks through (j + 0.5, i + 0.5)
};

struct DepthOptics {
  long rows, columns;
  Intrinsics intrinsics;  // of the cropped and resized image
  double near, far;       // m
  long raw_rows, raw_columns, crop_bottom, crop_sides;
};

struct Depth {
  Graph graph;
  long period_ticks, latency_ticks;
  DepthOptics optics;
};

struct Bundle {
  std::string root, name;
  std::vector<Joint> joints;  // in policy order
  std::vector<std::string> feet;
  double action_scale;
  std::optional<double> action_clip;
  double policy_hz;
  std::vector<Term> terms;
  Graph policy;
  std::optional<Depth> depth;
  std::string golden;
  long golden_ticks;
  double golden_atol;

  // Throws std::runtime_error that names the file and the element. The schema and the hashes of the files are
  // checked by `deploy doctor`, not here.
  static Bundle load(const std::string& root);

  std::string path(const std::string& file) const { return root + "/" + file; }
};

}  // namespace legged
