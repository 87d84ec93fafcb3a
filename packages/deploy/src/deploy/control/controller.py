"""The state machine between policy and robot: one call of `tick` per slot of the schedule.

Idle -> StandUp -> RampIn -> Policy; any of them -> Damp, which latches with its reason.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from deploy.bundles.manifest import Bundle
from deploy.control.binding import JointBinding
from deploy.control.guards import GuardLimits, Guards
from deploy.control.schedule import Slot
from deploy.interfaces import Array, JointCommand, PolicyRuntime, RobotInterface, RobotState
from deploy.policy.tick import Policy, PolicyStep


class Mode(Enum):
    """What drives the joints."""

    IDLE = "idle"
    STAND_UP = "stand_up"
    RAMP_IN = "ramp_in"
    POLICY = "policy"
    DAMP = "damp"


@dataclass(frozen=True)
class ControllerConfig:
    """Timing and thresholds.

    Attributes:
        stand_up_s: Time to go from the measured joint angles and torques to the stance, s.
        hold_s: Time to stand still there, s.
        ramp_in_s: Time over which targets go from the stance to those of the policy, s.
        guards: Thresholds of the guards.
    """

    stand_up_s: float = 0.6
    hold_s: float = 0.4
    ramp_in_s: float = 0.2
    guards: GuardLimits = field(default_factory=GuardLimits)


@dataclass(frozen=True)
class Tick:
    """What happened in one slot; joint arrays in policy order.

    Attributes:
        slot: The slot, with its timing.
        mode: Mode at the end of the tick, the one whose command was sent.
        reason: Why the robot is damped, empty otherwise.
        state: The reading the tick used.
        command: (vx, vy, yaw_rate) asked for.
        joint_command: What was sent; None while damped.
        step: What the policy computed; None when it did not run.
        clamped: Joint targets that were cut to the joint limits.
        done_ns: When the tick ended, on the robot's clock.
    """

    slot: Slot
    mode: Mode
    reason: str
    state: RobotState
    command: Array
    joint_command: JointCommand | None
    step: PolicyStep | None
    clamped: int
    done_ns: int


class Controller:
    """Runs a policy on a robot behind guards."""

    def __init__(
        self,
        bundle: Bundle,
        robot: RobotInterface,
        runtime: PolicyRuntime,
        config: ControllerConfig | None = None,
    ) -> None:
        """Bind the joints of robot and policy by name.

        Raises:
            RobotError: The joints are not the same.
        """
        config = config or ControllerConfig()
        self._robot = robot
        self._binding = JointBinding(bundle.joint_names, robot.spec.joint_names, robot.spec.name)
        self._policy = Policy(bundle, runtime)
        self._guards = Guards(bundle, config.guards)
        self._offset = bundle.per_joint("target_offset")
        self._lower, self._upper = bundle.per_joint("lower"), bundle.per_joint("upper")
        self._kp, self._kd = bundle.per_joint("kp"), bundle.per_joint("kd")
        self._stand_ticks = math.ceil(config.stand_up_s * bundle.policy_hz)
        self._hold_ticks = math.ceil(config.hold_s * bundle.policy_hz)
        self._ramp_ticks = math.ceil(config.ramp_in_s * bundle.policy_hz)
        self._mode = Mode.IDLE
        self._reason = ""
        self._elapsed = 0
        self._from = self._offset

    @property
    def mode(self) -> Mode:
        """Current mode."""
        return self._mode

    @property
    def reason(self) -> str:
        """Why the robot is damped, empty otherwise."""
        return self._reason

    def stop(self, reason: str) -> None:
        """Damp the robot at once and for good; the first reason stays."""
        if self._mode is not Mode.DAMP:
            self._mode, self._reason = Mode.DAMP, reason
        self._robot.damp()

    def tick(self, slot: Slot, command: Array) -> Tick:
        """Read, judge, compute, judge, write.

        Args:
            slot: The slot of the schedule that has just begun.
            command: (vx, vy, yaw_rate), base frame, m/s and rad/s.

        Returns:
            Everything the tick read, computed and sent.
        """
        state = self._binding.state(self._robot.read())
        trip = self._guards.check_state(state, self._robot.clock.now_ns())
        if trip is None and not np.isfinite(command).all():
            trip = f"command: not finite: {command.tolist()}"
        step, target = None, self._offset
        if trip is None:
            self._advance(state)
            if self._mode in (Mode.RAMP_IN, Mode.POLICY):
                step = self._policy.step(state, command)
                trip = self._guards.check_action(step.action)
            target = self._target(step)
        if trip is not None or self._mode is Mode.DAMP:
            self.stop(trip or self._reason)
            return self._record(slot, state, command, None, step, 0)
        within = np.clip(target, self._lower, self._upper)
        zeros = np.zeros_like(within)
        sent = JointCommand(within, zeros, self._kp, self._kd, zeros, self._robot.clock.now_ns())
        self._robot.write(self._binding.command(sent))
        return self._record(slot, state, command, sent, step, int((within != target).sum()))

    def _advance(self, state: RobotState) -> None:
        """Move the state machine on by one tick."""
        if self._mode is Mode.IDLE:
            self._mode, self._elapsed = Mode.STAND_UP, 0
            # The target that gives the torque of this instant: a robot that stands does not sag.
            self._from = state.q + state.tau / self._kp
        elif self._mode is Mode.STAND_UP and self._elapsed >= self._stand_ticks + self._hold_ticks:
            self._mode, self._elapsed = Mode.RAMP_IN, 0
            self._policy.reset()
        if self._mode is Mode.RAMP_IN and self._elapsed >= self._ramp_ticks:
            self._mode = Mode.POLICY
        self._elapsed += 1

    def _target(self, step: PolicyStep | None) -> Array:
        """Joint targets of this tick, before they are cut to the joint limits."""
        if step is None:
            share = min(self._elapsed / max(self._stand_ticks, 1), 1.0)
            return self._from + share * (self._offset - self._from)
        share = 1.0 if self._mode is Mode.POLICY else self._elapsed / (self._ramp_ticks + 1)
        return self._offset + share * (step.target - self._offset)

    def _record(
        self,
        slot: Slot,
        state: RobotState,
        command: Array,
        sent: JointCommand | None,
        step: PolicyStep | None,
        clamped: int,
    ) -> Tick:
        done = self._robot.clock.now_ns()
        return Tick(slot, self._mode, self._reason, state, command, sent, step, clamped, done)
