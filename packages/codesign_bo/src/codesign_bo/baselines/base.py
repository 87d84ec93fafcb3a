"""What all baselines share: designs that are out, scores as losses, the best observed design."""

from __future__ import annotations

import importlib
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import ModuleType
from typing import Generic, TypeVar

import numpy as np

from codesign_bo.baselines.interfaces import Params
from codesign_bo.space import Array, BoxSpace, Value

Handle = TypeVar("Handle")
"""What a library calls a design that is out."""


class Baseline(ABC, Generic[Handle]):
    """An optimiser that searches the unit cube, minimises a loss, and recommends the best observed design.

    Args:
        space: What is searched.
        seed: Seed of everything random, at least 0.
        maximize: Whether higher means are better.

    Raises:
        ValueError: The seed is negative, or the space has linear constraints.
    """

    def __init__(self, space: BoxSpace, seed: int, maximize: bool = True) -> None:
        if seed < 0:
            raise ValueError(f"seed is {seed}; it must be >= 0")
        if space.constraints:
            raise ValueError("the baselines know nothing of linear constraints; give them a space without")
        self.space = space
        self.maximize = maximize
        self._out: dict[tuple[Value, ...], list[Handle]] = {}
        self._best: tuple[float, Params] | None = None

    def ask(self) -> Params:
        """Return the next design to evaluate (see `Optimiser.ask`)."""
        point, handle = self._suggest()
        params = self.space.params(self.space.from_unit(np.asarray(point, dtype=float)[None])[0])
        self._out.setdefault(self._key(params), []).append(handle)
        return params

    def tell(self, params: Mapping[str, Value], mean: float, sem: float | None = None) -> None:
        """Take the score of a design (see `Optimiser.tell`)."""
        check_score(mean, sem)
        key = self._key(params)
        if not self._out.get(key):
            raise ValueError(f"design {dict(params)} is not out: it was not asked for, or is told already")
        loss = -mean if self.maximize else mean
        self._observe(self._out[key].pop(0), loss)
        if not math.isnan(loss) and (self._best is None or loss < self._best[0]):
            self._best = (loss, {name: params[name] for name in self.space.names})

    def recommend(self) -> Params:
        """Return the best observed design, the first of equals (see `Optimiser.recommend`)."""
        if self._best is None:
            raise LookupError("nothing to recommend: no design has a score yet")
        return dict(self._best[1])

    @abstractmethod
    def _suggest(self) -> tuple[Array, Handle]:
        """Return a point (dim,) of the unit cube and what `_observe` is to get with its loss."""

    @abstractmethod
    def _observe(self, handle: Handle, loss: float) -> None:
        """Take the loss of a point, NaN for a failure."""

    def _key(self, params: Mapping[str, Value]) -> tuple[Value, ...]:
        return tuple(params[name] for name in self.space.names)


def check_score(mean: float, sem: float | None) -> None:
    """Raise ValueError unless `mean` is finite or NaN and `sem` is None or finite and not negative."""
    if math.isinf(mean):
        raise ValueError(f"mean is {mean}; give a finite score, or NaN for a failed evaluation")
    if sem is not None and not (math.isfinite(sem) and sem >= 0):
        raise ValueError(f"sem is {sem}; it must be finite and >= 0, or None if unknown")


def load(module: str, package: str) -> ModuleType:
    """Import a library that is no dependency of this package.

    Args:
        module: What to import.
        package: The distribution that has it.

    Raises:
        ImportError: It is not installed.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module.partition(".")[0]:
            raise
        raise ImportError(
            f"this optimiser needs {package}, which is not installed; "
            "install it with: pip install 'legged-codesign-bo[baselines]'"
        ) from error
