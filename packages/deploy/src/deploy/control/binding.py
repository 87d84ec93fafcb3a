"""Joints bound by name, in one place: the only conversion between the robot's order and the policy's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from deploy.bundles.manifest import Bundle
from deploy.errors import RobotError
from deploy.interfaces import Array, EnergyReading, JointCommand, RobotSpec, RobotState


class JointBinding:
    """Maps arrays per joint and per foot between the order of a robot and the order of a policy."""

    @classmethod
    def of(cls, bundle: Bundle, spec: RobotSpec) -> JointBinding:
        """That of a bundle and a robot.

        Raises:
            RobotError: The two do not have the same joints, or feet.
        """
        feet = spec.feet or bundle.robot.feet
        if sorted(feet) != sorted(bundle.robot.feet):
            raise RobotError(
                f"{spec.name}: its feet {list(feet)} are not those of the bundle, {list(bundle.robot.feet)}; "
                "use the bundle that was made for this robot"
            )
        binding = cls(bundle.joint_names, spec.joint_names, spec.name)
        binding._feet = np.array([feet.index(name) for name in bundle.robot.feet])
        return binding

    def __init__(self, policy_names: tuple[str, ...], robot_names: tuple[str, ...], robot: str) -> None:
        """Bind by name; feet keep their order.

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
        self._feet: NDArray[np.intp] | slice = slice(None)

    def state(self, state: RobotState) -> RobotState:
        """The state with its joints and feet in policy order."""
        order = self._to_policy
        contact = None if state.contact is None else state.contact[self._feet]
        return replace(state, q=state.q[order], dq=state.dq[order], tau=state.tau[order], contact=contact)

    def energy(self, reading: EnergyReading | None) -> EnergyReading | None:
        """The reading with its joint array in policy order."""
        if reading is None:
            return None
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
