"""The observation vector, from a robot state and a command, by the terms of the manifest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from deploy.bundles.manifest import Bundle
from deploy.errors import RobotError
from deploy.interfaces import Array, RobotState


def rotate_inverse(quat_wxyz: Array, vector: Array) -> Array:
    """Turn a world vector into the frame whose orientation is `quat_wxyz` (unit), shape (3,)."""
    w, xyz = quat_wxyz[0], quat_wxyz[1:]
    across = 2.0 * np.cross(xyz, vector)
    return vector - w * across + np.cross(xyz, across)


def projected_gravity(quat_wxyz: Array) -> Array:
    """World down seen from the base, unit vector of shape (3,).

    A quaternion that is off unit length by rounding is normalised; guards reject one that is off by more.
    """
    return rotate_inverse(quat_wxyz / np.linalg.norm(quat_wxyz), np.array([0.0, 0.0, -1.0]))


class ObservationBuilder:
    """Concatenates ``scale * source`` for each term, joints in policy order."""

    def __init__(self, bundle: Bundle) -> None:
        self._sources = [term.source for term in bundle.terms]
        self._scale = np.concatenate([np.array(term.scale) for term in bundle.terms])
        self._stance = bundle.per_joint("stance")
        self._feet = len(bundle.robot.feet)
        self._feels_feet = bundle.feels_feet

    def build(self, state: RobotState, command: Array, last_action: Array) -> NDArray[np.float32]:
        """The observation, shape (P,).

        Args:
            state: Robot state with its joints and feet in policy order.
            command: (vx, vy, yaw_rate), base frame, m/s and rad/s.
            last_action: Previous action after clipping, shape (12,); zeros at the start.

        Raises:
            RobotError: The policy reads contacts, and the state has none.
        """
        if self._feels_feet and state.contact is None:
            raise RobotError("a reading without foot contacts, which the policy reads; check the feet's sensors")
        gravity = projected_gravity(state.quat_wxyz)
        contact = np.zeros(self._feet) if state.contact is None else state.contact
        unknown = np.zeros(1)  # a seeing policy predicts its headings and reads zeros
        values = {
            "base_angular_velocity": state.gyro,
            "projected_gravity": gravity,
            "roll_pitch": np.array([np.arctan2(-gravity[1], -gravity[2]), np.arcsin(np.clip(gravity[0], -1.0, 1.0))]),
            "heading_error": unknown,
            "next_heading_error": unknown,
            "commanded_speed": command[:1],
            "foot_contact": contact - 0.5,
            "command": command,
            "joint_position_error": state.q - self._stance,
            "joint_velocity": state.dq,
            "last_action": last_action,
        }
        raw = np.concatenate([values[source] for source in self._sources])
        return (self._scale * raw).astype(np.float32)
