"""Checks between robot and policy. Every one fails closed: a value that cannot be judged trips it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deploy.bundles.manifest import Bundle
from deploy.interfaces import Array, RobotState
from deploy.policy.observation import projected_gravity


@dataclass(frozen=True)
class GuardLimits:
    """Thresholds.

    Attributes:
        max_tilt: Angle between the base's and the world's vertical, rad.
        max_state_age_s: Age of a reading when it is used, s.
        joint_margin: How far a joint may go beyond its limit, which is soft, rad.
        quat_tolerance: How far the length of the orientation quaternion may be from 1.
    """

    max_tilt: float = 1.0
    max_state_age_s: float = 0.040
    joint_margin: float = 0.1
    quat_tolerance: float = 1e-3


class Guards:
    """Judges readings and actions; arrays are in policy order."""

    def __init__(self, bundle: Bundle, limits: GuardLimits) -> None:
        self._names = bundle.joint_names
        self._lower = bundle.per_joint("lower") - limits.joint_margin
        self._upper = bundle.per_joint("upper") + limits.joint_margin
        self._limits = limits

    def check_state(self, state: RobotState, now_ns: int) -> str | None:
        """Why this reading must not drive the robot, with the offending value, or None if it may."""
        limits = self._limits
        for name in ("q", "dq", "tau", "quat_wxyz", "gyro", "acc"):
            if not np.isfinite(getattr(state, name)).all():
                return f"state: {name} is not finite: {getattr(state, name).tolist()}"
        age = (now_ns - state.stamp_ns) * 1e-9
        if not 0.0 <= age <= limits.max_state_age_s:
            return f"state: reading is {age * 1e3:.1f} ms old, limit {limits.max_state_age_s * 1e3:.1f} ms"
        length = float(np.linalg.norm(state.quat_wxyz))
        if not abs(length - 1.0) <= limits.quat_tolerance:
            return f"state: orientation quaternion has length {length:.4f}, not 1"
        tilt = float(np.arccos(np.clip(-projected_gravity(state.quat_wxyz)[2], -1.0, 1.0)))
        if not tilt <= limits.max_tilt:
            return f"tilt: {tilt:.3f} rad, limit {limits.max_tilt:.3f} rad"
        inside = (state.q >= self._lower) & (state.q <= self._upper)
        if not inside.all():
            joint = int(np.argmin(inside))
            return (
                f"joint limit: {self._names[joint]} at {state.q[joint]:.3f} rad, "
                f"allowed [{self._lower[joint]:.3f}, {self._upper[joint]:.3f}] rad"
            )
        return None

    def check_action(self, action: Array) -> str | None:
        """Why this action must not reach the robot, or None if it may."""
        if not np.isfinite(action).all():
            return f"action: not finite: {action.tolist()}"
        return None
