"""Joints bound by name, in one place: the only conversion between the robot's order and the policy's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from deploy.errors import RobotError
from deploy.interfaces import Array, EnergyReading, JointCommand, RobotState


class JointBinding:
    """Maps per-joint arrays between the order of a robot and the order of a policy."""

    def __init__(self, policy_names: tuple[str, ...], robot_names: tuple[str, ...], robot: str) -> None:
        """Bind by name.

        Raises:
            RobotError: The two do not have the same joints.
        """
        missing = [name for name in policy_names if name not in robot_names]
        extra = [name for name in robot_names if name not in policy_names]
        if missing or extra or len(set(robot_names)) != len(robot_names):
            raise RobotError(
                f"{robot}: its joints are not those of the bundle (missing {missing}, extra {extra}, "
                f"robot has {list(robot_names)}); use the bundle that was made for this robot"
            )
        self._to_policy = np.array([robot_names.index(name) for name in policy_names])
        self._to_robot = np.array([policy_names.index(name) for name in robot_names])

    def state(self, state: RobotState) -> RobotState:
        """The state with its joint arrays in policy order."""
        order = self._to_policy
        return replace(state, q=state.q[order], dq=state.dq[order], tau=state.tau[order])

    def energy(self, reading: EnergyReading) -> EnergyReading:
        """The reading with its joint array in policy order."""
        return replace(reading, joint_energy_pos_j=reading.joint_energy_pos_j[self._to_policy])

    def command(self, command: JointCommand) -> JointCommand:
        """A command in policy order, put into the robot's order."""

        def reorder(values: Array) -> Array:
            return values[self._to_robot]

        return JointCommand(
            q=reorder(command.q),
            dq=reorder(command.dq),
            kp=reorder(command.kp),
            kd=reorder(command.kd),
            tau=reorder(command.tau),
            stamp_ns=command.stamp_ns,
        )
