"""Feasible points of the unit cube, evenly spread and the same for the same seed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache

import numpy as np
import numpy.typing as npt

from codesign_bo.errors import StudyError
from codesign_bo.space.box import BoxSpace
from codesign_bo.space.polytope import Polytope
from codesign_bo.space.values import Array, Value

Feasible = Callable[[Array], npt.NDArray[np.bool_]]
"""Maps designs (n, d), in natural units and the space's order, to which of them may be evaluated (n,).

An integer stands as its value, a categorical as the index of its choice.
"""

_BLOCK = 256
_LIMIT = 2**17
_THIN = 1 / 64
_TRIAL_POINTS = 1024


def is_feasible(space: BoxSpace, points: Array, feasible: Feasible | None) -> npt.NDArray[np.bool_]:
    """Return which points (n, dim) of the unit cube satisfy the linear constraints and the predicate, as (n,).

    The predicate sees only designs that satisfy the linear constraints.

    Raises:
        ValueError: The predicate returned something else than one boolean per design.
    """
    designs = space.from_unit(points)
    mask = space.satisfied(designs)
    if feasible is None or not mask.any():
        return mask
    kept = designs[mask]
    verdict = np.asarray(feasible(kept))
    if verdict.shape != (len(kept),) or verdict.dtype != np.bool_:
        raise ValueError(
            f"the feasibility predicate returned {verdict.dtype} of shape {verdict.shape} "
            f"for {len(kept)} designs; it must return bool of shape ({len(kept)},)"
        )
    mask[mask] = verdict
    return mask


def sobol_points(space: BoxSpace, n: int, seed: int, feasible: Feasible | None = None, skip: int = 0) -> Array:
    """Return feasible points of a scrambled Sobol sequence in the unit cube.

    Where linear constraints leave too little of the cube, the coordinates that they tie together are random
    instead, uniform over the designs that satisfy them.

    Args:
        space: The space.
        n: How many points to return.
        seed: Seed of the scrambling.
        feasible: Predicate; infeasible points of the sequence are passed over.
        skip: How many feasible points to leave out first.

    Returns:
        Points (n, dim), the same for the same arguments; integers and categoricals at the middles of their bins.

    Raises:
        StudyError: The predicate accepts almost nothing.
    """
    blocks = _thin_blocks(space, seed) if _is_thin(space) else _sobol_blocks(space, seed)
    kept = np.empty((0, space.dim))
    drawn = 0
    while len(kept) < skip + n:
        if drawn >= _LIMIT + 8 * (skip + n):
            raise StudyError(
                f"only {len(kept)} of {drawn} Sobol points over {space.free_names} are feasible, "
                f"{skip + n} are needed; widen the bounds or loosen the feasibility predicate"
            )
        block = next(blocks)
        block = block[space.satisfied(space.from_unit(block))]
        kept = np.concatenate([kept, block[is_feasible(space, block, feasible)]])
        drawn += max(len(block), 1)  # what linear constraints reject costs nothing and does not count
    return kept[skip : skip + n]


def sobol_designs(space: BoxSpace, n: int, seed: int, feasible: Feasible | None = None) -> list[dict[str, Value]]:
    """Return n feasible designs spread over the space, for screening.

    Example:
        >>> space = BoxSpace.box(["thigh"], 0.6, 1.4, 1.0)
        >>> len(sobol_designs(space, 128, seed=0))
        128
    """
    return [space.params(row) for row in space.from_unit(sobol_points(space, n, seed, feasible))]


def _sobol_blocks(space: BoxSpace, seed: int) -> Iterator[Array]:
    import torch  # takes seconds, and the process of an evaluation imports this module without a need for it

    engine = torch.quasirandom.SobolEngine(space.dim, scramble=True, seed=seed)
    while True:
        yield space.snap(engine.draw(_BLOCK, dtype=torch.float64).numpy())


def _is_thin(space: BoxSpace) -> bool:
    """Return whether the linear constraints leave too little of the cube for rejection."""
    if not space.constraints:
        return False
    blocks = _sobol_blocks(space, 0)
    points = np.concatenate([next(blocks) for _ in range(_TRIAL_POINTS // _BLOCK)])
    return bool(space.satisfied(space.from_unit(points)).mean() < _THIN)


def _thin_blocks(space: BoxSpace, seed: int) -> Iterator[Array]:
    """Yield Sobol points of which the constrained coordinates are replaced, by ones that satisfy the constraints.

    Integers move to the nearest values for which the constraints can be satisfied, then the others walk.
    """
    polytope = space.polytope
    tied = polytope.matrix.any(axis=0)
    whole, real = tied & polytope.integral, tied & ~polytope.integral
    core = polytope.fibre(np.where(tied, np.nan, 0.0))

    @cache
    def nearest(target: tuple[float, ...]) -> tuple[float, ...]:
        goal = np.zeros(len(core.upper))
        goal[core.integral] = target
        point = core.nearest(goal)
        if point is None:
            raise StudyError(f"no design satisfies {'; '.join(map(str, space.constraints))}; loosen one of them")
        return tuple(point[core.integral].tolist())

    @cache
    def fibre(held: tuple[float, ...]) -> Polytope:
        values = np.full(len(core.upper), np.nan)
        values[core.integral] = held
        return core.fibre(values)

    for number, points in enumerate(_sobol_blocks(space, seed)):
        rng = np.random.default_rng([seed, number])
        bins = polytope.from_unit(points)
        held = np.array([nearest(tuple(target)) for target in bins[:, whole].tolist()])
        for values in sorted(set(map(tuple, held.tolist()))):
            rows = np.flatnonzero((held == values).all(axis=1))
            bins[np.ix_(rows, real)] = fibre(values).walk(len(rows), rng)
        bins[:, whole] = held
        yield polytope.to_unit(bins)
