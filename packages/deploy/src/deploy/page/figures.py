"""The figures of a log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from matplotlib.figure import Figure

from deploy.interfaces import Array
from deploy.logs.reading import Log
from deploy.logs.trace import Trace
from deploy.measure.account import EnergyAccount
from deploy.page.style import ACCENT, BEST, FILL, INK, MUTED, NOMINAL, OTHERS, figure, label

MODE_COLOURS = {
    "idle": "#e3e7ec",
    "passive": "#c9ced6",
    "stand_up": "#d9a441",
    "ready": "#f0dca8",
    "ramp_in": "#8cc5c1",
    "policy": BEST,
    "damp": ACCENT,
}

WINDOW_S = 5.0
"""What a figure of single joints shows, s."""

FRAMES = 12
"""Depth images on a page."""


def compared_power(accounts: Sequence[EnergyAccount], labels: Sequence[str], colours: Sequence[str]) -> Figure:
    """Instantaneous and cumulative positive power of several bodies over time (paper Fig. 9)."""
    made, (top, bottom) = figure(9.2, 5.2, rows=2, sharex=True)
    for body, name, colour in zip(accounts, labels, colours, strict=True):
        top.plot(body.time, body.power_w, color=colour, linewidth=1.1, label=name)
        ends = np.append(body.time, body.seconds)
        bottom.plot(ends, np.concatenate([[0.0], body.cumulative_j]), color=colour, linewidth=1.6)
        if body.error_j is not None:
            bottom.errorbar(body.seconds, body.cumulative_j[-1], yerr=body.error_j, color=colour, capsize=4)
    label(top, "", "positive power, W", "instantaneous: mean of each tick")
    label(bottom, "time under full control, s", "energy, J", "cumulative, with its sampling error")
    top.set_ylim(bottom=0)
    bottom.set_ylim(bottom=0)
    made.legend(frameon=False, fontsize=9, ncols=min(len(accounts), 4), loc="outside upper left")
    return made


def body_colours(accounts: Sequence[EnergyAccount], best: int) -> list[str]:
    """Grey for the nominal body, teal for the best, others as they come."""
    rest = iter(OTHERS * (len(accounts) // len(OTHERS) + 1))
    return [BEST if index == best else NOMINAL if body.nominal else next(rest) for index, body in enumerate(accounts)]


def joint_tracking(log: Log) -> Figure:
    """Targets and angles of every joint, a leg per row, in the first seconds of full control."""
    trace = log.trace
    rows = _window(trace, WINDOW_S)
    made, axes = figure(
        9.2, 1.5 * -(-len(log.joint_names) // 3), rows=-(-len(log.joint_names) // 3), columns=3, sharex=True
    )
    for index, (ax, name) in enumerate(zip(axes, log.joint_names, strict=False)):
        ax.plot(trace.time[rows], trace.q_target[rows, index], color=ACCENT, linewidth=0.9, label="target")
        ax.plot(trace.time[rows], trace.q[rows, index], color=BEST, linewidth=1.2, label="measured")
        label(ax, "", "", name)
    for ax in axes[-3:]:
        ax.set_xlabel("time, s", color=MUTED, fontsize=9.5)
    axes[0].set_ylabel("rad", color=MUTED, fontsize=9.5)
    made.legend(*axes[0].get_legend_handles_labels(), frameon=False, fontsize=8.5, ncols=2, loc="outside upper left")
    return made


def _window(trace: Trace, seconds: float) -> slice:
    """Rows of the first seconds of full control, or of the log."""
    active = np.flatnonzero(trace.mode == "policy")
    first = int(active[0]) if len(active) else 0
    return slice(first, int(np.searchsorted(trace.time, trace.time[first] + seconds)))


def motion(log: Log) -> Figure:
    """Velocity of the base against the command, and its height."""
    trace, command = log.trace, log.info.command
    made, (speed, turn, height) = figure(9.2, 5.0, rows=3, sharex=True)
    for axis, (name, colour) in enumerate((("forward", BEST), ("sideways", NOMINAL))):
        speed.plot(trace.time, trace.velocity[:, axis], color=colour, linewidth=1.0, label=name)
        speed.axhline(command[axis], color=colour, linewidth=1.0, linestyle="--")
    turn.plot(trace.time, trace.yaw_rate, color=BEST, linewidth=1.0)
    turn.axhline(command[2], color=BEST, linewidth=1.0, linestyle="--")
    height.plot(trace.time, trace.position[:, 2], color=INK, linewidth=1.0)
    speed.legend(frameon=False, fontsize=8.5, ncols=2)
    label(speed, "", "m/s", "velocity of the base, command dashed")
    label(turn, "", "rad/s", "yaw rate, command dashed")
    label(height, "time, s", "m", "height of the base in the world")
    return made


def modes(trace: Trace) -> Figure:
    """What drove the joints, over time."""
    made, (ax,) = figure(9.2, 1.3)
    starts = [0, *(np.flatnonzero(trace.mode[1:] != trace.mode[:-1]) + 1), len(trace.mode)]
    period = float(np.median(np.diff(trace.time))) if len(trace.time) > 1 else 0.02
    ends = np.append(trace.time[1:], trace.time[-1] + period)
    shown = set()
    for first, after in pairwise(starts):
        name = str(trace.mode[first])
        ax.barh(
            0,
            ends[after - 1] - trace.time[first],
            left=trace.time[first],
            height=0.8,
            color=MODE_COLOURS.get(name, MUTED),
            label=None if name in shown else name.replace("_", " "),
        )
        shown.add(name)
    ax.set_yticks([])
    ax.grid(visible=False)
    ax.set_xlim(trace.time[0], ends[-1])
    label(ax, "time, s", "")
    made.legend(frameon=False, fontsize=8.5, ncols=7, loc="outside upper left")
    return made


def timing(trace: Trace) -> Figure:
    """How late ticks started and how long they took."""
    made, (left, right) = figure(9.2, 2.8, columns=2)
    for ax, values, name in (
        (left, (trace.time - trace.due) * 1e3, "start after its time, ms"),
        (right, (trace.done - trace.time) * 1e3, "duration up to the command, ms"),
    ):
        ax.hist(values, bins=40, color=FILL, edgecolor=BEST, linewidth=0.6)
        ax.set_yscale("log")
        tail = float(np.percentile(values, 99))
        ax.axvline(tail, color=ACCENT, linewidth=1.2)
        ax.annotate(
            f"99 %: {tail:.2f} ms",
            (tail, 0.9),
            (5, 0),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            color=ACCENT,
            fontsize=9,
        )
        label(ax, name, "ticks")
    return made


def joint_energy(joints: Mapping[str, float]) -> Figure:
    """Positive work of every joint."""
    made, (ax,) = figure(9.2, 0.6 + 0.22 * len(joints))
    ax.barh(list(joints)[::-1], list(joints.values())[::-1], color=BEST, height=0.7)
    ax.grid(axis="y", visible=False)
    label(ax, "positive work, J", "")
    return made


def depth_frames(times: Array, images: np.ndarray) -> Figure:
    """Images as the network read them, evenly over the run; near is bright."""
    chosen = np.unique(np.linspace(0, len(images) - 1, FRAMES).astype(int))
    rows = -(-len(chosen) // 4)
    made, axes = figure(9.2, rows * 2.3 * images.shape[1] / images.shape[2] + 0.3 * rows, rows=rows, columns=4)
    low, high = float(images.min()), float(images.max())
    for ax in axes:
        ax.set_axis_off()
    for ax, index in zip(axes, chosen, strict=False):
        ax.imshow(-images[index], cmap="gray", vmin=-high, vmax=-low if high > low else -low + 1)
        ax.set_title(f"{times[index]:.1f} s", color=MUTED, fontsize=9, loc="left")
    return made
