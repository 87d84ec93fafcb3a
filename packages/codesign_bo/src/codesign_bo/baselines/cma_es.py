"""CMA-ES (pycma) with its defaults, from the nominal design."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from codesign_bo.baselines.base import Baseline, load
from codesign_bo.space import Array, BoxSpace

_SIGMA = 0.3


class CMAES(Baseline[Array]):
    """`cma.CMAEvolutionStrategy` on the unit cube, started at the nominal design with a step of 0.3.

    The distribution is updated with each full population of scores. A design asked for while a whole
    population is out is drawn in addition. Failures rank as the worst of their population.

    Raises:
        ValueError: The space has a single free parameter, for which pycma is not made.
    """

    def __init__(self, space: BoxSpace, seed: int, maximize: bool = True) -> None:
        super().__init__(space, seed, maximize)
        if space.dim < 2:
            raise ValueError(f"CMA-ES needs at least 2 free parameters; this space has {space.free_names}")
        cma: Any = load("cma", "cma")
        start = space.to_unit(space.designs([space.nominal]))[0]
        # a source of its own, because pycma would seed numpy's global one
        normal = np.random.RandomState(seed % 2**32).randn
        options = {"bounds": [0.0, 1.0], "randn": normal, "seed": math.nan, "verbose": -9}
        self._strategy = cma.CMAEvolutionStrategy(start, _SIGMA, options)
        self._ready: list[Array] = []
        self._scored: list[tuple[Array, float]] = []
        self._waiting = 0

    def _suggest(self) -> tuple[Array, Array]:
        if not self._ready:
            # one more from the present distribution while a population is not complete
            self._ready = self._strategy.ask(1 if self._waiting or self._scored else None)
        self._waiting += 1
        point = self._ready.pop(0)
        return point, point

    def _observe(self, handle: Array, loss: float) -> None:
        self._waiting -= 1
        self._scored.append((handle, loss))
        size = self._strategy.popsize
        if len(self._scored) < size:
            return
        population, self._scored = self._scored[:size], self._scored[size:]
        losses = np.array([loss for _, loss in population])
        worst = 0.0 if np.isnan(losses).all() else float(np.nanmax(losses))
        losses[np.isnan(losses)] = worst + 1.0
        self._strategy.tell([point for point, _ in population], losses.tolist())
