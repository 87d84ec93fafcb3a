"""What crosses the line between a study and the code that evaluates a design.

A study turns each proposal into an `EvalRequest`, hands it to a `Callback` (fine-tune a policy on the
design, then score it) and takes an `EvalResult` back. Both are frozen, picklable and go through JSON
without loss, so that a callback may run in another process or on another machine.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol, get_args

FailureKind = Literal["failed", "crash", "timeout", "lost", "diverged", "infeasible"]
Status = Literal["ok"] | FailureKind

FAILURE_KINDS: tuple[FailureKind, ...] = get_args(FailureKind)


@dataclass(frozen=True)
class EvalRequest:
    """One design to evaluate.

    Attributes:
        trial: Number of the trial, from 0 (the nominal design).
        attempt: 1 for the first dispatch of this evaluation, one more after each interruption.
        params: Value of every parameter by name, fixed ones included, in the space's order.
        seed: Seed of everything random in the evaluation, in [0, 2**31); the same in all attempts.
        fidelity: How thorough the evaluation is to be; `"full"` unless the caller says otherwise.
        workdir: Folder for files of this evaluation. `Study.run` and `Study.confirm` create it.
        deadline: Unix time (s) at which the evaluation should give up, or None.
    """

    trial: int
    attempt: int
    params: Mapping[str, float]
    seed: int
    fidelity: str | float = "full"
    workdir: Path = Path(".")
    deadline: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "params", dict(self.params))
        object.__setattr__(self, "workdir", Path(self.workdir))

    def to_json(self) -> str:
        """Return this request as one line of JSON."""
        return json.dumps({**self.__dict__, "workdir": str(self.workdir)}, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> EvalRequest:
        """Return the request that `to_json` wrote."""
        return cls(**json.loads(text))


@dataclass(frozen=True)
class EvalResult:
    """Outcome of one evaluation.

    Attributes:
        mean: Objective, averaged over `n` samples (episodes, robots). NaN exactly when not `ok`.
        sem: Standard error of `mean`, in the same unit, or None when unknown. It need not cover what the
            samples share (such as the seed of a fine-tune): the surrogate learns an extra noise term.
        n: Number of samples behind `mean`, at least 1; 0 for a failure.
        extras: Other figures worth keeping, by name (energy, tracking error, survival, ...).
        curve: Learning curve, pairs (step, value).
        status: `"ok"`, or the kind of failure.
        message: For a failure, what happened.

    Raises:
        ValueError: An `ok` result has a mean that is not finite, a negative or non-finite `sem`, or
            `n < 1`; or the status is unknown.

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

    def __post_init__(self) -> None:
        store = object.__setattr__
        if self.status != "ok" and self.status not in FAILURE_KINDS:
            raise ValueError(f"EvalResult.status is {self.status!r}; choose 'ok' or one of {FAILURE_KINDS}")
        store(self, "extras", {str(k): float(v) for k, v in self.extras.items()})
        store(self, "curve", tuple((float(step), float(value)) for step, value in self.curve))
        store(self, "n", int(self.n))
        if self.status != "ok":
            # One NaN object, because tuples compare by identity first: equal failures compare equal.
            store(self, "mean", math.nan)
            store(self, "sem", None)
            return
        store(self, "mean", float(self.mean))
        if not math.isfinite(self.mean):
            raise ValueError(
                f"EvalResult.mean is {self.mean}: an ok result needs a finite mean; "
                "report a diverged evaluation with EvalResult.failure('diverged', ...)"
            )
        if self.sem is not None:
            store(self, "sem", float(self.sem))
            if not (math.isfinite(self.sem) and self.sem >= 0):
                raise ValueError(f"EvalResult.sem is {self.sem}: it must be finite and >= 0, or None if unknown")
        if self.n < 1:
            raise ValueError(f"EvalResult.n is {self.n}: an ok result needs at least 1 sample")

    @classmethod
    def failure(cls, kind: FailureKind, message: str, extras: Mapping[str, float] | None = None) -> EvalResult:
        """Return the result of an evaluation that has no score."""
        return cls(mean=math.nan, n=0, extras=extras or {}, status=kind, message=message)

    @property
    def ok(self) -> bool:
        """Whether there is a score."""
        return self.status == "ok"

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
            return cls(**{**fields, "mean": float(fields["mean"])})
        except (KeyError, TypeError) as error:
            raise ValueError(f"not an EvalResult in JSON ({error}): {text[:200]}") from error


class Callback(Protocol):
    """Evaluates one design: a plain function will do.

    It may raise: `Study.run` records that as a `crash` and goes on. It must draw all its randomness from
    `request.seed`, so that an interrupted evaluation gives the same result when it is run again.
    """

    def __call__(self, request: EvalRequest, /) -> EvalResult:
        """Return the score of `request.params`."""
        ...


def _encode(value: float) -> float | str:
    return value if math.isfinite(value) else repr(value)
