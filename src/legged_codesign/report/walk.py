"""The student's run, from its log: video, gait, power."""

from __future__ import annotations

from dataclasses import dataclass

from deploy import LogError
from deploy.logs.reading import Log
from deploy.measure.account import EnergyAccount, account
from deploy.page.figures import compared_power, joint_energy
from deploy.page.style import BEST, data_uri

from legged_codesign.report import gait
from legged_codesign.report.data import RunData
from legged_codesign.report.page import Picture
from legged_codesign.report.video import film, still_frame


@dataclass(frozen=True)
class Walk:
    """What a page shows of the student's run.

    Attributes:
        video: data URI of an MP4; empty without a log.
        still: data URI of one of its frames, for paper.
        note: how it was drawn, or why it was not.
        gait: the feet over time.
        power: instantaneous and cumulative (Fig. 9).
        joints: work of each joint.
    """

    video: str
    still: str
    note: str
    gait: Picture
    power: Picture
    joints: Picture


def walk(data: RunData) -> Walk:
    """Film, gait and power of a run; what its log does not tell is said in words. Writes `video.mp4` beside it."""
    log = data.log
    if log is None:
        missing = Picture("", data.log_problem)
        return Walk("", "", data.log_problem, missing, missing, missing)
    clip = data.folder / "video.mp4"
    note = film(log, clip)
    power, joints = _power(log)
    video, still = data_uri(clip.read_bytes(), "video/mp4"), data_uri(still_frame(clip), "image/png")
    return Walk(video, still, note, _gait(log), power, joints)


def _gait(log: Log) -> Picture:
    try:
        contacts = gait.read_contacts(log)
    except gait.GaitError as error:
        return Picture("", f"no gait diagram: {error}")
    return Picture.of(gait.diagram(contacts), contacts.sentence())


def _power(log: Log) -> tuple[Picture, Picture]:
    try:
        energy = account(log)
    except LogError as error:
        missing = Picture("", f"no power curves: {error}")
        return missing, missing
    curves = Picture.of(compared_power([energy], ["student"], [BEST]), _energy(energy))
    return curves, Picture.of(joint_energy(energy.joints_j), _legs(energy))


def _energy(energy: EnergyAccount) -> str:
    """Eq. 10 and its sums in joules."""
    summary = energy.summary
    words = f"Eq. 10: {summary.eq10_w_ticks:.0f} W ticks, which is {summary.energy_j_50hz:.4g} J at the policy's rate"
    if summary.energy_j_physics is not None:
        error = "" if energy.error_j is None else f" (sampling error {energy.error_j:.2g} J)"
        words += f"; summed at every state it is {summary.energy_j_physics:.4g} J{error}"
    if summary.mean_power_w is not None and summary.peak_power_w is not None:
        words += f". Mean power {summary.mean_power_w:.3g} W, peak {summary.peak_power_w:.3g} W"
    if summary.cost_of_transport is not None:
        words += f"; cost of transport {summary.cost_of_transport:.3f}"
    return words + "."


def _legs(energy: EnergyAccount) -> str:
    if energy.fore_j is None or energy.hind_j is None:
        return "Positive work of each joint."
    return f"Positive work of each joint: front legs {energy.fore_j:.4g} J, hind legs {energy.hind_j:.4g} J."
