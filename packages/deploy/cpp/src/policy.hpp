// A policy tick: observation, networks, action rule.
#pragma once

#include <deque>
#include <memory>
#include <optional>
#include <vector>

#include "bundle.hpp"
#include "network.hpp"
#include "observation.hpp"

namespace legged {

struct PolicyStep {
  std::vector<float> obs;                // (P,)
  std::vector<float> terrain, heading;   // in use, of a policy that sees
  std::vector<float> velocity;           // estimated base velocity, base frame, m/s; empty without an estimator
  std::vector<double> action;            // as the network gave it
  std::vector<double> target;            // joint targets, rad, order of the bundle; not yet cut to joint limits
};

class Policy {
 public:
  explicit Policy(Bundle bundle);

  const Bundle& bundle() const { return bundle_; }

  // Forgets previous action, recurrent states and what was seen; the next step is tick 0.
  void reset();

  // Whether the next step takes an image in.
  bool image_due() const { return bundle_.depth && tick_ % bundle_.depth->period_ticks == 0; }

  // Advances one tick. `image` is read where one is due: rows * columns values from -0.5 (near) to 0.5 (far), as
  // `DepthPreprocessor` gives them.
  PolicyStep step(const RobotState& state, const std::vector<float>& image = {});

 private:
  struct Seen {
    long from_tick;
    std::vector<float> terrain, heading;
  };

  void see(const std::vector<float>& image, const std::vector<float>& obs);

  Bundle bundle_;
  Network policy_;
  std::optional<Network> depth_;
  std::vector<double> last_action_;
  std::deque<Seen> under_way_;
  Seen in_use_;
  long tick_ = 0;
};

}  // namespace legged
