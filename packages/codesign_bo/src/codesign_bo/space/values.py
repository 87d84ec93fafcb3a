"""Values of parameters: which Python and array-library scalars count as numbers and integers."""

from __future__ import annotations

from numbers import Integral, Real

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Value = float | int | str | bool
"""A parameter's value in a design."""


def plain(value: object) -> object:
    """Return a scalar of an array library as the Python value it holds, and others as they are."""
    item = getattr(value, "item", None)
    return item() if callable(item) and getattr(value, "ndim", 0) == 0 else value


def real(value: object) -> float | None:
    """Return a number as a float; None for anything else, booleans and strings too."""
    value = plain(value)
    return float(value) if isinstance(value, Real) and not isinstance(value, bool) else None


def whole(value: object) -> int | None:
    """Return an integer, also one written as a float, as an int; None for anything else, booleans too."""
    value = plain(value)
    if isinstance(value, float) and value.is_integer():
        return int(value)
    return int(value) if isinstance(value, Integral) and not isinstance(value, bool) else None
