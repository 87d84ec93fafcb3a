"""The worker's side of an evaluation: whatever the callback does becomes a line of JSON."""

from __future__ import annotations

import pickle
import traceback
from collections.abc import Callable

from codesign_bo.errors import DivergedError
from codesign_bo.interfaces import Callback, EvalRequest, EvalResult, FailureKind

CANCELLED = EvalResult.failure("lost", "cancelled")

_TAIL = 2000


def evaluate(callback: Callback, request: EvalRequest) -> str:
    """Return `callback(request)` as JSON, or as a failure in JSON what went wrong.

    Only text goes back, so neither an exception nor a result can be something that does not unpickle.

    Raises:
        KeyboardInterrupt: The user stopped the evaluation.
    """
    try:
        request.workdir.mkdir(parents=True, exist_ok=True)
        result = callback(request)
        if not isinstance(result, EvalResult):
            raise TypeError(f"the callback returned {type(result).__name__}; it must return an EvalResult")
        text = result.to_json()
        EvalResult.from_json(text)  # an object made without __init__ may hold anything
        return text
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # SystemExit too: a pool's thread would pass it on to the coordinator
        return failure(error).to_json()


def failure(error: BaseException) -> EvalResult:
    """Return what an exception says of an evaluation, with the end of its traceback."""
    kind: FailureKind = "crash"
    if isinstance(error, OSError):
        kind = "lost"
    elif isinstance(error, (DivergedError, FloatingPointError)):
        kind = "diverged"
    return EvalResult.failure(kind, "".join(traceback.format_exception(error))[-_TAIL:])


class PickledCallback:
    """A callback as bytes, loaded inside the evaluation, so that a failure to load is a failure of the trial.

    Args:
        callback: The callback.
        dumps: How to pickle it.

    Raises:
        TypeError: It cannot be pickled.
    """

    def __init__(self, callback: Callback, dumps: Callable[[Callback], bytes] = pickle.dumps) -> None:
        try:
            self._pickled = dumps(callback)
        except Exception as error:
            raise TypeError(
                f"the callback {callback!r:.200} cannot be sent to another process ({error}); make it a function at "
                "the top level of a module, or functools.partial of one"
            ) from error

    def __call__(self, request: EvalRequest, /) -> EvalResult:
        """Evaluate with the original."""
        return pickle.loads(self._pickled)(request)
