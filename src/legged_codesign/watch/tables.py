"""Trials and confirmation runs of a study as rows, and how long the rest will take."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from typing import Any

from codesign_bo.interfaces import EvalResult

from legged_codesign.objective import physical
from legged_codesign.watch.files import Tables
from legged_codesign.watch.state import TrialState


def trial_rows(tables: Tables, objective: Any, held: bool) -> list[TrialState]:
    """The search, by number; a body without a result is running if a process holds the folder."""
    rows: list[TrialState] = []
    best = -math.inf
    for record in tables.trials:
        if record.ok and record.result is not None:
            best = max(best, record.result.mean)
        rows.append(
            TrialState(
                trial=record.trial,
                repeat=None,
                params=dict(record.params),
                origin=record.origin,
                best_so_far=physical(best, objective) if best > -math.inf else None,
                seconds=record.seconds,
                **_outcome(record.result, objective, held),
            )
        )
    return rows


def confirmation_rows(tables: Tables, objective: Any, held: bool) -> list[TrialState]:
    """The runs on fresh seeds, by body and seed."""
    params = {record.trial: dict(record.params) for record in tables.trials}
    seconds = {(attempt.trial, attempt.repeat): attempt.seconds for attempt in tables.attempts if attempt.final}
    return [
        TrialState(
            trial=run.trial,
            repeat=run.repeat,
            params=params.get(run.trial, {}),
            origin=f"seed {run.repeat}",
            seconds=seconds.get((run.trial, run.repeat)),
            **_outcome(run.result, objective, held),
        )
        for run in tables.confirmations
    ]


def best_trial(tables: Tables) -> int | None:
    """The body with the best score of its own; None if none has one."""
    scored = [(record.result.mean, -record.trial) for record in tables.trials if record.ok and record.result]
    return -max(scored)[1] if scored else None


def search_left(tables: Tables, evaluations: int, now: float) -> float | None:
    """Seconds that a number of evaluations still takes, at the pace of those before.

    Args:
        tables: of the study.
        evaluations: that have no result yet, those that are running included.
        now: Unix time, s.

    Returns:
        The prediction; None as long as no evaluation has ended, or if it should be over by now.
    """
    took = [attempt.seconds for attempt in tables.attempts if attempt.final and attempt.seconds is not None]
    if not took:
        return None
    running = [attempt for attempt in tables.attempts if attempt.status == "running"]
    each, spent = statistics.median(took), sum(now - attempt.started for attempt in running if attempt.started)
    left = (evaluations * each - min(spent, len(running) * each)) / max(1, len(running))
    return left if left > 0 else None


def _outcome(result: EvalResult | None, objective: Any, held: bool) -> dict[str, Any]:
    if result is None:
        return {"status": "running" if held else "interrupted"}
    if not result.ok:
        return {"status": result.status, "message": result.message, "curve": _finite(result.curve)}
    return {
        "status": result.status,
        "score": physical(result.mean, objective),
        "sem": result.sem,
        "tracking_error": result.extras.get("tracking_error"),
        "curve": _finite(result.curve),
    }


def _finite(curve: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    return [(step, value) for step, value in curve if math.isfinite(value)]
