"""The space that is searched: named, bounded parameters with a nominal design, and linear constraints."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from codesign_bo.space.constraints import LinearConstraint, as_polytope, check_constraints, satisfied
from codesign_bo.space.parameters import AnyParameter, Categorical, Continuous
from codesign_bo.space.polytope import Polytope
from codesign_bo.space.signature import SignatureEntry, read_signature, write_signature
from codesign_bo.space.values import Array, Value


@dataclass(frozen=True)
class BoxSpace:
    """A box of named parameters; its free ones span the unit cube in which the search works.

    The unit cube has one coordinate per free parameter, whatever its kind, and every point of it is a design
    within the bounds (integers and categoricals split their edge into equal bins). Design arrays (n, d) hold
    all parameters in natural units, integers as their value and categoricals as the index of their choice.

    Attributes:
        parameters: The d parameters, in the order of design arrays.
        constraints: Linear constraints that every design satisfies, the nominal one too.

    Raises:
        ValueError: Names are not unique, all parameters are fixed, or a constraint cannot be satisfied or is
            broken by the nominal design.

    Example:
        >>> space = BoxSpace.box(["thigh", "shank"], low=0.6, high=1.4, nominal=1.0).fix({"thigh": 1.0})
        >>> space.free_names
        ('shank',)
        >>> from codesign_bo.space import Categorical, Integer
        >>> space = BoxSpace(
        ...     (
        ...         Continuous("thigh", 0.6, 1.4, nominal=1.0),
        ...         Continuous("shank", 0.6, 1.4, nominal=1.0),
        ...         Continuous("stiffness", 1.0, 1000.0, nominal=30.0, log=True),
        ...         Integer("teeth", 8, 24, nominal=12),
        ...         Categorical("foot", ("ball", "flat"), nominal="ball"),
        ...     ),
        ...     constraints=(LinearConstraint({"thigh": 1, "shank": 1}, high=2.4),),
        ... )
        >>> space.nominal["teeth"], space.dim, space.feature_dim
        (12, 5, 6)
    """

    parameters: tuple[AnyParameter, ...]
    constraints: tuple[LinearConstraint, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", tuple(self.parameters))
        if len(set(self.names)) != len(self.names):
            raise ValueError(f"parameter names are not unique: {self.names}")
        if not self.free_names:
            raise ValueError(f"no free parameter is left to search among {self.names}")
        check_constraints(self.parameters, self.constraints)
        ordered = (
            replace(c, coefficients={n: c.coefficients[n] for n in self.names if n in c.coefficients})
            for c in self.constraints
        )
        object.__setattr__(self, "constraints", tuple(dict.fromkeys(ordered)))

    @classmethod
    def box(
        cls,
        names: Sequence[str],
        low: float | Sequence[float],
        high: float | Sequence[float],
        nominal: float | Sequence[float],
    ) -> BoxSpace:
        """Return the continuous box with these names; a single number holds for all parameters."""
        columns = [np.broadcast_to(np.asarray(v, dtype=float), (len(names),)) for v in (low, high, nominal)]
        rows = zip(names, *(c.tolist() for c in columns), strict=True)
        return cls(tuple(Continuous(name, low, high, nominal) for name, low, high, nominal in rows))

    # --- parameters -----------------------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all d parameters."""
        return tuple(p.name for p in self.parameters)

    @property
    def free(self) -> tuple[AnyParameter, ...]:
        """The parameters that are searched, in the order of unit coordinates."""
        return tuple(p for p in self.parameters if not p.fixed)

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of the parameters that are searched."""
        return tuple(p.name for p in self.free)

    @property
    def dim(self) -> int:
        """Number of free parameters, the dimension of the unit cube."""
        return len(self.free)

    @property
    def nominal(self) -> dict[str, Value]:
        """The nominal design."""
        return {p.name: p.nominal for p in self.parameters}

    # --- other spaces ---------------------------------------------------------------------------------

    def with_bounds(self, bounds: Mapping[str, tuple[float, float]]) -> BoxSpace:
        """Return this space with other bounds, such as `{"front_shank": (1.0, 1.4)}`.

        Raises:
            ValueError: A name is unknown or categorical, or the nominal value lies outside its new bounds.
        """
        self._known(bounds)

        def bounded(p: AnyParameter) -> AnyParameter:
            if p.name not in bounds:
                return p
            if isinstance(p, Categorical):
                raise ValueError(f"parameter {p.name} has choices {p.choices}, no bounds; make another Categorical")
            low, high = bounds[p.name]
            return replace(p, low=low, high=high)

        return replace(self, parameters=tuple(bounded(p) for p in self.parameters))

    def with_nominal(self, values: Mapping[str, Value]) -> BoxSpace:
        """Return this space with another nominal design, given by the values that change.

        Raises:
            ValueError: A name is unknown, a value is not allowed, or the design breaks a constraint.
        """
        self._known(values)
        changed = (replace(p, nominal=values.get(p.name, p.nominal)) for p in self.parameters)
        return replace(self, parameters=tuple(changed))

    def with_constraints(self, *constraints: LinearConstraint) -> BoxSpace:
        """Return this space with further linear constraints.

        Raises:
            ValueError: A constraint cannot be satisfied, or the nominal design breaks it.
        """
        return replace(self, constraints=(*self.constraints, *constraints))

    def fix(self, values: Mapping[str, Value]) -> BoxSpace:
        """Return this space with these parameters held, in the nominal design too.

        Raises:
            ValueError: A name is unknown, a value is not allowed, nothing is left to search, or the nominal
                design then breaks a constraint.
        """
        self._known(values)
        held = (replace(p, nominal=values[p.name], fixed=True) if p.name in values else p for p in self.parameters)
        return replace(self, parameters=tuple(held))

    # --- designs --------------------------------------------------------------------------------------

    def check(self, params: Mapping[str, Value]) -> dict[str, Value]:
        """Return `params` in the space's order, each value in its parameter's own type.

        Raises:
            ValueError: A name is missing or unknown, a value is of the wrong type, out of bounds or differs from
                a fixed one, or the design breaks a linear constraint.
        """
        self._known(params)
        missing = [n for n in self.names if n not in params]
        if missing:
            raise ValueError(f"design {dict(params)} lacks {missing}; a design names all of {self.names}")
        design: dict[str, Value] = {}
        for p in self.parameters:
            value = p.check(params[p.name])
            if p.fixed and value != p.nominal:
                raise ValueError(f"{p.name} = {value!r}, but this parameter is fixed at {p.nominal!r}")
            design[p.name] = p.nominal if p.fixed else value
        verdicts = satisfied(self.parameters, self.constraints, self.designs([design]))[0]
        broken = [str(c) for c, good in zip(self.constraints, verdicts, strict=True) if not good]
        if broken:
            raise ValueError(f"design {design} breaks the linear constraint {'; '.join(broken)}")
        return design

    def designs(self, params: Iterable[Mapping[str, Value]]) -> Array:
        """Return designs as an array (n, d) in natural units."""
        rows = [[p.encode(values[p.name]) for p in self.parameters] for values in params]
        return np.asarray(rows, dtype=float).reshape(-1, len(self.names))

    def params(self, design: Array) -> dict[str, Value]:
        """Return one design (d,) by parameter name."""
        return {p.name: p.decode(float(v)) for p, v in zip(self.parameters, design, strict=True)}

    def satisfied(self, designs: Array) -> npt.NDArray[np.bool_]:
        """Return which designs (n, d) satisfy all linear constraints, but for rounding, as (n,)."""
        return np.all(satisfied(self.parameters, self.constraints, designs), axis=1)

    # --- the unit cube --------------------------------------------------------------------------------

    def to_unit(self, designs: Array) -> Array:
        """Map designs (n, d) to points (n, dim) of the unit cube; discrete values to the middles of their bins."""
        columns = [p.to_unit(designs[:, i]) for i, p in enumerate(self.parameters) if not p.fixed]
        return np.column_stack(columns)

    def from_unit(self, points: Array) -> Array:
        """Map points (n, dim) of the unit cube to designs (n, d); fixed values come out exactly."""
        free = iter(np.asarray(points, dtype=float).T)
        columns = [
            np.full(len(points), p.encode(p.nominal)) if p.fixed else p.from_unit(next(free)) for p in self.parameters
        ]
        return np.column_stack(columns)

    def snap(self, points: Array) -> Array:
        """Move points (n, dim) to the middles of their bins; continuous coordinates stay as they are."""
        return np.column_stack([p.snap(column) for p, column in zip(self.free, points.T, strict=True)])

    @property
    def feature_dim(self) -> int:
        """Number of features of a point."""
        return sum(p.feature_dim for p in self.free)

    @property
    def feature_slices(self) -> tuple[slice, ...]:
        """Which features belong to each unit coordinate (dim entries)."""
        ends = list(itertools.accumulate((p.feature_dim for p in self.free), initial=0))
        return tuple(slice(start, end) for start, end in itertools.pairwise(ends))

    def features(self, points: Array) -> Array:
        """Return what a Gaussian process should see of points (n, dim), as (n, feature_dim).

        Continuous coordinates as they are, also NaN; integers at the middles of their bins; one feature per
        choice of a categorical, with two choices at a distance of 1. Equal designs have equal features.
        """
        return np.column_stack([p.features(column) for p, column in zip(self.free, points.T, strict=True)])

    def discrete_choices(self, limit: int) -> Array | None:
        """Return all combinations of the discrete coordinates.

        Args:
            limit: How many combinations there may be.

        Returns:
            Points (m, dim), NaN in the continuous coordinates, without the combinations that the linear
            constraints rule out; or None when there are more than `limit` with those. A continuous space has one.
        """
        if math.prod(p.count for p in self.free if not isinstance(p, Continuous)) > limit:
            return None
        grids = [
            [math.nan] if isinstance(p, Continuous) else ((np.arange(p.count) + 0.5) / p.count).tolist()
            for p in self.free
        ]
        points = np.array(list(itertools.product(*grids)))
        return points[self.polytope.completable(self.polytope.from_unit(points))]

    def unit_inequalities(self) -> tuple[Array, Array]:
        """Return the linear constraints as `A @ u >= b` over points u of the unit cube.

        They hold for continuous coordinates as they are, and for integer coordinates at the middles of their
        bins: `snap` a point before checking it. Columns of categoricals are 0.

        Returns:
            A (k, dim) and b (k,); a constraint with two bounds gives two rows.
        """
        rows, limits = self.polytope.one_sided()
        # v = count * u - 1/2 for the number v of the bin with the middle u
        whole = self.polytope.integral
        limits = limits + 0.5 * rows[:, whole].sum(axis=1)
        return -rows * np.where(whole, self.polytope.upper + 1.0, 1.0), -limits

    @cached_property
    def polytope(self) -> Polytope:
        """The linear constraints over the free parameters (see `constraints.as_polytope`)."""
        return as_polytope(self.parameters, self.constraints)

    # --- files ----------------------------------------------------------------------------------------

    def signature(self) -> list[SignatureEntry]:
        """Return the space as JSON-ready values: the parameters, then the constraints."""
        return write_signature(self.parameters, self.constraints)

    @classmethod
    def from_signature(cls, signature: Iterable[SignatureEntry]) -> BoxSpace:
        """Return the space that `signature` describes.

        Raises:
            ValueError: It holds what this version does not know.
        """
        return cls(*read_signature(signature))

    def _known(self, names: Iterable[str]) -> None:
        unknown = [n for n in names if n not in self.names]
        if unknown:
            raise ValueError(f"unknown parameter {unknown}; this space has {self.names}")
