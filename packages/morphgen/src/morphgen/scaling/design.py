"""Named, bounded design parameters of a family of bodies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from morphgen.errors import MorphologyError

SCALE_NAMES = ("front_thigh", "front_shank", "hind_thigh", "hind_shank")
"""Order of the four leg scales, as xi_0 ... xi_3 in the note of Table II."""


@dataclass(frozen=True)
class DesignSpace:
    """A box of design parameters.

    Attributes:
        names: the d parameters, in the order of every design vector.
        low: (d,) lower bounds, included.
        high: (d,) upper bounds, included.
        nominal: (d,) the unmodified robot.
    """

    names: tuple[str, ...]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    nominal: NDArray[np.float64]

    def __post_init__(self) -> None:
        for field in ("low", "high", "nominal"):
            values = np.array(getattr(self, field), dtype=np.float64)
            if values.shape != (len(self.names),):
                raise MorphologyError(f"design space: {field} needs {len(self.names)} values, got {values.shape}")
            values.flags.writeable = False
            object.__setattr__(self, field, values)
        if not (np.all(self.low <= self.nominal) and np.all(self.nominal <= self.high)):
            raise MorphologyError("design space: needs low <= nominal <= high for every parameter")

    @classmethod
    def leg_scales(cls, low: float = 0.6, high: float = 1.4) -> DesignSpace:
        """The paper's four leg scales (Section III-B), all in [low, high], nominal 1."""
        d = len(SCALE_NAMES)
        return cls(SCALE_NAMES, np.full(d, low), np.full(d, high), np.ones(d))

    @property
    def dim(self) -> int:
        """Number of parameters d."""
        return len(self.names)

    def contains(self, designs: ArrayLike) -> NDArray[np.bool_]:
        """Whether each design lies in the box: (n, d) -> (n,). NaN lies outside."""
        x = np.atleast_2d(np.asarray(designs, dtype=np.float64))
        return np.all((x >= self.low) & (x <= self.high), axis=-1)

    def validated(self, designs: ArrayLike) -> NDArray[np.float64]:
        """A float64 copy of the designs, (n, d); a single design (d,) becomes (1, d).

        Raises:
            MorphologyError: wrong shape, or a value that is not finite or out of bounds; names the
                design's row and the parameter.
        """
        try:
            x = np.atleast_2d(np.array(designs, dtype=np.float64))
        except (TypeError, ValueError) as error:
            raise MorphologyError(f"designs must be numbers of shape (n, {self.dim}): {error}") from error
        if x.ndim != 2 or x.shape[1] != self.dim:
            raise MorphologyError(
                f"designs need shape (n, {self.dim}) in the order {', '.join(self.names)}; got {x.shape}"
            )
        outside = ~((x >= self.low) & (x <= self.high))
        if outside.any():
            row, column = np.argwhere(outside)[0]
            raise MorphologyError(
                f"design {row}: {self.names[column]} = {x[row, column]:g} is outside "
                f"[{self.low[column]:g}, {self.high[column]:g}]"
            )
        return x
