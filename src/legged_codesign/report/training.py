"""Pictures of learning: pre-training of the generalist, fine-tuning to each body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from codesign_bo.records import TrialRecord
from deploy.page.style import ACCENT, BEST, INK, figure, label
from matplotlib.figure import Figure

from legged_codesign.config import Objective, RunConfig
from legged_codesign.objective import UNITS, physical


def pretraining(rows: Sequence[Mapping[str, float]]) -> Figure:
    """Reward and tracking error over the pre-training."""
    made, (left, right) = figure(9.2, 2.8, columns=2)
    samples = [row["samples"] / 1e6 for row in rows]
    left.plot(samples, [row["reward"] for row in rows], color=BEST)
    label(left, "million environment steps", "reward per second")
    right.plot(samples, [row["tracking_error"] for row in rows], color=ACCENT)
    right.set_ylim(bottom=0)
    label(right, "million environment steps", "tracking error, m/s (noise on)")
    return made


def fine_tuning(trials: Sequence[TrialRecord], objective: Objective) -> Figure | None:
    """What fine-tuning changed: learning curves, and zero-step score against fine-tuned score.

    None if no trial has a learning curve.
    """
    results = [(t.trial, t.result) for t in trials if t.ok and t.result is not None and t.result.curve]
    if not results:
        return None
    made, (left, right) = figure(9.2, 3.2, columns=2)
    for trial, result in results:
        steps, rewards = zip(*result.curve, strict=True)
        nominal = trial == 0
        left.plot(
            np.array(steps) / 1000,
            rewards,
            color=INK if nominal else BEST,
            alpha=1.0 if nominal else 0.35,
            linewidth=2 if nominal else 1,
            label="nominal" if nominal else None,
        )
    label(left, "thousand environment steps", "reward per second", "fine-tuning of each body")
    left.legend(frameon=False, fontsize=8.5)
    names = ("score_generalist", "score_fine_tuned")
    pairs = np.array(
        [
            [physical(result.extras[name], objective) for name in names]
            for _, result in results
            if all(name in result.extras for name in names)
        ]
    ).reshape(-1, 2)
    right.plot(pairs[:, 0], pairs[:, 1], "o", color=BEST, markersize=6)
    if len(pairs):
        span = [pairs.min(), pairs.max()]
        right.plot(span, span, color=INK, linewidth=1)
    label(right, "generalist, zero-step", "fine-tuned", UNITS[objective])
    return made


def optimises(config: RunConfig) -> str:
    """Does fine-tuning optimise what the search scores? In words."""
    weight: Any = config.finetune.specific_power
    if config.objective == "return" or weight is None:
        return "Fine-tuning maximises the discounted reward whose undiscounted sum the search scores (eq. 9)."
    return (
        f"Fine-tuning does not optimise {config.objective} alone: its reward is the generalist's (velocity tracking "
        f"and smoothness) plus {weight:g} times positive mechanical power over body weight, which is cost of transport "
        "times speed. The search scores the latter only, with a penalty on tracking errors "
        f"above {config.score.max_error:g} m/s."
    )
