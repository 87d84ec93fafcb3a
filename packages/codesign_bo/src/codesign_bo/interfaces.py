"""What crosses the line between a study and the code that evaluates a design.

A study turns each proposal into an `EvalRequest`, hands it to a `Callback` (fine-tune a policy on the
design, then score it) and takes an `EvalResult` back. Both are frozen, picklable and go through JSON
without loss, so that a callback may run in another process or on another machine.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol, get_args

from codesign_bo.errors import DivergedError
from codesign_bo.stopping import Curve, Thresholds

FailureKind = Literal["crash", "timeout", "lost", "diverged", "infeasible"]
"""Why an evaluation has no score (see `codesign_bo.retries` for what is tried again).

- `crash`: the callback raised, ended its process or ran out of memory, or anything else that would happen again.
- `diverged`: its numbers are not finite.
- `infeasible`: the design cannot be evaluated.
- `timeout`: it took longer than its executor or its deadline allows.
- `lost`: nothing is known about the design, because the machine failed or the worker vanished.
"""

Status = Literal["ok", "stopped"] | FailureKind

FAILURE_KINDS: tuple[FailureKind, ...] = get_args(FailureKind)


@dataclass(frozen=True)
class EvalRequest:
    """One design to evaluate.

    Attributes:
        trial: Number of the trial, from 0 (the nominal design).
        attempt: 1 for the first dispatch of this evaluation, one more after each interruption.
        params: Value of every parameter by name, fixed ones included, in the space's order: a float, an int
            or one of the choices of a categorical parameter.
        seed: Seed of everything random in the evaluation, in [0, 2**31); the same in all attempts.
        fidelity: How thorough the evaluation is to be, from 0 (no fine-tuning at all) to 1 (in full).
        workdir: Folder for files of this evaluation. `Study.run` and `Study.confirm` create it.
        deadline: Unix time (s) at which the evaluation should give up, or None.
        token: What identifies this attempt; pass it to `Study.tell` with the result.
        thresholds: What the learning curve must have reached by when, or None (see `stop`).
        repeat: Number of the confirmation run, from 0, if this is one.
    """

    trial: int
    attempt: int
    params: Mapping[str, Any]
    seed: int
    fidelity: float = 1.0
    workdir: Path = Path(".")
    deadline: float | None = None
    token: str = ""
    thresholds: Thresholds | None = None
    repeat: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "params", dict(self.params))
        object.__setattr__(self, "workdir", Path(self.workdir))

    def stop(self, curve: Curve) -> bool:
        """Return whether this evaluation is hopeless and should end with `EvalResult.stopped`.

        Always False unless the study runs with a stopping rule; a callback need not ask at all.

        Args:
            curve: Learning curve so far, pairs (step, value), in the direction of the objective.
        """
        return self.thresholds is not None and self.thresholds.hopeless(curve)

    def to_json(self) -> str:
        """Return this request as one line of JSON."""
        return json.dumps({**asdict(self), "workdir": str(self.workdir)}, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> EvalRequest:
        """Return the request that `to_json` wrote."""
        fields = json.loads(text)
        if fields.get("thresholds") is not None:
            fields["thresholds"] = Thresholds(**fields["thresholds"])
        return cls(**fields)


@dataclass(frozen=True)
class Score:
    """Score of a design at a lower fidelity than in full, such as that of a policy before its fine-tuning.

    Attributes:
        fidelity: Share of the full evaluation behind it, in [0, 1); 0 is the score without any fine-tuning.
        mean: Objective, finite.
        sem: Standard error of `mean`, or None when unknown.
        n: Number of samples behind `mean`, at least 1.

    Raises:
        DivergedError: The mean is not finite.
        ValueError: Another figure is out of range.
    """

    fidelity: float
    mean: float
    sem: float | None = None
    n: int = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "fidelity", float(self.fidelity))
        if not 0.0 <= self.fidelity < 1.0:
            raise ValueError(f"Score.fidelity is {self.fidelity}; it must be in [0, 1), for 1 is the full evaluation")
        _check_figures(self, "Score")


@dataclass(frozen=True)
class EvalResult:
    """Outcome of one evaluation.

    Attributes:
        mean: Objective, averaged over `n` samples (episodes, robots). NaN exactly when not `ok`.
        sem: Standard error of `mean`, in the same unit, or None when unknown. It need not cover what the
            samples share (such as the seed of a fine-tune): the surrogate learns an extra noise term.
        n: Number of samples behind `mean`, at least 1; 0 without a score.
        extras: Other figures worth keeping, by name (energy, tracking error, survival, ...). A study may name
            some of them as further objectives; the standard error of `energy` is then `energy_sem`.
        curve: Learning curve, pairs (step, value).
        status: `"ok"`; `"stopped"` for a hopeless evaluation that was cut short; or the kind of failure.
        message: For a failure, what happened.
        scores: Scores at lower fidelities that came up on the way, in rising order; at least one if stopped.

    Raises:
        DivergedError: An `ok` result has a mean that is not finite.
        ValueError: It has a negative or non-finite `sem`, or `n < 1`; the status is unknown; or a stopped
            result has no score at a lower fidelity.

    Example:
        >>> EvalResult(mean=12.5, sem=0.3, n=64, extras={"energy": 210.0}).ok
        True
    """

    mean: float
    sem: float | None = None
    n: int = 1
    extras: Mapping[str, float] = field(default_factory=dict)
    curve: tuple[tuple[float, float], ...] = ()
    status: Status = "ok"
    message: str = ""
    scores: tuple[Score, ...] = ()

    def __post_init__(self) -> None:
        store = object.__setattr__
        if self.status not in ("ok", "stopped", *FAILURE_KINDS):
            raise ValueError(f"EvalResult.status is {self.status!r}; choose 'ok', 'stopped' or one of {FAILURE_KINDS}")
        store(self, "extras", {str(k): float(v) for k, v in self.extras.items()})
        store(self, "curve", tuple((float(step), float(value)) for step, value in self.curve))
        store(self, "scores", tuple(sorted(self.scores, key=lambda s: s.fidelity)))
        store(self, "message", _storable(self.message))
        if self.status == "ok":
            _check_figures(self, "EvalResult")
            return
        if self.status == "stopped" and not self.scores:
            raise ValueError("a stopped EvalResult needs a score at a lower fidelity; use EvalResult.stopped")
        # One NaN object, because tuples compare by identity first: equal failures compare equal.
        store(self, "mean", math.nan)
        store(self, "sem", None)
        store(self, "n", 0)

    @classmethod
    def failure(cls, kind: FailureKind, message: str, extras: Mapping[str, float] | None = None) -> EvalResult:
        """Return the result of an evaluation that has no score."""
        return cls(mean=math.nan, n=0, extras=extras or {}, status=kind, message=message)

    @classmethod
    def stopped(cls, curve: Curve, fidelity: float, score: Score | None = None) -> EvalResult:
        """Return the result of an evaluation that was cut short because its learning curve is hopeless.

        It is neither a score in full nor a failure: the trial counts, but its value stays at its fidelity.

        Args:
            curve: Learning curve so far, pairs (step, value).
            fidelity: Share of the full evaluation that was done, in [0, 1).
            score: Score so far, if the curve's last value is not in the unit of the objective.

        Raises:
            ValueError: The curve is empty or ends with a value that is not finite, or the fidelity is out of range.
        """
        if score is None:
            if not curve:
                raise ValueError("EvalResult.stopped: the curve is empty, so there is no value to keep")
            score = Score(fidelity, curve[-1][1])
        return cls(mean=math.nan, n=0, curve=tuple(curve), status="stopped", scores=(score,))

    @property
    def ok(self) -> bool:
        """Whether there is a score in full."""
        return self.status == "ok"

    @property
    def failed(self) -> bool:
        """Whether the evaluation failed; one that was stopped has not."""
        return self.status in FAILURE_KINDS

    def to_json(self) -> str:
        """Return this result as one line of strict JSON; non-finite numbers become strings."""
        fields = {
            "mean": _encode(self.mean),
            "sem": self.sem,
            "n": self.n,
            "extras": {k: _encode(v) for k, v in self.extras.items()},
            "curve": [[_encode(step), _encode(value)] for step, value in self.curve],
            "status": self.status,
            "message": self.message,
            "scores": [asdict(score) for score in self.scores],
        }
        return json.dumps(fields, allow_nan=False, sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> EvalResult:
        """Return the result that `to_json` wrote.

        Raises:
            ValueError: The text is no valid result.
        """
        fields = json.loads(text)
        try:
            scores = tuple(Score(**score) for score in fields.get("scores", ()))
            return cls(**{**fields, "mean": float(fields["mean"]), "scores": scores})
        except (AttributeError, KeyError, TypeError) as error:
            raise ValueError(f"not an EvalResult in JSON ({error}): {text[:200]}") from error


class Callback(Protocol):
    """Evaluates one design: a plain function will do.

    It may raise: `Study.run` records that as a `crash` and goes on. It must draw all its randomness from
    `request.seed`, so that an interrupted evaluation gives the same result when it is run again. To save the
    rest of hopeless evaluations, it may show its learning curve to `request.stop` now and then.

    Example:
        >>> def evaluate(request: EvalRequest) -> EvalResult:
        ...     curve = []
        ...     for step in range(1, 401):
        ...         curve.append((step, train_one_step(request)))
        ...         if request.stop(curve):
        ...             return EvalResult.stopped(curve, fidelity=step / 400)
        ...     return EvalResult(*score(request), curve=tuple(curve))
    """

    def __call__(self, request: EvalRequest, /) -> EvalResult:
        """Return the score of `request.params`."""
        ...


def _check_figures(what: EvalResult | Score, name: str) -> None:
    """Make mean, sem and n of a score plain numbers and check them."""
    store = object.__setattr__
    store(what, "mean", float(what.mean))
    store(what, "n", int(what.n))
    if not math.isfinite(what.mean):
        raise DivergedError(
            f"{name}.mean is {what.mean}: a score needs a finite mean; "
            "report a diverged evaluation with EvalResult.failure('diverged', ...)"
        )
    if what.sem is not None:
        store(what, "sem", float(what.sem))
        if not (math.isfinite(what.sem) and what.sem >= 0):
            raise ValueError(f"{name}.sem is {what.sem}: it must be finite and >= 0, or None if unknown")
    if what.n < 1:
        raise ValueError(f"{name}.n is {what.n}: a score needs at least 1 sample")


def _storable(text: object) -> str:
    """Return text that every file can hold: exceptions may quote file names that are no Unicode."""
    return str(text).encode(errors="backslashreplace").decode()


def _encode(value: float) -> float | str:
    return value if math.isfinite(value) else repr(value)
