"""Rows of a study's tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from codesign_bo.interfaces import EvalResult, FailureKind, Status
from codesign_bo.space import Value

Origin = Literal["nominal", "queued", "sobol", "surrogate"]

Told = Literal["counted", "retry", "repeated", "late"]
"""What a study made of a result.

- `counted`: the trial is finished with it.
- `retry`: it is a failure worth another attempt; the trial is still open and comes back with the next ask,
  unless another attempt at it runs already.
- `repeated`: the same was told before; nothing changed.
- `late`: another attempt had finished the trial; the result is kept for audit (see `Study.attempts`) only.
"""

AttemptStatus = Literal["running", "interrupted", "superseded"] | Status
"""State of an attempt: its outcome, or one of these.

- `running`: dispatched, and nothing heard of it since.
- `interrupted`: its coordinator stopped or died; no fault of the evaluation.
- `superseded`: another attempt finished the trial first.
"""


@dataclass(frozen=True)
class Basis:
    """What a proposal of the surrogate was based on.

    Attributes:
        fit: How the surrogate's hyperparameters came about (see `codesign_bo.models.surrogate.Surrogate.fit`).
        model: Fingerprint of its data and hyperparameters.
        seconds: Time that the fit took.
        pending: Trials that were unfinished then; all other earlier ones were known to the surrogate.
    """

    fit: str
    model: str
    seconds: float
    pending: tuple[int, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "pending", tuple(self.pending))


@dataclass(frozen=True)
class Proposal:
    """A design that is to become a trial, and where it came from.

    Attributes:
        params: Value of every parameter.
        origin: Where the design came from.
        fidelity: How thorough its evaluation is to be, in [0, 1].
        basis: For a proposal of the surrogate, what it was based on.
    """

    params: dict[str, Value]
    origin: Origin
    fidelity: float = 1.0
    basis: Basis | None = None


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
        fidelity: How thorough its evaluation is, in [0, 1].
        basis: What the proposal was based on; not compared, for it holds a time.
        seconds: Time that the deciding attempt took, if the coordinator saw both ends of it; not compared.
    """

    trial: int
    params: Mapping[str, Value]
    seed: int
    origin: Origin
    result: EvalResult | None
    attempts: int = field(default=1, compare=False)
    fidelity: float = 1.0
    basis: Basis | None = field(default=None, compare=False)
    seconds: float | None = field(default=None, compare=False)

    @property
    def status(self) -> Literal["unfinished", "ok", "stopped"] | FailureKind:
        """State of the trial: unfinished, ok, stopped, or the kind of failure."""
        return "unfinished" if self.result is None else self.result.status

    @property
    def ok(self) -> bool:
        """Whether the trial has a score in full."""
        return self.result is not None and self.result.ok and self.fidelity == 1.0

    @property
    def failed(self) -> bool:
        """Whether the trial is finished and failed."""
        return self.result is not None and self.result.failed


@dataclass(frozen=True)
class AttemptRecord:
    """One dispatch of an evaluation.

    Attributes:
        token: What identifies it; a result is told with it.
        trial: Trial whose design is evaluated.
        repeat: Confirmation run, from 0, or None for the search.
        attempt: Number of the dispatch, from 1.
        status: State of the attempt.
        started: Unix time (s) of the dispatch, for people: it jumps with the machine's clock. None if unknown.
        ended: Unix time (s) when it ended or was given up.
        seconds: Time between the two on a steady clock, if one coordinator saw both.
        deadline: Unix time (s) that was passed on to the evaluation, or None.
        message: What happened.
        result: What was told of this attempt, counted or not; None if nothing was.
        final: Whether this attempt settled the evaluation.
        closed: Whether the evaluation was settled after this dispatch; from then on, if it is opened again, the
            attempt does not count against its retries.
    """

    token: str
    trial: int
    repeat: int | None
    attempt: int
    status: AttemptStatus
    started: float | None
    ended: float | None
    seconds: float | None
    deadline: float | None
    message: str
    result: EvalResult | None
    final: bool
    closed: bool


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

    params: Mapping[str, Value]
    trial: int | None


@dataclass(frozen=True)
class ScreeningRecord:
    """A design with a cheap score, at fidelity 0, that helps to choose what to try first.

    Attributes:
        params: Value of every parameter.
        value: The score.
        sem: Its standard error, or None when unknown.
    """

    params: Mapping[str, Value]
    value: float
    sem: float | None = None


@dataclass(frozen=True)
class HistoryRecord:
    """An evaluation of another study that the surrogate learns from.

    Attributes:
        source: Identity of that study.
        trial: Its trial there.
        params: The design, in this study's space.
        result: Its outcome there.
    """

    source: str
    trial: int
    params: Mapping[str, Value]
    result: EvalResult


@dataclass(frozen=True)
class ScoreRecord:
    """A score at a lower fidelity than in full.

    Attributes:
        params: The design.
        fidelity: Share of the full evaluation behind it, in [0, 1).
        mean: The score.
        sem: Its standard error, or None when unknown.
        trial: Trial whose evaluation gave it; None for screening.
    """

    params: Mapping[str, Value]
    fidelity: float
    mean: float
    sem: float | None
    trial: int | None
