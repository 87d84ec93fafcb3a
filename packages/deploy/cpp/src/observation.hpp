// The observation vector, from what a robot's sensors give, by the terms of the manifest.
#pragma once

#include <array>
#include <vector>

#include "bundle.hpp"

namespace legged {

// Joints and feet in the order of the bundle: bind them by name where they are read from the robot.
struct RobotState {
  std::vector<double> q, dq;            // rad, rad/s
  std::array<double, 4> quat_wxyz;      // orientation of the base in the world
  std::array<double, 3> gyro;           // base frame, rad/s
  std::array<double, 3> command;        // vx, vy, yaw rate; base frame, m/s and rad/s
  std::vector<bool> contact;            // feet on the ground; empty: unknown
};

// World down seen from the base, a unit vector.
std::array<double, 3> projected_gravity(const std::array<double, 4>& quat_wxyz);

// `last_action` is the previous action after clipping, zeros at the start. Throws std::runtime_error for a term that
// this runner does not know, for a state of the wrong size, without the contacts that the policy reads, or not finite.
std::vector<float> observe(const Bundle& bundle, const RobotState& state, const std::vector<double>& last_action);

}  // namespace legged
