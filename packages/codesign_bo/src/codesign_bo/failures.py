"""Where failures cluster: the part of the space in which designs fail more often than elsewhere."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from codesign_bo.data import tells_viability
from codesign_bo.space import Array, BoxSpace, Categorical, Integer
from codesign_bo.view import StudyView

Mask = npt.NDArray[np.bool_]

_CUTS = 9
_SHUFFLES = 500
_CHANCE = 0.05
_WORTH = 3.84  # a second condition must add this much to the deviance: chi-squared, one degree of freedom, 95 %
_MIN_FAILURES = 3


@dataclass(frozen=True)
class Cluster:
    """A part of the space where designs fail.

    Attributes:
        where: One or two conditions in words, such as `thigh > 1.2`.
        failed_inside: Failed designs inside.
        inside: Designs inside.
        failed_outside: Failed designs outside.
        outside: Designs outside.
        chance: Probability of as clear a part if failures had nothing to do with the design.
    """

    where: tuple[str, ...]
    failed_inside: int
    inside: int
    failed_outside: int
    outside: int
    chance: float

    def sentence(self) -> str:
        """The cluster in words."""
        return (
            f"failures cluster where {' and '.join(self.where)}: {self.failed_inside} of {self.inside} failed there, "
            f"{self.failed_outside} of {self.outside} elsewhere"
        )


def failure_cluster(view: StudyView, seed: int = 0) -> Cluster | None:
    """Return the part of the space where failures cluster, or None if they do so no more than by chance.

    Parts are half-spaces along one parameter and the corners of two of them. The part that explains the failures
    best is held against the best one of shuffled failures, so having looked at many parts is accounted for.

    Args:
        view: The study; what was lost says nothing about a design and is left out.
        seed: Seed of the shuffling.
    """
    known = [(t.params, t.failed) for t in view.trials() if t.result is not None and tells_viability(t.result)]
    failed = np.array([bad for _, bad in known], dtype=bool)
    if failed.sum() < _MIN_FAILURES or failed.all():
        return None
    names, sides = _sides(view.space, view.space.designs(params for params, _ in known))
    if not names:
        return None
    pairs = list(itertools.combinations(range(len(names)), 2))
    corners = np.array([sides[i] & sides[j] for i, j in pairs]).reshape(-1, len(failed))
    masks = np.concatenate([sides, corners])
    rng = np.random.default_rng(seed)
    shuffled = np.array([rng.permutation(failed) for _ in range(_SHUFFLES)])
    scores = _deviance(masks, failed[None])[:, 0]
    best = int(np.argmax(scores))
    half = int(np.argmax(scores[: len(names)]))
    if scores[half] > scores[best] - _WORTH:
        best = half
    by_chance = _deviance(masks, shuffled).max(axis=0)
    chance = float((1 + np.sum(by_chance >= scores[best])) / (1 + _SHUFFLES))
    if chance > _CHANCE:
        return None
    where = (names[best],) if best < len(names) else tuple(names[i] for i in pairs[best - len(names)])
    inside = masks[best]
    return Cluster(
        where,
        int(np.sum(failed & inside)),
        int(np.sum(inside)),
        int(np.sum(failed & ~inside)),
        int(np.sum(~inside)),
        chance,
    )


def _sides(space: BoxSpace, designs: Array) -> tuple[list[str], Mask]:
    """Return half-spaces in words, and which designs (n, d) are inside, as (m, n)."""
    names: list[str] = []
    masks: list[Mask] = []
    for column, parameter in zip(designs.T, space.parameters, strict=True):
        values = np.unique(column)
        if isinstance(parameter, Categorical):
            for value in values if len(values) > 1 else ():
                names.append(f"{parameter.name} is {parameter.decode(float(value))}")
                masks.append(column == value)
            continue
        cuts = (values[1:] + values[:-1]) / 2.0
        if len(cuts) > _CUTS:
            cuts = np.unique(np.quantile(cuts, np.linspace(0.0, 1.0, _CUTS), method="nearest"))
        for cut in cuts:
            shown = f"{int(np.floor(cut))}" if isinstance(parameter, Integer) else f"{cut:.3g}"
            names += [f"{parameter.name} > {shown}", f"{parameter.name} <= {shown}"]
            masks += [column > cut, column <= cut]
    return names, np.array(masks, dtype=bool).reshape(len(names), len(designs))


def _deviance(masks: Mask, failed: Mask) -> Array:
    """Return how much better two failure rates, inside and outside, explain failures than one does.

    Args:
        masks: Parts (m, n).
        failed: Sets of failures (k, n), all of the same size.

    Returns:
        Differences of deviance (m, k); 0 where the rate inside is not the higher one.
    """
    n, bad = masks.shape[1], float(failed[0].sum())
    inside = masks.sum(axis=1, dtype=float)[:, None]
    hit = masks.astype(float) @ failed.T.astype(float)
    fit = _log_rate(hit, inside) + _log_rate(bad - hit, n - inside) - _log_rate(np.array(bad), np.array(float(n)))
    higher = hit * (n - inside) > (bad - hit) * inside
    return np.where(higher, 2.0 * fit, 0.0)


def _log_rate(hits: Array, of: Array) -> Array:
    """Return the highest log likelihood of `hits` out of `of` under one rate."""
    misses = of - hits
    share = np.divide(hits, of, out=np.full(np.broadcast(hits, of).shape, 0.5), where=of > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.nan_to_num(hits * np.log(share)) + np.nan_to_num(misses * np.log1p(-share))
