"""Health checks of a study, in words: what is wrong, how bad it is, and the way out."""

from __future__ import annotations

from collections.abc import Sequence

from codesign_bo.health.check import SEVERITIES, Check, Severity, worst
from codesign_bo.health.model import parameter_effects, predictability
from codesign_bo.health.noise import repeats, standard_errors
from codesign_bo.health.search import bounds, candidates, failures, improvement
from codesign_bo.sensitivity import Effect
from codesign_bo.view import StudyView

__all__ = ["SEVERITIES", "Check", "Severity", "health", "worst"]


def health(view: StudyView, effects: Sequence[Effect] | None = None) -> list[Check]:
    """Return all health checks of a study, the most severe first.

    Args:
        view: The study.
        effects: Its `sensitivity`, if it is known already; it takes a second or more to compute.
    """
    checks = [
        candidates(view),
        failures(view),
        improvement(view),
        parameter_effects(view, effects),
        predictability(view),
        bounds(view),
        standard_errors(view),
        repeats(view),
    ]
    return sorted(checks, key=lambda c: SEVERITIES.index(c.severity))
