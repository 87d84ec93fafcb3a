#include "observation.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace legged {
namespace {

using Values = std::vector<double>;

Values source(const std::string& name, const Bundle& bundle, const RobotState& state, const Values& last_action) {
  if (name == "base_angular_velocity") return {state.gyro.begin(), state.gyro.end()};
  if (name == "command") return {state.command.begin(), state.command.end()};
  if (name == "commanded_speed") return {state.command[0]};
  if (name == "joint_velocity") return state.dq;
  if (name == "last_action") return last_action;
  if (name == "heading_error" || name == "next_heading_error") return {0.0};  // the policy predicts its own
  if (name == "joint_position_error") {
    Values error(state.q);
    for (std::size_t j = 0; j < error.size(); ++j) error[j] -= bundle.joints[j].stance;
    return error;
  }
  if (name == "foot_contact") {
    if (state.contact.size() != bundle.feet.size())
      throw std::runtime_error("observation: the policy feels its feet, the state has no contacts");
    Values contact(bundle.feet.size(), -0.5);
    for (std::size_t foot = 0; foot < state.contact.size(); ++foot) contact[foot] += state.contact[foot];
    return contact;
  }
  const std::array<double, 3> down = projected_gravity(state.quat_wxyz);
  if (name == "projected_gravity") return {down.begin(), down.end()};
  if (name == "roll_pitch")
    return {std::atan2(-down[1], -down[2]), std::asin(std::clamp(down[0], -1.0, 1.0))};
  throw std::runtime_error("observation: this runner cannot give " + name);
}

}  // namespace

std::array<double, 3> projected_gravity(const std::array<double, 4>& quat_wxyz) {
  double length = 0.0;
  for (const double part : quat_wxyz) length += part * part;
  length = std::sqrt(length);
  const double w = quat_wxyz[0] / length, x = quat_wxyz[1] / length;
  const double y = quat_wxyz[2] / length, z = quat_wxyz[3] / length;
  return {2.0 * (w * y - x * z), -2.0 * (y * z + w * x), 2.0 * (x * x + y * y) - 1.0};
}

std::vector<float> observe(const Bundle& bundle, const RobotState& state, const Values& last_action) {
  const std::size_t joints = bundle.joints.size(), feet = state.contact.size();
  if (state.q.size() != joints || state.dq.size() != joints || (feet != 0 && feet != bundle.feet.size()))
    throw std::runtime_error("observation: the state has not the joints and feet of the bundle");
  std::vector<float> obs;
  for (const Term& term : bundle.terms) {
    const Values raw = source(term.source, bundle, state, last_action);
    if (raw.size() != term.scale.size())
      throw std::runtime_error("observation: " + term.source + " has another size than in the manifest");
    for (std::size_t i = 0; i < raw.size(); ++i) {
      obs.push_back(static_cast<float>(term.scale[i] * raw[i]));
      if (!std::isfinite(obs.back()))
        throw std::runtime_error("observation: " + term.source + " is not finite; damp the robot and check its sensors");
    }
  }
  return obs;
}

}  // namespace legged
