"""The golden trace: raw robot states, and what the policy must make of them.

The observation is built here in plain numpy from the terms of the specification, independently of
the training environment, so that a slip in either shows up as a difference.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from distill.errors import BundleError
from distill.interfaces import ACTIONS
from distill.runtimes import PolicyRuntime
from distill.spec import BundleSpec

Floats = NDArray[np.float64]

TICKS = 256


@dataclass(frozen=True)
class RawStates:
    """T ticks of what a robot's sensors and operator give.

    Attributes:
        quat_wxyz: (T, 4) orientation of the base in the world.
        gyro: (T, 3) angular velocity, base frame, rad/s.
        q: (T, 12) joint angles, rad, policy order.
        dq: (T, 12) joint velocities, rad/s.
        command: (T, 3) vx, vy, yaw rate; base frame, m/s and rad/s.
        reset: (T,) bool; True where memory and last action are cleared before the tick.
        contact: (T, 4) bool, feet that touch the ground; None: unknown, read as none.
    """

    quat_wxyz: Floats
    gyro: Floats
    q: Floats
    dq: Floats
    command: Floats
    reset: NDArray[np.bool_]
    contact: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        ticks = len(self.reset)
        for name, width in (("quat_wxyz", 4), ("gyro", 3), ("q", ACTIONS), ("dq", ACTIONS), ("command", 3)):
            array = getattr(self, name)
            if array.shape != (ticks, width):
                raise BundleError(f"raw states: {name} has shape {array.shape}, expected {(ticks, width)}")
            if not np.isfinite(array).all():
                raise BundleError(f"raw states: {name} holds values that are not finite")
        if self.contact is not None and self.contact.shape != (ticks, 4):
            raise BundleError(f"raw states: contact has shape {self.contact.shape}, expected {(ticks, 4)}")
        if ticks == 0 or not self.reset[0] or not self.reset[1:].any():
            raise BundleError("raw states: a golden trace has a reset at tick 0 and another one later")


def plausible_states(spec: BundleSpec, ticks: int = TICKS, seed: int = 0) -> RawStates:
    """Two episodes of smooth motion about the stance, consistent in angles and rates.

    Joints swing by up to 0.3 rad within their limits at 0.5 to 3 Hz, the trunk rolls and pitches by
    up to 0.15 rad and turns; commands are drawn from the trained range once a second.
    """
    rng = np.random.default_rng(seed)
    half = ticks // 2
    episodes = [_episode(spec, half, rng), _episode(spec, ticks - half, rng)]
    reset = np.zeros(ticks, dtype=np.bool_)
    reset[[0, half]] = True
    quat_wxyz, gyro, q, dq, command = (np.concatenate(parts) for parts in zip(*episodes, strict=True))
    # a stream of its own: what is drawn for other sensors does not depend on it
    contact = np.random.default_rng((seed, 1)).random((ticks, 4)) < 0.6
    return RawStates(quat_wxyz, gyro, q, dq, command, reset, contact)


def _episode(spec: BundleSpec, ticks: int, rng: np.random.Generator) -> tuple[Floats, ...]:
    time = np.arange(ticks)[:, None] / spec.policy_hz
    stance, lower, upper = (
        np.array([getattr(joint, name) for joint in spec.joints]) for name in ("stance", "lower", "upper")
    )
    room = np.clip(np.minimum(stance - lower, upper - stance), 0.0, 0.3)
    q, dq = _swing(time, rng.uniform(0.2, 1.0, ACTIONS) * room, rng)
    euler, rates = _swing(time, np.array([0.15, 0.15, 0.6]), rng)
    command = rng.uniform(spec.command_low, spec.command_high, (ticks, 3))
    command = command[(np.arange(ticks) // int(spec.policy_hz)) * int(spec.policy_hz)]
    return _quaternion(euler), _body_rates(euler, rates), stance + q, dq, command


def _swing(time: Floats, amplitude: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Sinusoids (T, n) of random frequency and phase, and their time derivatives."""
    pulse = 2.0 * np.pi * rng.uniform(0.5, 3.0, amplitude.shape)
    phase = pulse * time + rng.uniform(0.0, 2.0 * np.pi, amplitude.shape)
    return amplitude * np.sin(phase), amplitude * pulse * np.cos(phase)


def _quaternion(euler: Floats) -> Floats:
    """Roll, pitch, yaw (T, 3), applied as yaw then pitch then roll, to w, x, y, z."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(euler / 2.0).T, np.sin(euler / 2.0).T
    return np.stack(
        (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ),
        axis=1,
    )


def _body_rates(euler: Floats, rates: Floats) -> Floats:
    """Angular velocity in the base frame (T, 3) from the rates of roll, pitch and yaw."""
    roll, pitch, _ = euler.T
    d_roll, d_pitch, d_yaw = rates.T
    return np.stack(
        (
            d_roll - d_yaw * np.sin(pitch),
            d_pitch * np.cos(roll) + d_yaw * np.cos(pitch) * np.sin(roll),
            -d_pitch * np.sin(roll) + d_yaw * np.cos(pitch) * np.cos(roll),
        ),
        axis=1,
    )


def projected_gravity(quat_wxyz: Floats) -> Floats:
    """World down as seen from the base: R^T (0, 0, -1), unit vector (3,)."""
    w, x, y, z = quat_wxyz / np.linalg.norm(quat_wxyz)
    return np.array((2.0 * (w * y - x * z), -2.0 * (y * z + w * x), 2.0 * (x * x + y * y) - 1.0))


def observe(spec: BundleSpec, states: RawStates, tick: int, last_action: Floats) -> NDArray[np.float32]:
    """The observation (P,) of one tick; `last_action` (12,) is the previous action after clipping."""
    stance = np.array([joint.stance for joint in spec.joints])
    gravity, contact = projected_gravity(states.quat_wxyz[tick]), states.contact
    unknown = np.zeros(1)
    sources: dict[str, Floats] = {
        "base_angular_velocity": states.gyro[tick],
        "projected_gravity": gravity,
        "roll_pitch": np.array((np.arctan2(-gravity[1], -gravity[2]), np.arcsin(np.clip(gravity[0], -1.0, 1.0)))),
        "heading_error": unknown,
        "next_heading_error": unknown,
        "commanded_speed": states.command[tick, :1],
        "foot_contact": (np.zeros(4) if contact is None else contact[tick]) - 0.5,
        "command": states.command[tick],
        "joint_position_error": states.q[tick] - stance,
        "joint_velocity": states.dq[tick],
        "last_action": last_action,
    }
    parts = [np.asarray(term.scale) * sources[term.source] for term in spec.observation]
    return np.concatenate(parts).astype(np.float32)


def clip(spec: BundleSpec, action: NDArray[np.float32]) -> Floats:
    """The action (12,) after the limit of the specification."""
    limit = np.inf if spec.action_clip is None else spec.action_clip
    return np.clip(action.astype(np.float64), -limit, limit)


def recorded(states: RawStates) -> dict[str, NDArray[Any]]:
    """The raw states as arrays of `golden.npz`."""
    names = ("quat_wxyz", "gyro", "q", "dq", "command", "reset")
    contact = {} if states.contact is None else {"contact": states.contact}
    return {**{name: getattr(states, name) for name in names}, **contact}


def record(spec: BundleSpec, states: RawStates, runtime: PolicyRuntime) -> dict[str, NDArray[Any]]:
    """Run the policy over raw states.

    Returns:
        The arrays of `golden.npz`: the raw states, and obs (T, P), action (T, 12), target (T, 12) in rad.
    """
    offset = np.array([joint.target_offset for joint in spec.joints])
    last_action = np.zeros(ACTIONS)
    observations, actions, targets = [], [], []
    for tick, reset in enumerate(states.reset):
        if reset:
            runtime.reset()
            last_action = np.zeros(ACTIONS)
        observations.append(observe(spec, states, tick, last_action))
        actions.append(runtime.step(observations[-1]).action)
        last_action = clip(spec, actions[-1])
        targets.append(offset + spec.action_scale * last_action)
    return {
        **recorded(states),
        "obs": np.stack(observations),
        "action": np.stack(actions),
        "target": np.stack(targets),
    }
