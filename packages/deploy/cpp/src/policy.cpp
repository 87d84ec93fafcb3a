#include "policy.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

namespace legged {
namespace {

std::size_t width(const Graph& graph, const std::string& output) {
  for (const Tensor& tensor : graph.outputs)
    if (tensor.name == output) return static_cast<std::size_t>(tensor.shape.back());
  throw std::runtime_error("manifest.json: the depth encoder has no output " + output);
}

}  // namespace

Policy::Policy(Bundle bundle) : bundle_(std::move(bundle)), policy_(bundle_, bundle_.policy) {
  if (bundle_.depth) depth_.emplace(bundle_, bundle_.depth->graph);
  reset();
}

void Policy::reset() {
  policy_.reset();
  last_action_.assign(bundle_.joints.size(), 0.0);
  under_way_.clear();
  tick_ = 0;
  if (!depth_) return;
  depth_->reset();
  const Graph& graph = bundle_.depth->graph;
  in_use_ = {0, std::vector<float>(width(graph, "terrain"), 0.0f), std::vector<float>(width(graph, "heading"), 0.0f)};
}

void Policy::see(const std::vector<float>& image, const std::vector<float>& obs) {
  if (image_due()) {
    auto outputs = depth_->run({{"depth", image}, {"obs", obs}});
    for (const char* name : {"terrain", "heading"})
      for (const float value : outputs[name])
        if (!std::isfinite(value)) throw std::runtime_error(std::string("depth encoder: ") + name + " is not finite");
    const long from = tick_ + bundle_.depth->latency_ticks;
    under_way_.push_back({from, std::move(outputs["terrain"]), std::move(outputs["heading"])});
  }
  while (!under_way_.empty() && under_way_.front().from_tick <= tick_) {
    in_use_ = std::move(under_way_.front());
    under_way_.pop_front();
  }
}

PolicyStep Policy::step(const RobotState& state, const std::vector<float>& image) {
  PolicyStep step;
  step.obs = observe(bundle_, state, last_action_);
  std::map<std::string, std::vector<float>> inputs{{"obs", step.obs}};
  if (depth_) {
    see(image, step.obs);
    inputs["terrain"] = step.terrain = in_use_.terrain;
    inputs["heading"] = step.heading = in_use_.heading;
  }
  auto outputs = policy_.run(inputs);
  step.velocity = outputs["velocity"];
  step.action.assign(outputs.at("action").begin(), outputs.at("action").end());
  if (step.action.size() != bundle_.joints.size()) throw std::runtime_error("policy: not one action per joint");
  for (std::size_t j = 0; j < step.action.size(); ++j) {
    const double action = step.action[j];
    if (!std::isfinite(action))
      throw std::runtime_error("policy: the action of " + bundle_.joints[j].name + " is not finite; damp the robot");
    last_action_[j] =
        bundle_.action_clip ? std::clamp(action, -*bundle_.action_clip, *bundle_.action_clip) : action;
    step.target.push_back(bundle_.joints[j].target_offset + bundle_.action_scale * last_action_[j]);
  }
  ++tick_;
  return step;
}

}  // namespace legged
