"""The states of the controller, their timing, and what happened in one tick."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from deploy.control.guards import GuardLimits
from deploy.control.schedule import Slot
from deploy.interfaces import Array, JointCommand, RobotState
from deploy.policy.tick import PolicyStep


class Mode(Enum):
    """What drives the joints."""

    IDLE = "idle"
    """Nothing: before the first tick."""
    PASSIVE = "passive"
    """Damping, while the readings prove themselves."""
    STAND_UP = "stand_up"
    """A straight way from the measured joints to the stance."""
    READY = "ready"
    """The stance, until the start envelope is met and the operator agrees."""
    RAMP_IN = "ramp_in"
    """From the stance to the policy's targets."""
    POLICY = "policy"
    """The policy alone."""
    DAMP = "damp"
    """Damping, for good."""


@dataclass(frozen=True)
class ControllerConfig:
    """Timing and thresholds.

    Attributes:
        passive_s: Least time of damping before the robot stands up, s.
        stand_up_s: Time to go from the measured joint angles and torques to the stance, s.
        hold_s: Least time to stand still there, s.
        ready_timeout_s: Time after that in which the start envelope must be met, s.
        ramp_in_s: Time over which targets and gains go from those of the stance to those of the policy, s.
        stand_stiffness: Stiffness of the joints while the robot stands up and stands, as a multiple of the policy's;
            the damping grows with its root. Policies are trained with joints too soft to stand on by themselves.
        guards: Thresholds of the guards.
    """

    passive_s: float = 0.1
    stand_up_s: float = 0.6
    hold_s: float = 0.4
    ready_timeout_s: float = 2.0
    ramp_in_s: float = 0.2
    stand_stiffness: float = 2.0
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
        joint_command: What was sent, in a dry run what would have been; None while damped.
        step: What the policy computed; None when it did not run.
        clamped: Joint targets that were cut to the joint limits.
        done_ns: When the tick ended, on the robot's clock.
        dry_run: Whether the robot got damping instead of `joint_command`.
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
    dry_run: bool = False
