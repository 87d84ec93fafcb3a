"""What a run achieved and what it cost, from its trace."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from deploy.interfaces import Array
from deploy.logs.metadata import RunInfo
from deploy.logs.trace import Trace
from deploy.measure.energy import cost_of_transport, eq10, joules, positive_power

Index = NDArray[np.intp]

SETTLE_S = 2.0
"""Tracking errors count from this time of full control on, s."""

FINISHED = "finished"
"""Reason of a run that reached its end."""

FELL = ("fell", "tilt")
"""Beginnings of the reasons that mean a fall."""


@dataclass(frozen=True)
class RunSummary:
    """Result of a run. Everything counts from the tick on which the policy has full control.

    Attributes:
        bundle: Name of the bundle.
        bundle_sha256: Hash of its manifest.
        robot: What it ran on.
        design: Parameters of the body.
        command: (vx, vy, yaw_rate), m/s and rad/s.
        duration_s: Time asked for, s.
        seed: Of the start of a simulated robot.
        ticks: Ticks under full control.
        late: Ticks that started late.
        skipped: Slots given up.
        clamped: Joint targets cut to the joint limits.
        completed: The policy ran for the whole time.
        fell: The robot tilted over or sank to the ground.
        reason: Why the run ended.
        distance_m: Way along the commanded direction, turned with the robot's heading, m.
        displacement_m: Straight horizontal line from start to end, m.
        commanded_m: Distance asked for over the whole duration, m.
        mean_speed: `distance_m` over the time under control, m/s.
        tracking_error: Mean difference of the base's velocity along the command and the command, base frame,
            from 2 s on; time lost to a fall counts the whole command, m/s.
        yaw_rate_error: The same for the yaw rate, rad/s.
        eq10_w_ticks: Paper eq. 10 as printed, from velocity and torque at the policy rate, W times ticks.
        energy_j_50hz: The same in joules: |eq. 10| times the policy period.
        energy_j_physics: Positive mechanical energy summed at every physics step, or state of a robot of metal, J.
        cost_of_transport: Energy over m g distance; from the physics steps if known, else the policy rate.
        mean_power_w: Positive mechanical power, mean, W.
        peak_power_w: Positive mechanical power, largest; at physics steps if known.

    None stands where nothing measured the quantity (hardware) or it is not defined (no distance).
    """

    bundle: str
    bundle_sha256: str
    robot: str
    design: Mapping[str, float]
    command: tuple[float, float, float]
    duration_s: float
    seed: int
    ticks: int
    late: int
    skipped: int
    clamped: int
    completed: bool
    fell: bool
    reason: str
    distance_m: float | None
    displacement_m: float | None
    commanded_m: float
    mean_speed: float | None
    tracking_error: float | None
    yaw_rate_error: float | None
    eq10_w_ticks: float
    energy_j_50hz: float
    energy_j_physics: float | None
    cost_of_transport: float | None
    mean_power_w: float | None
    peak_power_w: float | None

    def to_dict(self) -> dict[str, object]:
        """Plain types that `json.dumps` takes, all numbers finite."""
        return asdict(self)


def summarise(info: RunInfo, trace: Trace) -> RunSummary:
    """Summarise a run.

    Args:
        info: What was run.
        trace: Its ticks; the one after the last under policy control closes the last period.

    Returns:
        The summary; the same trace, live or read from a log, gives the same numbers.
    """
    active = np.flatnonzero(trace.mode == "policy")
    closed = np.append(active, min(active[-1] + 1, len(trace.mode) - 1)) if len(active) else active
    dt = 1.0 / info.policy_hz
    f = eq10(trace.dq[active], trace.tau[active])
    spent = _difference(trace.joint_energy_pos_j.sum(axis=1), closed)
    energy = joules(f, dt) if spent is None else spent
    peaks = positive_power(trace.dq[active], trace.tau[active]) if spent is None else trace.peak_w[closed[1:]]
    command = np.array(info.command)
    distance = _progress(trace, closed, command)
    elapsed = len(active) * dt
    speed_error, yaw_error = _tracking(info, trace, active, command)
    return RunSummary(
        bundle=info.bundle,
        bundle_sha256=info.bundle_sha256,
        robot=info.robot,
        design=dict(info.design),
        command=info.command,
        duration_s=info.duration_s,
        seed=info.seed,
        ticks=len(active),
        late=int(trace.late[active].sum()),
        skipped=int(trace.skipped[active].sum()),
        clamped=int(trace.clamped[active].sum()),
        completed=trace.reason == FINISHED,
        fell=trace.reason.split(":")[0] in FELL,
        reason=trace.reason,
        distance_m=distance,
        displacement_m=_displacement(trace, closed),
        commanded_m=float(np.linalg.norm(command[:2])) * info.duration_s,
        mean_speed=None if distance is None else distance / elapsed,
        tracking_error=speed_error,
        yaw_rate_error=yaw_error,
        eq10_w_ticks=f,
        energy_j_50hz=joules(f, dt),
        energy_j_physics=spent,
        cost_of_transport=None if distance is None else cost_of_transport(energy, info.total_mass, distance),
        mean_power_w=energy / elapsed if len(active) else None,
        peak_power_w=float(peaks.max()) if len(peaks) else None,
    )


def _difference(values: Array, closed: Index) -> float | None:
    """Growth of a running sum over the active time, None where it was not measured."""
    if not len(closed) or not np.isfinite(values[closed]).all():
        return None
    return float(values[closed[-1]] - values[closed[0]])


def _heading(quat_wxyz: Array) -> Array:
    """Yaw of the base, shape (T,), rad."""
    w, x, y, z = quat_wxyz.T
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def _progress(trace: Trace, closed: Index, command: Array) -> float | None:
    """Way along the commanded direction, which turns with the robot."""
    speed = np.linalg.norm(command[:2])
    if speed == 0 or not len(closed) or not np.isfinite(trace.position[closed]).all():
        return None
    steps = np.diff(trace.position[closed, :2], axis=0)
    direction = _heading(trace.quat_wxyz[closed[:-1]]) + np.arctan2(command[1], command[0])
    return float((steps[:, 0] * np.cos(direction) + steps[:, 1] * np.sin(direction)).sum())


def _displacement(trace: Trace, closed: Index) -> float | None:
    if not len(closed) or not np.isfinite(trace.position[closed]).all():
        return None
    return float(np.linalg.norm(trace.position[closed[-1], :2] - trace.position[closed[0], :2]))


def _tracking(info: RunInfo, trace: Trace, active: Index, command: Array) -> tuple[float | None, float | None]:
    """Mean errors of speed along the command and of yaw rate, a fall counting the whole command."""
    asked = round(info.duration_s * info.policy_hz)
    settle = round(SETTLE_S * info.policy_hz)
    settle = settle if settle < asked else 0
    counted = active[settle:]
    if not len(active) or not np.isfinite(trace.velocity[counted]).all():
        return None, None
    speed = float(np.linalg.norm(command[:2]))
    direction = command[:2] / speed if speed else None
    velocity = trace.velocity[counted, :2]
    along = np.linalg.norm(velocity, axis=1) if direction is None else velocity @ direction
    lost = max(asked - settle - len(counted), 0)
    total = max(asked - settle, len(counted))
    return (
        float((np.abs(along - speed).sum() + lost * speed) / total),
        float((np.abs(trace.yaw_rate[counted] - command[2]).sum() + lost * abs(command[2])) / total),
    )
