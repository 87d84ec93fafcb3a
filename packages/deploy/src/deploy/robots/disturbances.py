"""What goes wrong between a robot and its controller: delays, noise, drop-outs and dead sensors, all repeatable."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from deploy.interfaces import Array, Image, RobotState

FaultKind: TypeAlias = Literal["frozen", "dropped", "nan", "zero", "depth_dropped", "depth_nan"]
"""frozen: the last values under new stamps; dropped: no new reading; nan and zero: such values in all of it;
depth_dropped: no new image; depth_nan: images without a measurement."""


@dataclass(frozen=True)
class Fault:
    """One thing that fails for some time, s on the robot's clock."""

    kind: FaultKind
    start_s: float
    duration_s: float = float("inf")

    def active(self, time_ns: int) -> bool:
        """Whether it fails at this time."""
        return self.start_s <= time_ns * 1e-9 < self.start_s + self.duration_s


@dataclass(frozen=True)
class Disturbances:
    """Everything that a simulated robot does to its controller; by default nothing.

    Attributes:
        action_delay_s: Time from `write` to its effect, s.
        state_delay_s: Age of a reading when it can first be read, s.
        depth_delay_s: Age of an image when it can first be read, s.
        joint_noise: Standard deviation of joint angles, rad.
        joint_speed_noise: Of joint velocities, rad/s.
        torque_noise: Of joint torques, N m.
        tilt_noise: Of each axis of the orientation, rad.
        gyro_noise: Of angular velocities, rad/s.
        acc_noise: Of accelerations, m/s^2.
        depth_noise: Of depths, as a share of them.
        state_dropout: Share of readings that are not there when asked for; the one before is given again.
        depth_dropout: Share of images that never come.
        faults: What fails for some time.
        seed: Of noise and drop-outs.
    """

    action_delay_s: float = 0.0
    state_delay_s: float = 0.0
    depth_delay_s: float = 0.0
    joint_noise: float = 0.0
    joint_speed_noise: float = 0.0
    torque_noise: float = 0.0
    tilt_noise: float = 0.0
    gyro_noise: float = 0.0
    acc_noise: float = 0.0
    depth_noise: float = 0.0
    state_dropout: float = 0.0
    depth_dropout: float = 0.0
    faults: tuple[Fault, ...] = ()
    seed: int = 0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, float) and not 0.0 <= value < float("inf"):
                raise ValueError(f"Disturbances: {field.name} is {value}; choose a finite number from 0")
        if max(self.state_dropout, self.depth_dropout) > 1.0:
            raise ValueError("Disturbances: state_dropout and depth_dropout are shares, 0 to 1")

    @property
    def noisy(self) -> bool:
        """Whether readings never repeat."""
        return max(self.joint_noise, self.joint_speed_noise, self.gyro_noise, self.acc_noise) > 0.0

    def failing(self, kind: FaultKind, time_ns: int) -> bool:
        """Whether something of this kind fails at this time."""
        return any(fault.kind == kind and fault.active(time_ns) for fault in self.faults)


class StateDisturber:
    """Turns exact readings into what arrives. The same seed and times give the same readings."""

    def __init__(self, config: Disturbances) -> None:
        self._config = config
        self._last: RobotState | None = None

    def __call__(self, exact: RobotState) -> RobotState:
        """What arrives instead of this reading."""
        config, last = self._config, self._last
        rng = np.random.default_rng((config.seed, 0, exact.stamp_ns))
        lost = config.state_dropout > 0.0 and rng.random() < config.state_dropout
        if last is not None and (lost or config.failing("dropped", exact.stamp_ns)):
            return last
        if last is not None and config.failing("frozen", exact.stamp_ns):
            self._last = replace(last, stamp_ns=exact.stamp_ns, seq=exact.seq)
            return self._last
        if config.failing("nan", exact.stamp_ns):
            return _filled(exact, np.nan)
        if config.failing("zero", exact.stamp_ns):
            return _filled(exact, 0.0)
        self._last = self._with_noise(exact, rng)
        return self._last

    def _with_noise(self, state: RobotState, rng: np.random.Generator) -> RobotState:
        config = self._config
        deviations = {
            "q": config.joint_noise,
            "dq": config.joint_speed_noise,
            "tau": config.torque_noise,
            "gyro": config.gyro_noise,
            "acc": config.acc_noise,
        }
        changed: dict[str, Array] = {
            name: getattr(state, name) + rng.normal(0.0, deviation, getattr(state, name).shape)
            for name, deviation in deviations.items()
            if deviation > 0.0
        }
        if config.tilt_noise > 0.0:
            changed["quat_wxyz"] = _turned(state.quat_wxyz, rng.normal(0.0, config.tilt_noise, 3))
        return replace(state, **changed) if changed else state


def disturbed_image(config: Disturbances, depth: Image, seq: int, stamp_ns: int) -> Image | None:
    """What arrives of an image (rows, columns) in m; None if it never comes."""
    rng = np.random.default_rng((config.seed, 1, seq))
    if config.failing("depth_dropped", stamp_ns) or rng.random() < config.depth_dropout:
        return None
    if config.failing("depth_nan", stamp_ns):
        return np.full_like(depth, np.nan)
    if config.depth_noise > 0.0:
        noise = np.float32(config.depth_noise) * rng.standard_normal(depth.shape, dtype=np.float32)
        depth = (depth * (1.0 + noise)).astype(np.float32)
    return depth


def _filled(state: RobotState, value: float) -> RobotState:
    names = ("q", "dq", "tau", "quat_wxyz", "gyro", "acc")
    return replace(state, **{name: np.full_like(getattr(state, name), value) for name in names})


def _turned(quat_wxyz: Array, turn: NDArray[np.float64]) -> Array:
    """The orientation after a small turn about the base's own axes, (3,), rad."""
    w, x, y, z = quat_wxyz
    c, (i, j, k) = 1.0, 0.5 * turn
    product = np.array(
        (
            w * c - x * i - y * j - z * k,
            w * i + x * c + y * k - z * j,
            w * j - x * k + y * c + z * i,
            w * k + x * j - y * i + z * c,
        )
    )
    return product / np.linalg.norm(product)
