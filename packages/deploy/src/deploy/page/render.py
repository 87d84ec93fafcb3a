"""Writes a log as one HTML file that needs no other and no network."""

from __future__ import annotations

import html
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from deploy.errors import DeployError, LogError
from deploy.logs.reading import Log, read_log
from deploy.measure.account import EnergyAccount, account
from deploy.measure.summary import RunSummary, summarise
from deploy.page import figures
from deploy.page.style import BEST, data_uri, png, stylesheet, svg
from deploy.page.video import make_video


def write_page(log: str | Path, out: str | Path, video_seconds: float = 12.0) -> Path:
    """Write the page of a log.

    Args:
        log: A complete .mcap log.
        out: The .html file.
        video_seconds: Length of the video of a simulated run, s; none at 0.

    Returns:
        Where the page is.

    Raises:
        LogError: The log cannot be read.
        DeployError: The page cannot be written.
    """
    out = Path(out)
    text = render(read_log(log), video_seconds)
    partial = out.with_name(out.name + ".partial")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(text, encoding="utf-8")
        os.replace(partial, out)
    except OSError as error:
        raise DeployError(f"{out}: cannot write the page ({error}); choose another path") from error
    return out


def render(log: Log, video_seconds: float) -> str:
    """The page as text."""
    summary = summarise(log.info, log.trace)
    try:
        energy = account(log)
    except LogError:  # a run that ended before the policy had control has a page all the same
        energy = None
    command = ", ".join(f"{value:g}" for value in summary.command)
    body = ", ".join(f"{name} {value:g}" for name, value in summary.design.items())
    title = f"{summary.bundle} on {summary.robot}"
    parts = [
        f"<h1>{_text(title)}</h1>",
        f'<p class="muted">command ({_text(command)}) m/s, m/s, rad/s for {summary.duration_s:g} s; '
        f"{_text(body)}; {_text(log.path.name)}</p>",
        f'<div class="verdict{"" if summary.completed else " short"}">{_text(_verdict(summary))}</div>',
        _cards(summary, energy),
        *_video(log, video_seconds),
        "<h2>Safety</h2>",
        _figure(figures.modes(log.trace)),
        _transitions(log),
        *_moved(log),
        "<h2>Joint tracking</h2>",
        _figure(figures.joint_tracking(log)),
        f'<p class="muted">The first {figures.WINDOW_S:g} s of full control; angles in rad. '
        f"{summary.clamped} targets were cut to the joint limits.</p>",
        *_power(energy),
        *_timing(log, summary),
        *_depth(log),
        "<h2>Provenance</h2>",
        _provenance(log),
    ]
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{_text(title)}</title>\n<style>{stylesheet()}</style>\n</head>\n<body>\n"
        + "\n".join(parts)
        + "\n</body>\n</html>\n"
    )


def _text(value: object) -> str:
    return html.escape(str(value))


def _figure(drawn: Figure) -> str:
    return f"<figure>{svg(drawn)}</figure>"


def _verdict(summary: RunSummary) -> str:
    if summary.completed:
        return f"The policy ran for the whole {summary.duration_s:g} s."
    return f"The run ended early: {summary.reason}."


def _cards(summary: RunSummary, energy: EnergyAccount | None) -> str:
    cards = [(f"{summary.ticks}", "ticks under full control"), (f"{summary.late} + {summary.skipped}", "late, skipped")]
    if summary.distance_m is not None:
        cards.append((f"{summary.distance_m:.1f} m", f"along the command, of {summary.commanded_m:.1f} m"))
    if summary.tracking_error is not None:
        cards.append((f"{summary.tracking_error:.3f} m/s", "mean speed error"))
    if energy is not None:
        error = "" if energy.error_j is None else f" ± {energy.error_j:.2g}"
        cards.append((f"{energy.energy_j:.4g}{error} J", "positive mechanical work"))
    if summary.cost_of_transport is not None:
        cards.append((f"{summary.cost_of_transport:.3f}", "cost of transport"))
    if summary.peak_power_w is not None:
        cards.append((f"{summary.peak_power_w:.0f} W", "peak power"))
    return (
        '<div class="cards">'
        + "".join(f'<div class="card"><b>{b}</b><span>{s}</span></div>' for b, s in cards)
        + "</div>"
    )


def _video(log: Log, seconds: float) -> list[str]:
    if seconds <= 0:
        return []
    try:
        clip = make_video(log, seconds)
    except (DeployError, ImportError) as error:
        return ["<h2>The run</h2>", f'<p class="muted">No video: {_text(error)}.</p>']
    return [
        "<h2>The run</h2>",
        f'<video controls muted loop playsinline src="{data_uri(clip, "video/mp4")}"></video>',
        '<p class="muted">Drawn again by MuJoCo from the logged pose, in the scene of the bundle.</p>',
    ]


def _transitions(log: Log) -> str:
    trace = log.trace
    first = [0, *(np.flatnonzero(trace.mode[1:] != trace.mode[:-1]) + 1)]
    rows = [(f"{trace.time[row]:.2f} s", str(trace.mode[row]).replace("_", " ")) for row in first]
    if trace.mode[-1] == "damp":
        rows[-1] = (rows[-1][0], f"damp: {trace.reason}")
    else:
        rows.append((f"{trace.time[-1]:.2f} s", trace.reason))
    return _table(rows)


def _table(rows: Sequence[tuple[object, object]]) -> str:
    return "<table>" + "".join(f"<tr><td>{_text(a)}</td><td>{_text(b)}</td></tr>" for a, b in rows) + "</table>"


def _moved(log: Log) -> list[str]:
    if not np.isfinite(log.trace.velocity).all():
        return []
    return ["<h2>Motion</h2>", _figure(figures.motion(log))]


def _power(energy: EnergyAccount | None) -> list[str]:
    if energy is None:
        return []
    summary = energy.summary
    at_ticks = f"Eq. 10: {summary.eq10_w_ticks:.0f} W·ticks, which is {summary.energy_j_50hz:.4g} J"
    if summary.energy_j_physics is not None:
        at_ticks += f"; summed at {energy.state_hz:.0f} Hz it is {summary.energy_j_physics:.4g} J"
    if energy.error_50hz_j is not None and energy.error_state_j is not None:
        at_ticks += f" (sampling errors {energy.error_50hz_j:.2g} and {energy.error_state_j:.2g} J)"
    legs = ""
    if energy.fore_j is not None and energy.hind_j is not None:
        legs = f" Front legs {energy.fore_j:.4g} J, hind legs {energy.hind_j:.4g} J."
    return [
        "<h2>Power</h2>",
        _figure(figures.compared_power([energy], [energy.name], [BEST])),
        _figure(figures.joint_energy(energy.joints_j)),
        f'<p class="muted">{at_ticks}.{legs}</p>',
    ]


def _timing(log: Log, summary: RunSummary) -> list[str]:
    trace = log.trace
    heading = "<h2>Timing</h2>"
    if not (trace.done > trace.time).any():
        return [heading, '<p class="muted">A virtual clock: time stood still while the controller computed.</p>']
    elapsed = trace.time[-1] - trace.time[0]
    rate = (len(trace.time) - 1) / elapsed if elapsed > 0 else 0.0
    return [
        heading,
        _figure(figures.timing(trace)),
        f'<p class="muted">{rate:.2f} Hz on average; under full control {summary.late} ticks started late and '
        f"{summary.skipped} slots were skipped.</p>",
    ]


def _depth(log: Log) -> list[str]:
    if not len(log.depth):
        return []
    image = data_uri(png(figures.depth_frames(log.depth_time, log.depth)), "image/png")
    return [
        "<h2>Depth</h2>",
        f'<figure><img alt="depth images" src="{image}"></figure>',
        f'<p class="muted">{len(log.depth)} images entered the network, {log.depth.shape[2]} by {log.depth.shape[1]} '
        "pixels; near is bright.</p>",
    ]


def _provenance(log: Log) -> str:
    rows: list[tuple[object, object]] = [("bundle", f"{log.info.bundle}, manifest SHA-256 {log.info.bundle_sha256}")]
    for name in ("policy", "provenance", "controller", "closed", "recovery"):
        for key, value in log.metadata.get(name, {}).items():
            rows.append((f"{name}: {key}", value))
    return _table(rows)
