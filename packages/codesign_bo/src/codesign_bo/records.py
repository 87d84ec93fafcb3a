"""Rows of a study's tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from codesign_bo.interfaces import EvalResult, FailureKind

Origin = Literal["nominal", "queued", "sobol", "surrogate"]


@dataclass(frozen=True)
class Proposal:
    """A design that is to become a trial, and where it came from."""

    params: dict[str, float]
    origin: Origin


@dataclass(frozen=True)
class TrialRecord:
    """One trial of the search.

    Attributes:
        trial: Number of the trial.
        params: Value of every parameter.
        seed: Seed of its evaluation.
        origin: Where the design came from.
        result: Its outcome, or None while unfinished.
        attempts: How often it was dispatched; not compared, for interruptions leave no other trace.
    """

    trial: int
    params: Mapping[str, float]
    seed: int
    origin: Origin
    result: EvalResult | None
    attempts: int = field(default=1, compare=False)

    @property
    def status(self) -> Literal["unfinished", "ok"] | FailureKind:
        """State of the trial: unfinished, ok, or the kind of failure."""
        return "unfinished" if self.result is None else self.result.status

    @property
    def ok(self) -> bool:
        """Whether the trial has a score."""
        return self.result is not None and self.result.ok


@dataclass(frozen=True)
class ConfirmationRecord:
    """One evaluation of an already searched design on a fresh seed.

    Attributes:
        trial: Trial whose design this is.
        repeat: Number of the fresh seed, from 0; designs share the seed of a repeat.
        seed: Seed of its evaluation.
        result: Its outcome, or None while unfinished.
        attempts: How often it was dispatched.
    """

    trial: int
    repeat: int
    seed: int
    result: EvalResult | None
    attempts: int = field(default=1, compare=False)


@dataclass(frozen=True)
class QueuedRecord:
    """A design the user wants to be tried, and the trial it became, if it has."""

    params: Mapping[str, float]
    trial: int | None


@dataclass(frozen=True)
class ScreeningRecord:
    """A design with a cheap score that helps to choose what to try first."""

    params: Mapping[str, float]
    value: float
