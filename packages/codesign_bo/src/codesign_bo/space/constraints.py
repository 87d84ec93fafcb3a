"""Linear constraints between parameters, in natural units and as a polytope in the unit cube."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from codesign_bo.space.parameters import AnyParameter, Categorical, Continuous
from codesign_bo.space.polytope import Polytope
from codesign_bo.space.values import Array, real

TOLERANCE = 1e-9
"""How far a sum may lie beyond its bound, relative to the largest sum of absolute terms in the box."""


@dataclass(frozen=True)
class LinearConstraint:
    """Bounds on a weighted sum of numeric parameters, in natural units: `low <= sum of c_i x_i <= high`.

    Attributes:
        coefficients: Weight of each parameter that takes part, by name.
        low: Lower bound of the sum, or None.
        high: Upper bound of the sum, or None.

    Raises:
        ValueError: A coefficient is 0 or not finite, or the bounds leave nothing or everything.

    Example:
        >>> print(LinearConstraint({"front_thigh": 1, "front_shank": 1}, high=2.4))
        front_thigh + front_shank <= 2.4
    """

    coefficients: Mapping[str, float] = field(hash=False)
    low: float | None = None
    high: float | None = None

    def __post_init__(self) -> None:
        numbers = {n: real(c) for n, c in self.coefficients.items()}
        bad = [n for n, c in numbers.items() if c is None or c == 0 or not math.isfinite(c)]
        if bad or not numbers:
            raise ValueError(
                f"linear constraint: coefficients must be finite numbers other than 0, got {dict(self.coefficients)}"
            )
        bounds = [real(b) for b in (self.low, self.high) if b is not None]
        finite = [b for b in bounds if b is not None and math.isfinite(b)]
        if not bounds or bounds != sorted(finite):
            raise ValueError(
                f"linear constraint of {list(numbers)}: low is {self.low!r}, high is {self.high!r}; "
                "give one or both as finite numbers, low <= high"
            )
        object.__setattr__(self, "coefficients", numbers)
        for key in ("low", "high"):
            object.__setattr__(self, key, real(getattr(self, key)))

    def __str__(self) -> str:
        words: list[str] = []
        for name, c in self.coefficients.items():
            factor = "" if abs(c) == 1 else f"{abs(c)!r}*"
            sign = ("- " if c < 0 else "+ ") if words else ("-" if c < 0 else "")
            words.append(f"{sign}{factor}{name}")
        total = " ".join(words)
        if self.low is not None and self.low == self.high:
            return f"{total} == {self.low!r}"
        left = "" if self.low is None else f"{self.low!r} <= "
        return left + total + ("" if self.high is None else f" <= {self.high!r}")

    @property
    def bounds(self) -> tuple[float, float]:
        """Lower and upper bound of the sum, infinite where there is none."""
        return (-math.inf if self.low is None else self.low, math.inf if self.high is None else self.high)


def satisfied(
    parameters: Sequence[AnyParameter], constraints: Sequence[LinearConstraint], designs: Array
) -> npt.NDArray[np.bool_]:
    """Return which of k constraints the designs (n, d) in natural units satisfy, as (n, k).

    A sum may exceed its bound by what rounding and an optimiser on the bound leave (`TOLERANCE`).
    """
    weights, low, high = _matrix(parameters, constraints)
    largest = np.array([max(abs(p.low), abs(p.high)) for p in parameters])
    slack = TOLERANCE * (np.abs(weights) @ largest)
    sums = designs @ weights.T
    return (sums >= low - slack) & (sums <= high + slack)


def as_polytope(parameters: Sequence[AnyParameter], constraints: Sequence[LinearConstraint]) -> Polytope:
    """Return the constraints as a polytope over the free parameters; fixed ones are folded in.

    Its coordinates are those of the unit cube for continuous parameters, and the number of the bin, an
    integer, for the others. Each row is scaled to a range of 1 over the box.
    """
    weights, low, high = _matrix(parameters, constraints)
    free = np.array([not p.fixed for p in parameters])
    scale = np.array([p.high - p.low if isinstance(p, Continuous) else 1.0 for p in parameters])
    origin = np.array([float(p.low) if not p.fixed else p.encode(p.nominal) for p in parameters])
    shift = weights @ origin
    matrix = (weights * scale)[:, free]
    upper = np.array([1.0 if isinstance(p, Continuous) else p.count - 1.0 for p in parameters])[free]
    spread = np.abs(matrix) @ upper
    spread[spread == 0] = 1.0
    integral = np.array([not isinstance(p, Continuous) for p in parameters])[free]
    return Polytope(matrix / spread[:, None], (low - shift) / spread, (high - shift) / spread, upper, integral)


def check_constraints(parameters: Sequence[AnyParameter], constraints: Sequence[LinearConstraint]) -> None:
    """Refuse constraints that make no sense, that no design satisfies, or that the nominal one breaks.

    Raises:
        ValueError: Naming the constraint.
    """
    known = {p.name: p for p in parameters}
    for constraint in constraints:
        for name in constraint.coefficients:
            if name not in known:
                raise ValueError(f"linear constraint {constraint}: unknown parameter {name}; choose from {list(known)}")
            p = known[name]
            if isinstance(p, Categorical):
                raise ValueError(f"linear constraint {constraint}: {name} is categorical; use a feasibility predicate")
            if isinstance(p, Continuous) and p.log and not p.fixed:
                raise ValueError(
                    f"linear constraint {constraint}: {name} is on a log scale, where the constraint is not linear; "
                    "use log=False or a feasibility predicate"
                )
    nominal = np.array([[p.encode(p.nominal) for p in parameters]])
    broken = [
        c for c, good in zip(constraints, satisfied(parameters, constraints, nominal)[0], strict=True) if not good
    ]
    if not broken:
        return
    for i, constraint in enumerate(constraints):
        if as_polytope(parameters, [constraint]).is_empty():
            raise ValueError(
                f"no design within the bounds satisfies the linear constraint {constraint}; loosen it or the bounds"
            )
        if as_polytope(parameters, constraints[: i + 1]).is_empty():
            raise ValueError(
                f"no design within the bounds satisfies the linear constraint {constraint} together with "
                f"{', '.join(map(str, constraints[:i]))}; loosen one of them or the bounds"
            )
    raise ValueError(
        f"the nominal design breaks the linear constraint {broken[0]}; "
        "choose other nominal values (BoxSpace.with_nominal) or loosen it"
    )


def _matrix(parameters: Sequence[AnyParameter], constraints: Sequence[LinearConstraint]) -> tuple[Array, Array, Array]:
    """Return weights (k, d), lower bounds (k,) and upper bounds (k,) in natural units."""
    rows = [[c.coefficients.get(p.name, 0.0) for p in parameters] for c in constraints]
    bounds = np.array([c.bounds for c in constraints], dtype=float).reshape(-1, 2)
    return np.array(rows, dtype=float).reshape(-1, len(parameters)), bounds[:, 0], bounds[:, 1]
