"""What a study knows, as arrays for models."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from codesign_bo.interfaces import EvalResult
from codesign_bo.space import Array


@dataclass(frozen=True)
class Observations:
    """Scores in full of one objective: the study's own trials by number, then imported ones as they came.

    Attributes:
        x: Points (n, dim) of the unit cube.
        y: Means (n,).
        sem: Standard errors (n,), NaN where unknown.
        imported: Which of them come from other studies (n,).
        trial: Number of the trial (n,), in its own study.
    """

    x: Array
    y: Array
    sem: Array
    imported: npt.NDArray[np.bool_]
    trial: npt.NDArray[np.int64]


@dataclass(frozen=True)
class Viability:
    """Which designs could be evaluated at all, for a model of the probability that one can.

    Attributes:
        x: Points (n, dim) of the unit cube: the study's own trials by number, then imported ones.
        viable: Whether the evaluation gave numbers (n,), also if it was stopped early.
    """

    x: Array
    viable: npt.NDArray[np.bool_]


def tells_viability(result: EvalResult) -> bool:
    """Return whether a result says anything of the design; a lost evaluation does not."""
    return result.status != "lost"


def figure(result: EvalResult, objective: str | None) -> tuple[float, float]:
    """Return mean and standard error (NaN where unknown) of an objective in a result that is ok.

    Args:
        result: The result.
        objective: A further objective by name, or None for the main one.
    """
    if objective is None:
        return result.mean, np.nan if result.sem is None else result.sem
    return result.extras[objective], result.extras.get(f"{objective}_sem", np.nan)
