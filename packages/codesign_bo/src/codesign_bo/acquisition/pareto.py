"""Several objectives: designs that no other beats in all of them, and how much they achieve together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from codesign_bo.space import Array

_MARGIN = 0.1


def non_dominated(values: Array) -> npt.NDArray[np.bool_]:
    """Return which rows of values (n, m), more being better, are not dominated (n,).

    A row dominates another if it is nowhere worse and somewhere better; equal rows do not dominate one another.
    """
    no_worse = (values[:, None] >= values[None]).all(axis=-1)
    better = (values[:, None] > values[None]).any(axis=-1)
    dominated: npt.NDArray[np.bool_] = np.any(no_worse & better, axis=0)
    return ~dominated


def hypervolume(values: Array, reference: Array) -> float:
    """Return the volume that values (n, m), more being better, dominate beyond a reference point (m,).

    Sliced along the last objective, from the best value down (While et al. 2006).
    """
    values = values[(values > reference).all(axis=1)]
    if not len(values):
        return 0.0
    values = values[non_dominated(values)]
    if values.shape[1] == 1:
        return float(values.max() - reference[0])
    values = values[np.argsort(-values[:, -1], kind="stable")]
    ends = np.append(values[1:, -1], reference[-1])
    return sum(
        float(values[i, -1] - end) * hypervolume(values[: i + 1, :-1], reference[:-1])
        for i, end in enumerate(ends)
        if values[i, -1] > end
    )


def reference_point(values: Array) -> Array:
    """Return the point (m,) beyond which a design counts, from values (n, m), more being better.

    In each objective it lies a tenth of the front's range below the front's worst value; where the front has
    no range, that of all designs counts, and where they have none, 1.
    """
    front = values[non_dominated(values)]
    extent = np.ptp(front, axis=0)
    extent = np.where(extent > 0, extent, np.ptp(values, axis=0))
    return front.min(axis=0) - _MARGIN * np.where(extent > 0, extent, 1.0)


@dataclass(frozen=True)
class ParetoFront:
    """The designs that no other beats in all objectives, by the posterior means of the surrogates.

    Attributes:
        objectives: Names of the m objectives; the main one is `"mean"`.
        trials: Trials of the k designs of the front, the best by the main objective first.
        mean: Posterior means (k, m), each in its objective's own unit and direction.
        std: Posterior standard deviations (k, m).
        reference: Reference point (m,) of the hypervolume (see `reference_point`).
        hypervolume: What the front dominates beyond it, in the product of the units.
    """

    objectives: tuple[str, ...]
    trials: tuple[int, ...]
    mean: Array
    std: Array
    reference: Array
    hypervolume: float


def pareto_front(
    objectives: Sequence[str], trials: Sequence[int], mean: Array, std: Array, maximize: Sequence[bool]
) -> ParetoFront:
    """Return the front of n designs, given by their trials, posterior means (n, m) and deviations (n, m)."""
    sign = np.where(maximize, 1.0, -1.0)
    values = sign * mean
    kept = np.flatnonzero(non_dominated(values))
    kept = kept[np.argsort(-values[kept, 0], kind="stable")]
    reference = reference_point(values)
    return ParetoFront(
        tuple(objectives),
        tuple(int(trials[i]) for i in kept),
        mean[kept],
        std[kept],
        sign * reference,
        hypervolume(values[kept], reference),
    )
