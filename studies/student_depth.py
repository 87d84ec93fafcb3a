r"""Whether a student finds its way over hurdles by a depth camera, and whether it needs one.

    python studies/student_depth.py --seeds 1

Fine-tunes the shipped Lite3 parkour generalist on the nominal body on hurdles while estimator and ROA learn beside it,
trains a student with a depth camera under MTS, and the same student with the camera covered on as many samples, and
compares all on the same starts. Works in runs/studies/student-depth (killed at any moment, the same command goes on)
and writes results/lite3-student-depth.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import distill
import numpy as np
import tyro
from deploy.page.style import MUTED, figure, label
from locorl import EvalConfig, read_metrics
from locorl.evaluation.plots import save
from locorl.interfaces import Array
from matplotlib.figure import Figure
from study import RUNS, markdown_table, paired_difference, paired_ratio, write_results

from legged_codesign.config import DistilConfig
from legged_codesign.student_run import StudentConfig, StudentRun

FOLDER = RUNS / "student-depth"
SHARE, MINUTES, POINTS, HEADING, NEAR = 0.85, 60.0, 20.0, 0.15, 0.9
"""Asked: success of the teacher's, minutes of training, points that the blind one is worse, rad of heading error, share
of steps with every predicted heading within 0.3 rad of the oracle."""
COURSES = 4
"""Columns of the map: courses of each level, lest a student learns the way by heart."""
LAST = 0.1
"""Share of the iterations that end a training, over which its headings are judged."""
ALIKE = ("seeing", "blind")


@dataclass(frozen=True)
class Options:
    """Options."""

    seeds: tuple[int, ...] = (1,)
    """Of the students."""
    config: StudentConfig = field(
        default_factory=lambda: StudentConfig(
            robot="lite3",
            policy="lite3-parkour",
            terrain=("hurdles",) * COURSES,
            distil=DistilConfig(
                depth=True,
                robots=128,
                vision=distill.VisionTrainConfig(iterations=600, updates=16, batch=64),
                # fast enough for the longest course
                judged=EvalConfig(seconds=20.0, vx=(0.9, 1.0), robots_per_body=200, reset_joint=0.1, seed=4242),
            ),
        )
    )
    """Of each student; the seed is put in."""


def main() -> None:
    """Train, compare, record."""
    options = tyro.cli(Options, description=__doc__)
    found = {seed: both(options, seed) for seed in options.seeds}
    rows = [row for seed, variants in found.items() for row in table_rows(seed, variants)]
    robots = options.config.distil.judged.robots_per_body
    lines = [
        f"Asked: at least {SHARE:.0%} of the teacher's success within {MINUTES:g} minutes of training; the blind one "
        f"at least {POINTS:g} points worse, on as many samples; heading error below {HEADING:g} rad, and predictions "
        f"within 0.3 rad at more than {NEAR:.0%} of the steps, at the end of the training. {robots} nominal Lite3 on "
        "hurdles of all levels, on courses that no training has seen; a success has reached all waypoints "
        "within 20 s; 95 % intervals are bootstraps over the robots, paired.",
        "",
        *markdown_table(COLUMNS, rows),
        "",
        *(needs_eyes(seed, variants) for seed, variants in found.items()),
        "",
        "![while learning](curves.png)",
    ]
    folder = write_results(
        "lite3-student-depth", lines, {str(seed): each for seed, each in found.items()}, options.seeds
    )
    save(curves(found), folder / "curves.png")
    print("\n".join(lines), f"-> {folder}", sep="\n")


def both(options: Options, seed: int) -> dict[str, dict[str, Any]]:
    """A seeing student and a blind one of the same teacher, or what is left of them."""
    seeing = replace(options.config, seed=seed)
    first = StudentRun(seeing, FOLDER / f"seeing-seed-{seed}")
    vision = replace(seeing.distil.vision_student, blind=True)
    covered = replace(seeing, distil=replace(seeing.distil, vision_student=vision))
    second = StudentRun(covered, FOLDER / f"blind-seed-{seed}", prepared=first.folder)
    found = {}
    for name, run in zip(ALIKE, (first, second), strict=True):
        run.run()
        metrics = read_metrics(run.student.parent / "metrics.jsonl")
        found[name] = {
            **json.loads(run.comparison.read_text(encoding="utf-8")),
            "minutes": sum(row["seconds"] for row in metrics) / 60.0,
            "metrics": metrics,
        }
    return found


COLUMNS = (
    "seed",
    "student",
    "success, teacher",
    "success, student",
    "student / teacher",
    "survival, student",
    "heading error, rad",
    "predicted heading used",
    "within 0.3 rad",
    "minutes",
    "k samples",
    "as asked",
)


def table_rows(seed: int, variants: Mapping[str, Mapping[str, Any]]) -> list[list[str]]:
    """One row for each student."""
    rows = []
    for name, found in variants.items():
        means, metrics = found["means"], found["metrics"]
        share, low, high = paired_ratio(success(found, "student"), success(found, "teacher"))
        end = metrics[-max(1, round(LAST * len(metrics))) :]
        error, used, within = (mean(end, key) for key in ("heading_error", "predicted_use", "within_half_threshold"))
        good = share >= SHARE and found["minutes"] <= MINUTES and error < HEADING and within > NEAR
        rows.append(
            [
                str(seed),
                name,
                f"{means['teacher']['all']['succeeded']:.1%}",
                f"{means['student']['all']['succeeded']:.1%}",
                f"{share:.1%} ({low:.1%} to {high:.1%})",
                f"{means['student']['all']['survived']:.1%}",
                f"{error:.3f}",
                f"{used:.1%}",
                f"{within:.1%}",
                f"{found['minutes']:.1f}",
                f"{metrics[-1]['samples'] / 1000:.0f}",
                ("yes" if good else "no") if name == "seeing" else "",
            ]
        )
    return rows


def needs_eyes(seed: int, variants: Mapping[str, Mapping[str, Any]]) -> str:
    """How much worse the blind one is."""
    lead, low, high = (
        100.0 * each for each in paired_difference(*(success(variants[name], "student") for name in ALIKE))
    )
    good = lead >= POINTS and low > 0.0
    return (
        f"Seed {seed}: the seeing student succeeds {lead:+.1f} points more often than the blind one "
        f"({low:+.1f} to {high:+.1f}){', as asked' if good else '; asked for more'}."
    )


def success(found: Mapping[str, Any], who: str) -> Array:
    """1 for each robot that came through, 0 for the others."""
    return np.asarray(found["robots"][who]["succeeded"], dtype=np.float64)


def mean(rows: Sequence[Mapping[str, float]], key: str) -> float:
    """Of a metric."""
    return float(np.mean([row[key] for row in rows]))


def curves(found: Mapping[int, Mapping[str, Mapping[str, Any]]]) -> Figure:
    """Action loss, heading error and use of the predicted heading while learning."""
    made, axes = figure(11.0, 3.3, columns=3)
    for ax, (key, what) in zip(
        axes,
        (
            ("action_loss", "mean squared error of actions"),
            ("heading_error", "heading error, rad"),
            ("predicted_use", "share of predicted headings used"),
        ),
        strict=True,
    ):
        for seed, variants in found.items():
            for name, each in variants.items():
                rows = each["metrics"]
                x = [row["samples"] / 1e6 for row in rows]
                ax.plot(x, [row[key] for row in rows], linewidth=1.3, label=f"{name}, seed {seed}")
        label(ax, "environment steps, millions", what)
    axes[1].axhline(HEADING, color=MUTED, linewidth=1, linestyle="--")
    axes[0].set_yscale("log")
    axes[0].legend(frameon=False, fontsize=8.5)
    return made


if __name__ == "__main__":
    main()
