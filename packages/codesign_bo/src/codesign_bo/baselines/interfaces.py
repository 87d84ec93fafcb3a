"""What a comparison needs of an optimiser."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from codesign_bo.space import BoxSpace, Value

Params = dict[str, Value]
"""A design: the value of every parameter of the space by name, fixed ones included."""


class Optimiser(Protocol):
    """Suggests designs one at a time and takes their scores, in whatever order they come.

    Several designs may be out at once: `ask` may be called again before the last design is told.
    """

    def ask(self) -> Params:
        """Return the next design to evaluate."""
        ...

    def tell(self, params: Mapping[str, Value], mean: float, sem: float | None = None) -> None:
        """Take the score of a design that `ask` returned.

        Args:
            params: The design.
            mean: Its score, NaN if the evaluation failed and would fail again.
            sem: Standard error of `mean`, None if unknown. Most optimisers have no use for it.

        Raises:
            ValueError: The design was not asked for or is told already, or the score is invalid.
        """
        ...

    def recommend(self) -> Params:
        """Return the design that the optimiser would have its user take, judged by what it was told.

        Raises:
            LookupError: No design has a score yet.
        """
        ...


class OptimiserFactory(Protocol):
    """Makes an optimiser; a class will do."""

    def __call__(self, space: BoxSpace, seed: int, maximize: bool = True, /) -> Optimiser:
        """Return a new optimiser over `space`; the same arguments give the same one."""
        ...
