"""What the reward terms see of the robots after one control step."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass
class StepState:
    """N robots after one control step; vectors are in the base frame unless said otherwise.

    What a task does not measure is zero: one constant tensor, made once, costs nothing at a step, because a term
    of weight 0 is never computed.

    Attributes:
        velocity: linear velocity of the base, (N, 3), m/s.
        rate: angular velocity of the base, (N, 3), rad/s.
        command: vx, vy (m/s) and yaw rate (rad/s), (N, 3); on a course the velocity points to the next waypoint.
        q_error: joint positions minus the stance, (N, 12), rad; each leg's first joint is its hip.
        joint_acceleration: (N, 12), rad/s^2, finite difference over the control period.
        action: this action, (N, 12).
        last_action: the one before.
        torque: (N, 12), N m.
        last_torque: one control step earlier.
        landed_air_time: seconds that a foot was in the air before it touched down in this step, (N, 4).
        landed: feet that touched down in this step, (N, 4), 0 or 1.
        colliding_links: number of links other than feet that touch something, (N,).
        specific_power: positive mechanical power over the weight, (N,), m/s.
        velocity_world: linear velocity of the base, world frame, (N, 3), m/s.
        goal_direction: unit vector from the base to the next waypoint, world frame, (N, 3); zeros without one.
        heading_error: yaw towards the goal minus the base's yaw, (N,), rad in [-pi, pi].
        gravity: unit vector of gravity, (N, 3); (0, 0, -1) on an upright base.
        edge_feet: feet in contact within 5 cm of an edge, (N, 4), 0 or 1.
        foot_speed: horizontal speed of each foot, (N, 4), m/s.
        foot_rise: height of each foot above where it last stood, (N, 4), m, at least 0.
        foot_force: net contact force on each foot, world frame, (N, 4, 3), N; zeros without force sensors.
    """

    velocity: Tensor
    rate: Tensor
    command: Tensor
    q_error: Tensor
    joint_acceleration: Tensor
    action: Tensor
    last_action: Tensor
    torque: Tensor
    last_torque: Tensor
    landed_air_time: Tensor
    landed: Tensor
    colliding_links: Tensor
    specific_power: Tensor
    velocity_world: Tensor
    goal_direction: Tensor
    heading_error: Tensor
    gravity: Tensor
    edge_feet: Tensor
    foot_speed: Tensor
    foot_rise: Tensor
    foot_force: Tensor
