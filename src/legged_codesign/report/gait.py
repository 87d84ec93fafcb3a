"""When the feet touched the ground, read from a log, and the gait diagram."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from deploy.logs.reading import Log
from deploy.page.style import BEST, INK, NOMINAL, figure, label
from locorl.interfaces import Array
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader

SHOWN = 4.0
"""What the diagram shows, s."""

_SWING = 2
"""Ticks in the air that make a swing; what is shorter is a contact that flickers."""


class GaitError(ValueError):
    """A log does not tell when the feet touched the ground; the message says why."""


@dataclass(frozen=True)
class Contacts:
    """Feet on the ground while the policy had full control; T ticks, F feet.

    Attributes:
        time: since full control, (T,), s.
        touching: (T, F).
        feet: their names.
        source: where this is known from, in words.
    """

    time: Array
    touching: NDArray[np.bool_]
    feet: tuple[str, ...]
    source: str

    @property
    def duty_factors(self) -> Array:
        """Share of the time that each foot is on the ground, (F,)."""
        return self.touching.mean(axis=0)

    @property
    def stride_rates(self) -> Array:
        """Touch-downs of each foot a second, (F,), 1/s; a swing has at least two ticks."""
        period = float(np.median(np.diff(self.time))) if len(self.time) > 1 else 1.0
        return np.array([_touch_downs(row) for row in self.touching.T]) / (len(self.time) * period)

    def sentence(self) -> str:
        """Duty factors and stride rate in words."""
        each = ", ".join(f"{foot} {share:.2f}" for foot, share in zip(self.feet, self.duty_factors, strict=True))
        mean = float(self.duty_factors.mean())
        kind = "more than half of the time, as in a walk" if mean > 0.5 else "less than half of the time, as in a run"
        aloft = float((~self.touching.any(axis=1)).mean())
        return (
            f"Duty factors (share of the time on the ground): {each}; mean {mean:.2f}, {kind}. Each foot makes "
            f"{self.stride_rates.mean():.2f} strides a second; no foot is down for {100 * aloft:.0f} % of the time. "
            f"{self.source}"
        )


def read_contacts(log: Log) -> Contacts:
    """When each foot touched the ground.

    Where the robot has foot sensors, or a simulator told, the log says so on the topic /foot_contact. From a simulated
    run without it, the contacts are computed again: at each logged pose, a foot touches if MuJoCo finds a contact of
    its geom in the log's scene.

    Raises:
        GaitError: the policy never had full control, or the log holds neither contacts nor poses.
    """
    rows = log.trace.mode == "policy"
    if not rows.any():
        raise GaitError(f"the policy never had full control ({log.trace.reason})")
    logged = _logged(log)
    if logged is not None:
        touching, source = logged, "Contacts as the log holds them (/foot_contact)."
    elif log.scene and np.isfinite(log.trace.position).all():
        touching, source = contacts_from_poses(log), "Contacts computed again from the logged poses."
    else:
        raise GaitError("the log holds neither foot contacts nor poses of the base")
    time = log.trace.time[rows]
    return Contacts(time - time[0], touching[rows], _feet(log, touching.shape[1]), source)


def _logged(log: Log) -> NDArray[np.bool_] | None:
    """Contacts on every tick of the log, (ticks, feet); None if a tick lacks them."""
    found: dict[int, Any] = {}
    with AnyReader([log.path]) as reader:
        connections = [c for c in reader.connections if c.topic == "/foot_contact"]
        for connection, time, raw in reader.messages(connections=connections):
            found[time] = reader.deserialize(raw, connection.msgtype).data
    known = {round(time * 1e-9, 6): np.asarray(data) > 0.5 for time, data in found.items()}
    ticks = [known.get(round(float(time), 6)) for time in log.trace.time]
    return None if any(tick is None for tick in ticks) else np.array(ticks, dtype=bool)


def contacts_from_poses(log: Log) -> NDArray[np.bool_]:
    """Feet in contact at each logged pose, (ticks, feet), by MuJoCo's collision detection in the log's scene.

    Raises:
        GaitError: the log does not name its feet.
    """
    if log.manifest is None:
        raise GaitError("the log does not name its feet: a damaged file lost its manifest")
    model = mujoco.MjModel.from_xml_string(log.scene)
    data, trace = mujoco.MjData(model), log.trace
    geoms = [_foot_geom(model, name) for name in log.manifest["robot"]["feet"]]
    base = model.jnt_qposadr[int(np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)[0])]
    joints = [model.joint(name).qposadr[0] for name in log.joint_names]
    touching = np.zeros((len(trace.time), len(geoms)), dtype=bool)
    for row in range(len(trace.time)):
        data.qpos[base : base + 3] = trace.position[row]
        data.qpos[base + 3 : base + 7] = trace.quat_wxyz[row]
        data.qpos[joints] = trace.q[row]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        touching[row] = np.isin(geoms, data.contact.geom)
    return touching


def _foot_geom(model: mujoco.MjModel, foot: str) -> int:
    """The colliding geom on the body of a foot's site that is nearest to the site."""
    site = model.site(foot)
    own = np.flatnonzero((model.geom_bodyid == site.bodyid[0]) & ((model.geom_contype | model.geom_conaffinity) != 0))
    if not len(own):
        raise GaitError(f"the scene of the log has nothing at foot {foot} that could touch the ground")
    return int(own[np.argmin(np.linalg.norm(model.geom_pos[own] - site.pos, axis=1))])


def _feet(log: Log, count: int) -> tuple[str, ...]:
    if log.manifest is None:
        return tuple(f"foot {i + 1}" for i in range(count))
    return tuple(log.manifest["robot"]["feet"])


def _touch_downs(touching: Sequence[bool] | NDArray[np.bool_]) -> int:
    """Ends of swings in one foot's row; the swing's start need not be seen."""
    count, air = 0, 0
    for down in touching:
        count += bool(down and air >= _SWING)
        air = 0 if down else air + 1
    return count


def diagram(contacts: Contacts) -> Figure:
    """Feet over time: a bar while a foot is on the ground, with its duty factor."""
    made, (ax,) = figure(9.2, 0.42 * len(contacts.feet) + 1.0)
    period = float(np.median(np.diff(contacts.time))) if len(contacts.time) > 1 else 0.02
    window = contacts.time < SHOWN - 1e-9
    end = float(contacts.time[window][-1]) + period
    for y, row in enumerate(contacts.touching[window].T):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], row.astype(int), [0]])))
        spans = [(float(contacts.time[a]), float(b - a) * period) for a, b in zip(edges[::2], edges[1::2], strict=True)]
        # legs on a diagonal share a colour, which shows a trot at once
        ax.broken_barh(spans, (y - 0.36, 0.72), color=BEST if y in (0, 3) else NOMINAL, linewidth=0)
        ax.annotate(
            f"{contacts.duty_factors[y]:.2f}", (1.0, y), (8, 0), xycoords=("axes fraction", "data"),
            textcoords="offset points", va="center", fontsize=9.5, color=INK,
        )  # fmt: skip
    ax.annotate(
        "duty factor", (1.0, 1.0), (8, 6), xycoords="axes fraction", textcoords="offset points", fontsize=8.5,
        color=INK, ha="center",
    )  # fmt: skip
    ax.set_yticks(range(len(contacts.feet)), contacts.feet, fontsize=9)
    ax.set_ylim(len(contacts.feet) - 0.4, -0.6)
    ax.set_xlim(0.0, end)
    ax.grid(axis="y", visible=False)
    label(ax, f"time under full control, s (first {end:.0f} s)", "")
    return made
