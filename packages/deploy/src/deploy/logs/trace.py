"""A run as arrays, one row per tick: kept while running, or read back from a log."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deploy.interfaces import Array
from deploy.logs.messages import Sample
from deploy.policy.observation import rotate_inverse


@dataclass(frozen=True)
class Trace:
    """One row per tick; NaN where nothing measured it.

    Attributes:
        mode: Mode of the controller, shape (T,).
        reason: Why the run ended.
        time: When the tick started, on the robot's clock, shape (T,), s.
        due: When it should have started, shape (T,), s.
        done: When its command was out, shape (T,), s.
        q: Shape (T, 12), rad.
        q_target: Joint targets that were sent, shape (T, 12), rad; NaN where none was.
        dq: Shape (T, 12), rad/s.
        tau: Shape (T, 12), N m.
        late: Shape (T,).
        skipped: Shape (T,).
        clamped: Shape (T,).
        joint_energy_pos_j: Positive work of each joint since the start at the rate of the state, shape (T, 12), J.
        states: States summed into it, shape (T,); 0 where nothing measured it.
        peak_w: Peak positive power since the previous tick, shape (T,), W.
        position: Base in the world, shape (T, 3), m.
        quat_wxyz: True orientation of the base, shape (T, 4).
        velocity: Base frame, shape (T, 3), m/s.
        yaw_rate: Base frame, shape (T,), rad/s.
    """

    mode: NDArray[np.str_]
    reason: str
    time: Array
    due: Array
    done: Array
    q: Array
    q_target: Array
    dq: Array
    tau: Array
    late: NDArray[np.bool_]
    skipped: NDArray[np.int64]
    clamped: NDArray[np.int64]
    joint_energy_pos_j: Array
    states: NDArray[np.int64]
    peak_w: Array
    position: Array
    quat_wxyz: Array
    velocity: Array
    yaw_rate: Array


class TraceRecorder:
    """Collects the rows of a `Trace`."""

    def __init__(self) -> None:
        self._rows: list[dict[str, Any]] = []
        self._reason = ""

    def add(self, sample: Sample) -> None:
        """Keep one tick."""
        tick, truth, energy = sample.tick, sample.truth, sample.energy
        self._reason = tick.reason
        self._rows.append(
            {
                "mode": tick.mode.value,
                "time": tick.slot.start_ns * 1e-9,
                "due": tick.slot.due_ns * 1e-9,
                "done": tick.done_ns * 1e-9,
                "q": tick.state.q,
                "q_target": np.full(12, np.nan) if tick.joint_command is None else tick.joint_command.q,
                "dq": tick.state.dq,
                "tau": tick.state.tau,
                "late": tick.slot.late,
                "skipped": tick.slot.skipped,
                "clamped": tick.clamped,
                "joint_energy_pos_j": np.full(12, np.nan) if energy is None else energy.joint_energy_pos_j,
                "states": 0 if energy is None else energy.states,
                "peak_w": np.nan if energy is None else energy.peak_pos_w,
                "position": np.full(3, np.nan) if truth is None else truth.position,
                "quat_wxyz": np.full(4, np.nan) if truth is None else truth.quat_wxyz,
                "velocity": np.full(3, np.nan) if truth is None else rotate_inverse(truth.quat_wxyz, truth.velocity),
                "yaw_rate": np.nan if truth is None else truth.angular_velocity[2],
            }
        )

    def trace(self) -> Trace:
        """The rows so far."""
        return stack(self._rows, self._reason)


def stack(rows: list[dict[str, Any]], reason: str) -> Trace:
    """A trace of rows, each with all fields but `reason`."""
    columns = {f.name: np.array([row[f.name] for row in rows]) for f in fields(Trace) if f.name != "reason"}
    return Trace(reason=reason, **columns)
