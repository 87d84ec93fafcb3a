"""Checks between robot and policy. Every one fails closed: a value that cannot be judged trips it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from deploy.bundles.manifest import Bundle
from deploy.control.schedule import Slot
from deploy.interfaces import Array, RobotState, Seen
from deploy.policy.observation import projected_gravity

IMU = ("quat_wxyz", "gyro", "acc")
NUMBERS = ("q", "dq", "tau", *IMU)
"""What a reading consists of."""


@dataclass(frozen=True)
class GuardLimits:
    """Thresholds.

    Attributes:
        max_tilt: Angle between the base's and the world's vertical, rad.
        max_state_age_s: Age of a reading when it is used, s.
        max_identical: Readings in a row in which the IMU is equal in every number, from a robot with noise.
        max_skipped: Slots in a row that the loop may give up.
        max_skipped_per_s: Slots within a second that it may.
        joint_margin: How far a joint may go beyond its limit, which is soft, rad.
        torque_margin: How far a measured torque may go beyond its limit, as a share of it.
        torque_ticks: Ticks in a row from which on a torque beyond that counts: estimates from motor currents spike.
        quat_tolerance: How far the length of the orientation quaternion may be from 1.
        max_depth_hold_s: How much older than period and latency make it the image in use may be, s.
        start_tilt: Tilt up to which the policy may take over, rad.
        start_joint_error: Distance of each joint from the stance up to which it may, rad.
        start_joint_speed: Speed of each joint up to which it may, rad/s.
        start_turn_rate: Angular velocity of the base up to which it may, rad/s.
    """

    max_tilt: float = 1.0
    max_state_age_s: float = 0.040
    max_identical: int = 5
    max_skipped: int = 5
    max_skipped_per_s: int = 10
    joint_margin: float = 0.1
    torque_margin: float = 0.25
    torque_ticks: int = 3
    quat_tolerance: float = 1e-3
    max_depth_hold_s: float = 0.3
    start_tilt: float = 0.35
    start_joint_error: float = 0.3
    start_joint_speed: float = 2.0
    start_turn_rate: float = 1.0


class Guards:
    """Judges readings and actions; arrays are in policy order. Asked once per tick."""

    def __init__(self, bundle: Bundle, limits: GuardLimits, noiseless: bool = False) -> None:
        """Take limits from the bundle; a `noiseless` robot may repeat its readings."""
        self._names = bundle.joint_names
        self._lower = bundle.per_joint("lower") - limits.joint_margin
        self._upper = bundle.per_joint("upper") + limits.joint_margin
        self._torque = bundle.per_joint("torque_limit") * (1.0 + limits.torque_margin)
        self._stance = bundle.per_joint("stance")
        self._limits = limits
        self._noiseless = noiseless
        self._last = b""
        self._identical = 1
        self._second = bundle.policy_hz
        self._skipped: deque[tuple[int, int]] = deque()
        self._overloaded = np.zeros(len(self._names), dtype=np.int64)
        depth, period = bundle.depth, 1.0 / bundle.policy_hz
        ticks = 0 if depth is None else depth.latency_ticks + depth.period_ticks
        self._depth_age = ticks * period + limits.max_depth_hold_s

    def check_slot(self, slot: Slot) -> str | None:
        """Why a loop that was away must not go on, or None if it may."""
        if not slot.skipped <= self._limits.max_skipped:
            return f"deadline: {slot.skipped} slots given up in a row, limit {self._limits.max_skipped}"
        if slot.skipped:
            self._skipped.append((slot.index, slot.skipped))
        while self._skipped and self._skipped[0][0] <= slot.index - self._second:
            self._skipped.popleft()
        lost = sum(skipped for _, skipped in self._skipped)
        if not lost <= self._limits.max_skipped_per_s:
            return f"deadline: {lost} slots given up within a second, limit {self._limits.max_skipped_per_s}"
        return None

    def check_state(self, state: RobotState, now_ns: int) -> str | None:
        """Why this reading must not drive the robot, with the offending value, or None if it may."""
        limits = self._limits
        if state.operator_stop:
            return "operator stop: remote control"
        for name in NUMBERS:
            if not np.isfinite(getattr(state, name)).all():
                return f"state: {name} is not finite: {getattr(state, name).tolist()}"
        age = (now_ns - state.stamp_ns) * 1e-9
        if not 0.0 <= age <= limits.max_state_age_s:
            return f"state: reading is {age * 1e3:.1f} ms old, limit {limits.max_state_age_s * 1e3:.1f} ms"
        if not (state.q.any() or state.dq.any()):
            return "state: all joint angles and velocities are zero, the driver has no reading"
        if not (state.acc.any() or state.gyro.any()):
            return "state: acceleration and angular velocity are zero, the IMU has no reading"
        if trip := self._check_frozen(state):
            return trip
        length = float(np.linalg.norm(state.quat_wxyz))
        if not abs(length - 1.0) <= limits.quat_tolerance:
            return f"state: orientation quaternion has length {length:.4f}, not 1"
        tilt = tilt_of(state)
        if not tilt <= limits.max_tilt:
            return f"tilt: {tilt:.3f} rad, limit {limits.max_tilt:.3f} rad"
        return self._check_joints(state)

    def _check_frozen(self, state: RobotState) -> str | None:
        # an IMU is never still, joints may be
        numbers = b"".join(getattr(state, name).tobytes() for name in IMU)
        self._identical = self._identical + 1 if numbers == self._last else 1
        self._last = numbers
        if not self._noiseless and self._identical >= self._limits.max_identical:
            return f"state: frozen, {self._identical} readings of the IMU in a row are equal in every number"
        return None

    def _check_joints(self, state: RobotState) -> str | None:
        inside = (state.q >= self._lower) & (state.q <= self._upper)
        if not inside.all():
            joint = int(np.argmin(inside))
            return (
                f"joint limit: {self._names[joint]} at {state.q[joint]:.3f} rad, "
                f"allowed [{self._lower[joint]:.3f}, {self._upper[joint]:.3f}] rad"
            )
        within = np.abs(state.tau) <= self._torque
        self._overloaded = np.where(within, 0, self._overloaded + 1)
        if (self._overloaded >= self._limits.torque_ticks).any():
            joint = int(np.argmax(self._overloaded))
            return (
                f"torque limit: {self._names[joint]} at {state.tau[joint]:.1f} N m for {self._overloaded[joint]} "
                f"ticks, allowed {self._torque[joint]:.1f} N m"
            )
        return None

    def check_start(self, state: RobotState) -> str | None:
        """What keeps the policy from taking over in this state, or None if it may: the start envelope."""
        limits = self._limits
        tilt, turn = tilt_of(state), float(np.linalg.norm(state.gyro))
        if not tilt <= limits.start_tilt:
            return f"tilt {tilt:.3f} rad, limit {limits.start_tilt:.3f} rad"
        if not turn <= limits.start_turn_rate:
            return f"the base turns at {turn:.2f} rad/s, limit {limits.start_turn_rate:.2f} rad/s"
        for what, unit, values, limit in (
            ("from its stance", "rad", state.q - self._stance, limits.start_joint_error),
            ("speed", "rad/s", state.dq, limits.start_joint_speed),
        ):
            within = np.abs(values) <= limit
            if not within.all():
                joint = int(np.argmin(within))
                return f"{self._names[joint]} {values[joint]:+.3f} {unit} {what}, limit {limit:.3f} {unit}"
        return None

    def check_depth(self, seen: Seen | None, start_ns: int, now_ns: int, fault: str | None = None) -> str | None:
        """Why what is seen is too old to go on with, or None if it is not.

        Args:
            seen: What the policy has in use; None of a blind one.
            start_ns: When the policy started, which stands for an image that has not come yet.
            now_ns: Time on the clock of the frames.
            fault: What was wrong with the latest frame.
        """
        if seen is None:
            return None
        age = (now_ns - (start_ns if seen.tick < 0 else seen.stamp_ns)) * 1e-9
        if not 0.0 <= age <= self._depth_age:
            return f"depth: image in use is {age * 1e3:.0f} ms old, limit {self._depth_age * 1e3:.0f} ms" + (
                f" ({fault})" if fault else ""
            )
        return None

    def check_action(self, action: Array) -> str | None:
        """Why this action must not reach the robot, or None if it may."""
        if not np.isfinite(action).all():
            return f"action: not finite: {action.tolist()}"
        return None


def tilt_of(state: RobotState) -> float:
    """Angle between the base's and the world's vertical, rad."""
    return float(np.arccos(np.clip(-projected_gravity(state.quat_wxyz)[2], -1.0, 1.0)))
