"""The energy of a run in full: two rates with their errors, per joint, fore and hind, over time (paper Fig. 9)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from deploy.errors import LogError
from deploy.interfaces import Array
from deploy.logs.reading import Log
from deploy.logs.trace import Trace
from deploy.measure.energy import sampling_errors
from deploy.measure.legs import fore_joints
from deploy.measure.summary import RunSummary, summarise


@dataclass(frozen=True)
class EnergyAccount:
    """What a run cost, counted from full control of the policy on; None where nothing measured it.

    Attributes:
        name: Of the log.
        summary: Eq. 10, distance, cost of transport and the rest.
        seconds: Time counted, s.
        mass: Of this body, kg.
        error_50hz_j: Half-width of the error bar of the sum at the policy rate, J (see `sampling_errors`).
        error_state_j: The same of the sum at the rate of the state, J.
        state_hz: That rate, Hz.
        joints_j: Positive work of each joint, J; at the rate of the state if known.
        fore_j: That of the front legs, J; None where the robot description does not tell.
        hind_j: That of the hind legs, J.
        time: Starts of the ticks, (T,), s.
        power_w: Positive power, mean over each tick, (T,), W; the sample at its start where only that is known.
        cumulative_j: Work up to the end of each tick, (T,), J.
    """

    name: str
    summary: RunSummary
    seconds: float
    mass: float
    error_50hz_j: float | None
    error_state_j: float | None
    state_hz: float | None
    joints_j: Mapping[str, float]
    fore_j: float | None
    hind_j: float | None
    time: Array
    power_w: Array
    cumulative_j: Array

    @property
    def energy_j(self) -> float:
        """The better of the two sums, J."""
        exact = self.summary.energy_j_physics
        return self.summary.energy_j_50hz if exact is None else exact

    @property
    def error_j(self) -> float | None:
        """Half-width of its error bar, J."""
        return self.error_50hz_j if self.summary.energy_j_physics is None else self.error_state_j

    @property
    def nominal(self) -> bool:
        """Whether every scale of the body is 1."""
        return all(value == 1.0 for value in self.summary.design.values())

    def to_dict(self) -> dict[str, object]:
        """Plain types that `json.dumps` takes, without the curves."""
        curves = ("time", "power_w", "cumulative_j", "summary")
        own = {field.name: getattr(self, field.name) for field in fields(self) if field.name not in curves}
        return {**own, **self.summary.to_dict()}


def account(log: Log, seconds: float | None = None) -> EnergyAccount:
    """Measure the energy of a run.

    Args:
        log: The run.
        seconds: Count only so long from full control on (the paper's Fig. 9 shows 5 s); None: all of it.

    Raises:
        LogError: The policy never had full control, or not for so long.
    """
    info, trace = log.info, log.trace
    dt = 1.0 / info.policy_hz
    active = np.flatnonzero(trace.mode == "policy")
    if not len(active):
        raise LogError(f"{log.path}: the policy never had full control ({trace.reason}); there is no energy to count")
    if seconds is not None:
        wanted = round(seconds * info.policy_hz)
        if not 1 <= wanted <= len(active):
            raise LogError(f"{log.path}: {seconds} s asked for, the policy had control for {len(active) * dt:g} s")
        trace = _head(trace, active[wanted - 1] + 2)
        active, info = active[:wanted], replace(info, duration_s=wanted * dt)
    summary = summarise(info, trace)
    sampled = np.maximum(trace.dq[active] * trace.tau[active], 0.0) * dt
    closed = np.append(active, min(active[-1] + 1, len(trace.mode) - 1))
    spent = np.diff(trace.joint_energy_pos_j[closed], axis=0)
    counted = trace.states[closed[-1]] - trace.states[closed[0]]
    errors, state_hz, work, spans = None, None, sampled, np.full(len(active), dt)
    if summary.energy_j_physics is not None and counted > 0:
        work = spent
        # a slot that was skipped, or lost from a damaged log, makes its tick longer
        spans = np.maximum(np.diff(trace.time[closed]), dt / 2)
        elapsed = trace.time[closed[-1]] - trace.time[closed[0]]
        state_hz = float(counted / elapsed)
        errors = sampling_errors(summary.energy_j_50hz, summary.energy_j_physics, dt, 1.0 / state_hz)
    per_joint = work.sum(axis=0)
    fore = fore_joints(log.urdf, log.joint_names)
    return EnergyAccount(
        name=log.path.stem,
        summary=summary,
        seconds=len(active) * dt,
        mass=info.total_mass,
        error_50hz_j=None if errors is None else errors[0],
        error_state_j=None if errors is None else errors[1],
        state_hz=state_hz,
        joints_j=dict(zip(log.joint_names, map(float, per_joint), strict=True)),
        fore_j=None if fore is None else float(per_joint[fore].sum()),
        hind_j=None if fore is None else float(per_joint[~fore].sum()),
        time=trace.time[active] - trace.time[active[0]],
        power_w=work.sum(axis=1) / spans,
        cumulative_j=np.cumsum(work.sum(axis=1)),
    )


def _head(trace: Trace, rows: int) -> Trace:
    """The first rows of a trace; the last of them only closes the period before it."""
    arrays = {field.name: getattr(trace, field.name) for field in fields(trace) if field.name != "reason"}
    cut = {name: values[:rows] for name, values in arrays.items()}
    closing = np.arange(rows) == rows - 1
    return replace(trace, **{**cut, "mode": np.where(closing[: len(cut["mode"])], "damp", cut["mode"])})
