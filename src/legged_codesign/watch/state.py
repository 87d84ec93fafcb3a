"""Where a run stands: what `codesign status` prints and `codesign watch` shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

Status = Literal["running", "finished", "stopped", "not begun", "damaged", "no run"]
StageStatus = Literal["done", "running", "stopped", "to do"]
Point = tuple[float, float]


@dataclass(frozen=True)
class StageState:
    """One stage of a run.

    Attributes:
        name: of the stage.
        status: where it stands.
        seconds: that it took, or has taken so far; None if unknown.
        left: predicted seconds until its end; None if unknown or not running.
        done: trials, confirmation runs or iterations that are over; None where nothing is counted.
        total: of these.
    """

    name: str
    status: StageStatus
    seconds: float | None = None
    left: float | None = None
    done: int | None = None
    total: int | None = None


@dataclass(frozen=True)
class TrialState:
    """One body of the search, or one confirmation run of it.

    Attributes:
        trial: number of the body.
        repeat: number of the fresh seed; None for the search itself.
        params: its design parameters.
        origin: what proposed it.
        status: ok, running, interrupted, stopped, or the kind of failure.
        score: the objective as the quantity that it stands for; None without one.
        sem: its standard error.
        tracking_error: mean error of the speed, m/s.
        seconds: that the evaluation took.
        best_so_far: best score of this and all earlier bodies.
        curve: learning curve of its fine-tuning, (samples, reward).
        message: what went wrong.
    """

    trial: int
    repeat: int | None
    params: Mapping[str, float | int | str]
    origin: str
    status: str
    score: float | None = None
    sem: float | None = None
    tracking_error: float | None = None
    seconds: float | None = None
    best_so_far: float | None = None
    curve: Sequence[Point] = ()
    message: str = ""


@dataclass(frozen=True)
class Curve:
    """How a quantity of a training went.

    Attributes:
        stage: of the run that trains.
        quantity: its name.
        points: (samples, value), thinned out.
    """

    stage: str
    quantity: str
    points: Sequence[Point]


@dataclass(frozen=True)
class RunState:
    """A run folder at one moment.

    Attributes:
        folder: as it was given.
        status: where the run stands.
        words: the same in a sentence, with what to do.
        problems: files that cannot be read, and why.
        title: preset, robot, task and objective.
        objective: what bodies are scored by; empty if there is no search.
        unit: of the scores.
        higher_is_better: whether the best score is the highest.
        stages: in order.
        elapsed: seconds of all stages so far.
        left: predicted seconds until the end of the run; None if unknown or not running.
        idle: seconds since anything was written; None if nothing was.
        trials: of the search.
        planned: trials that there are to be.
        confirmations: runs on fresh seeds.
        best: number of the best body so far; None if there is none.
        best_params: its design parameters.
        best_is_final: whether it was chosen on fresh seeds.
        result: the outcome of the confirmation in words; empty before.
        curves: of the trainings.
        log: its last lines.
        command: that began the present stage; empty if there is none.
        report: whether there is a report.
    """

    folder: str
    status: Status
    words: str
    problems: Sequence[str] = ()
    title: str = ""
    objective: str = ""
    unit: str = ""
    higher_is_better: bool = False
    stages: Sequence[StageState] = ()
    elapsed: float = 0.0
    left: float | None = None
    idle: float | None = None
    trials: Sequence[TrialState] = ()
    planned: int | None = None
    confirmations: Sequence[TrialState] = ()
    best: int | None = None
    best_params: Mapping[str, float | int | str] = field(default_factory=dict)
    best_is_final: bool = False
    result: str = ""
    curves: Sequence[Curve] = ()
    log: Sequence[str] = ()
    command: str = ""
    report: bool = False

    @property
    def current(self) -> StageState | None:
        """The stage that is running or was stopped."""
        return next((stage for stage in self.stages if stage.status in ("running", "stopped")), None)
