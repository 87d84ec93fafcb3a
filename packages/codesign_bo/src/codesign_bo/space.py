"""The box that is searched: named, bounded, continuous parameters with a nominal design."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypedDict

import numpy as np
import numpy.typing as npt
import torch

from codesign_bo.errors import StudyError

Array = npt.NDArray[np.float64]
Feasible = Callable[[Array], npt.NDArray[np.bool_]]
"""Maps designs (n, d), in natural units and the space's order, to which of them may be evaluated (n,)."""

_SOBOL_BLOCK = 256
_SOBOL_LIMIT = 2**17


class ParameterSignature(TypedDict):
    """A parameter as stored in files."""

    name: str
    low: float
    high: float
    nominal: float
    fixed: bool


@dataclass(frozen=True)
class Parameter:
    """One parameter of a design.

    Attributes:
        name: Its name, unique in the space.
        low: Lower bound, in the parameter's own unit.
        high: Upper bound.
        nominal: Value in the nominal design, within the bounds.
        fixed: Whether every design keeps the nominal value.
    """

    name: str
    low: float
    high: float
    nominal: float
    fixed: bool = False

    def __post_init__(self) -> None:
        for key in ("low", "high", "nominal"):
            object.__setattr__(self, key, float(getattr(self, key)))
        if not all(map(math.isfinite, (self.low, self.high, self.nominal))):
            raise ValueError(f"parameter {self.name}: bounds and nominal value must be finite, got {self}")
        if not (self.low < self.high or (self.fixed and self.low == self.high)):
            raise ValueError(
                f"parameter {self.name}: lower bound {self.low} is not below upper bound {self.high}; "
                "use BoxSpace.fix to hold a parameter"
            )
        if not self.low <= self.nominal <= self.high:
            raise ValueError(f"parameter {self.name}: value {self.nominal} lies outside [{self.low}, {self.high}]")


@dataclass(frozen=True)
class BoxSpace:
    """A box of named parameters; its free ones span the unit cube in which the search works.

    Attributes:
        parameters: The d parameters, in the order of design arrays.

    Example:
        >>> space = BoxSpace.box(["thigh", "shank"], low=0.6, high=1.4, nominal=1.0).fix({"thigh": 1.0})
        >>> space.free_names
        ('shank',)
    """

    parameters: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", tuple(self.parameters))
        if len(set(self.names)) != len(self.names):
            raise ValueError(f"parameter names are not unique: {self.names}")
        if not self.free_names:
            raise ValueError(f"no free parameter is left to search among {self.names}")

    @classmethod
    def box(
        cls,
        names: Sequence[str],
        low: float | Sequence[float],
        high: float | Sequence[float],
        nominal: float | Sequence[float],
    ) -> BoxSpace:
        """Return the box with these names; a single number holds for all parameters."""
        columns = [np.broadcast_to(np.asarray(v, dtype=float), (len(names),)) for v in (low, high, nominal)]
        rows = zip(names, *(c.tolist() for c in columns), strict=True)
        return cls(tuple(Parameter(name, low, high, nominal) for name, low, high, nominal in rows))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all d parameters."""
        return tuple(p.name for p in self.parameters)

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of the parameters that are searched."""
        return tuple(p.name for p in self.parameters if not p.fixed)

    @property
    def dim(self) -> int:
        """Number of free parameters, the dimension of the unit cube."""
        return len(self.free_names)

    @property
    def nominal(self) -> dict[str, float]:
        """The nominal design."""
        return {p.name: p.nominal for p in self.parameters}

    def with_bounds(self, bounds: Mapping[str, tuple[float, float]]) -> BoxSpace:
        """Return this space with other bounds, such as `{"front_shank": (1.0, 1.4)}`.

        Raises:
            ValueError: A name is unknown, or the nominal value lies outside its new bounds.
        """
        self._known(bounds)
        return BoxSpace(
            tuple(
                replace(p, low=bounds[p.name][0], high=bounds[p.name][1]) if p.name in bounds else p
                for p in self.parameters
            )
        )

    def fix(self, values: Mapping[str, float]) -> BoxSpace:
        """Return this space with these parameters held, in the nominal design too.

        Raises:
            ValueError: A name is unknown, a value lies outside its bounds, or nothing is left to search.
        """
        self._known(values)
        return BoxSpace(
            tuple(replace(p, nominal=values[p.name], fixed=True) if p.name in values else p for p in self.parameters)
        )

    def check(self, params: Mapping[str, float]) -> dict[str, float]:
        """Return `params` as floats in the space's order.

        Raises:
            ValueError: A name is missing or unknown, a value is out of bounds or differs from a fixed one.
        """
        self._known(params)
        missing = [n for n in self.names if n not in params]
        if missing:
            raise ValueError(f"design {dict(params)} lacks {missing}; a design names all of {self.names}")
        for p in self.parameters:
            value = float(params[p.name])
            if p.fixed and value != p.nominal:
                raise ValueError(f"{p.name} = {value}, but this parameter is fixed at {p.nominal}")
            if not p.low <= value <= p.high:
                raise ValueError(f"{p.name} = {value} lies outside [{p.low}, {p.high}]")
        return {n: float(params[n]) for n in self.names}

    def designs(self, params: Iterable[Mapping[str, float]]) -> Array:
        """Return designs as an array (n, d) in natural units."""
        rows = [[p[n] for n in self.names] for p in params]
        return np.asarray(rows, dtype=float).reshape(-1, len(self.names))

    def params(self, design: Array) -> dict[str, float]:
        """Return one design (d,) by parameter name."""
        return {n: float(v) for n, v in zip(self.names, design, strict=True)}

    def to_unit(self, designs: Array) -> Array:
        """Map designs (n, d) to points (n, dim) of the unit cube."""
        free = [p for p in self.parameters if not p.fixed]
        index = [self.names.index(p.name) for p in free]
        low, span = np.array([p.low for p in free]), np.array([p.high - p.low for p in free])
        return (designs[:, index] - low) / span

    def from_unit(self, points: Array) -> Array:
        """Map points (n, dim) of the unit cube to designs (n, d); fixed values come out exactly."""
        designs = np.empty((len(points), len(self.parameters)))
        free = iter(np.asarray(points, dtype=float).T)
        for column, p in enumerate(self.parameters):
            if p.fixed:
                designs[:, column] = p.nominal
            else:
                designs[:, column] = np.clip(p.low + next(free) * (p.high - p.low), p.low, p.high)
        return designs

    def signature(self) -> list[ParameterSignature]:
        """Return the space as JSON-ready values."""
        return [
            ParameterSignature(name=p.name, low=p.low, high=p.high, nominal=p.nominal, fixed=p.fixed)
            for p in self.parameters
        ]

    @classmethod
    def from_signature(cls, signature: Iterable[ParameterSignature]) -> BoxSpace:
        """Return the space that `signature` describes."""
        return cls(tuple(Parameter(**entry) for entry in signature))

    def _known(self, names: Iterable[str]) -> None:
        unknown = [n for n in names if n not in self.names]
        if unknown:
            raise ValueError(f"unknown parameter {unknown}; this space has {self.names}")


def is_feasible(space: BoxSpace, points: Array, feasible: Feasible | None) -> npt.NDArray[np.bool_]:
    """Return which points (n, dim) of the unit cube satisfy the predicate, as (n,).

    Raises:
        ValueError: The predicate returned something else than n booleans.
    """
    if feasible is None:
        return np.ones(len(points), dtype=bool)
    mask = np.asarray(feasible(space.from_unit(points)))
    if mask.shape != (len(points),) or mask.dtype != np.bool_:
        raise ValueError(
            f"the feasibility predicate returned {mask.dtype} of shape {mask.shape} "
            f"for {len(points)} designs; it must return bool of shape ({len(points)},)"
        )
    return mask


def sobol_points(space: BoxSpace, n: int, seed: int, feasible: Feasible | None = None, skip: int = 0) -> Array:
    """Return feasible points of a scrambled Sobol sequence in the unit cube.

    Args:
        space: The space.
        n: How many points to return.
        seed: Seed of the scrambling.
        feasible: Predicate; infeasible points of the sequence are passed over.
        skip: How many feasible points to leave out first.

    Returns:
        Points (n, dim), the same for the same arguments.

    Raises:
        StudyError: The predicate accepts almost nothing.
    """
    engine = torch.quasirandom.SobolEngine(space.dim, scramble=True, seed=seed)
    kept = np.empty((0, space.dim))
    drawn = 0
    while len(kept) < skip + n:
        if drawn >= _SOBOL_LIMIT + 8 * (skip + n):
            raise StudyError(
                f"only {len(kept)} of {drawn} Sobol points over {space.free_names} are feasible, "
                f"{skip + n} are needed; widen the bounds or loosen the feasibility predicate"
            )
        block = engine.draw(_SOBOL_BLOCK, dtype=torch.float64).numpy()
        kept = np.concatenate([kept, block[is_feasible(space, block, feasible)]])
        drawn += _SOBOL_BLOCK
    return kept[skip : skip + n]


def sobol_designs(space: BoxSpace, n: int, seed: int, feasible: Feasible | None = None) -> list[dict[str, float]]:
    """Return n feasible designs spread over the space, for screening.

    Example:
        >>> space = BoxSpace.box(["thigh"], 0.6, 1.4, 1.0)
        >>> len(sobol_designs(space, 128, seed=0))
        128
    """
    return [space.params(row) for row in space.from_unit(sobol_points(space, n, seed, feasible))]
