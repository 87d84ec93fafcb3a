"""Evaluating in this process, and what may pass from an evaluation into a study."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable
from types import TracebackType
from typing import Self

from codesign_bo.executors.evaluate import failure
from codesign_bo.interfaces import Callback, EvalRequest, EvalResult

logger = logging.getLogger(__name__)


def evaluate(callback: Callback, request: EvalRequest) -> EvalResult:
    """Return `callback(request)`; what it raises becomes a failure.

    Raises:
        OSError: The machine's trouble, such as a full disk, not the design's; likewise MemoryError.
    """
    try:
        return callback(request)
    except (OSError, MemoryError):
        raise
    except Exception as error:
        logger.warning("trial %d: the evaluation raised %s", request.trial, type(error).__name__)
        return failure(error)


class InProcess:
    """Evaluates in this process, one after the other: `submit` returns when the evaluation is done.

    Unlike other executors it lets OSError, MemoryError and KeyboardInterrupt pass.
    """

    slots = 1

    def submit(self, callback: Callback, request: EvalRequest) -> FinishedJob:
        """Evaluate now."""
        return FinishedJob(evaluate(callback, request))

    def close(self) -> None:
        """Do nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass


class FinishedJob:
    """A job that was done at once."""

    def __init__(self, result: EvalResult) -> None:
        self._result = result

    def done(self) -> bool:
        """Whether there is a result."""
        return True

    def result(self) -> EvalResult:
        """Return the outcome."""
        return self._result

    def cancel(self) -> None:
        """Do nothing: it is too late."""


def checked(result: object, objectives: Iterable[str] = ()) -> EvalResult:
    """Return a result that may be stored: numbers that are not finite never get past here.

    Args:
        result: What came back from an evaluation, perhaps unpickled and so never checked.
        objectives: Names of the further objectives.

    Raises:
        TypeError: It is no `EvalResult`.
        ValueError: It lacks a further objective.
    """
    if not isinstance(result, EvalResult):
        raise TypeError(f"the callback returned {type(result).__name__}; it must return an EvalResult")
    if not result.ok:
        return result
    lacking = [name for name in objectives if name not in result.extras]
    if lacking:
        raise ValueError(f"the result has no {lacking} in its extras {list(result.extras)}, but the study needs it")
    figures = {"mean": result.mean, **{name: result.extras[name] for name in objectives}}
    wild = {name: value for name, value in figures.items() if not math.isfinite(value)}
    return EvalResult.failure("diverged", f"not finite: {wild}") if wild else result
