"""Searches that learn nothing: uniform random designs, and a scrambled Sobol sequence."""

from __future__ import annotations

import numpy as np

from codesign_bo.baselines.base import Baseline
from codesign_bo.space import Array, BoxSpace, sobol_points


class RandomSearch(Baseline[None]):
    """Independent uniform designs."""

    def __init__(self, space: BoxSpace, seed: int, maximize: bool = True) -> None:
        super().__init__(space, seed, maximize)
        self._rng = np.random.default_rng(seed)

    def _suggest(self) -> tuple[Array, None]:
        return self._rng.random(self.space.dim), None

    def _observe(self, handle: None, loss: float) -> None:
        pass


class SobolSearch(Baseline[None]):
    """The points of a scrambled Sobol sequence, one after the other."""

    def __init__(self, space: BoxSpace, seed: int, maximize: bool = True) -> None:
        super().__init__(space, seed, maximize)
        self._seed = seed % 2**31
        self._asked = 0

    def _suggest(self) -> tuple[Array, None]:
        (point,) = sobol_points(self.space, 1, self._seed, skip=self._asked)
        self._asked += 1
        return point, None

    def _observe(self, handle: None, loss: float) -> None:
        pass
