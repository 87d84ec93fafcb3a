"""The point of a space where an acquisition is highest, over continuous, integer and categorical parameters.

Many points are valued first; the best of them climb along their continuous coordinates, one for each
combination of the others if there are few, under the space's linear constraints; then single integers and
categoricals are changed as long as that helps.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import numpy.typing as npt
import torch
from botorch.generation.gen import gen_candidates_scipy

from codesign_bo.acquisition.functions import Acquisition
from codesign_bo.space import Array, BoxSpace, Categorical, Continuous, Feasible, is_feasible, sobol_points

Valid = Callable[[Array], npt.NDArray[np.bool_]]

_SPREAD_POINTS = 512
_LOCAL_POINTS = 128
_LOCAL_SPREADS = (0.02, 0.1)
_CLIMBS = 6
_MAX_COMBINATIONS = 32
_SEPARATION = 0.05
_ITERATIONS = 60
_ROUNDS = 20
_RETREATS = (0.0, 1e-6, 1e-3)  # an optimiser on a bound may be beyond it by rounding
_MAX_NEIGHBOURS = 64


def maximise(
    space: BoxSpace,
    acquisition: Acquisition,
    centres: Array,
    seed: int,
    feasible: Feasible | None = None,
    allowed: Acquisition | None = None,
) -> Array:
    """Return the feasible point (dim,) with the highest acquisition, snapped.

    The same arguments give the same point; the global random state is neither read nor changed.

    Args:
        space: The space.
        acquisition: What is to be maximised, in log units.
        centres: Points (k, dim) around which some candidates are drawn, such as the best observed one.
        seed: Seed of the candidates.
        feasible: Predicate over designs in natural units.
        allowed: Must be positive where a point may lie (b,), unless it is so nowhere.

    Raises:
        StudyError: No feasible point was found.
    """
    with _one_thread():
        raw = _candidates(space, centres, seed, feasible)
        values = _values(acquisition, raw)
        if allowed is not None:
            good = _values(allowed, raw) > 0
            if good.any():
                raw, values = raw[good], values[good]
            else:
                allowed = None

        def valid(points: Array) -> npt.NDArray[np.bool_]:
            mask = is_feasible(space, points, feasible)
            return mask if allowed is None else mask & (_values(allowed, points) > 0)

        return _climb(space, acquisition, raw, values, valid)


def _climb(space: BoxSpace, acquisition: Acquisition, raw: Array, values: Array, valid: Valid) -> Array:
    """Climb from the best candidates, then change single integers and categoricals as long as that helps."""
    continuous = np.array([isinstance(p, Continuous) for p in space.free])
    best = int(np.argmax(values))
    at, value = raw[best], float(values[best])
    starts = raw[_starts(raw, values, continuous)]
    for _ in range(_ROUNDS):
        ends = starts
        if continuous.any():
            # A climb may leave the feasible set; then its start stands, which was feasible.
            climbed = _gradient_climb(space, acquisition, starts, continuous)
            climbed = space.snap(np.concatenate([climbed + back * (starts - climbed) for back in _RETREATS]))
            ends = np.concatenate([climbed[valid(climbed)], starts])
        end_values = _values(acquisition, ends)
        if end_values.max() > value:
            at, value = ends[int(np.argmax(end_values))], float(end_values.max())
        neighbours = _neighbours(space, at)
        neighbours = neighbours[valid(neighbours)]
        if not len(neighbours):
            break
        next_values = _values(acquisition, neighbours)
        if next_values.max() <= value:
            break
        starts = neighbours[[int(np.argmax(next_values))]]
    return at


def _candidates(space: BoxSpace, centres: Array, seed: int, feasible: Feasible | None) -> Array:
    """Return feasible points (n, dim): some all over the cube, some around the centres, all combinations if few."""
    rng = np.random.default_rng(seed)
    parts = [sobol_points(space, _SPREAD_POINTS, seed, feasible)]
    for spread in _LOCAL_SPREADS:
        picked = centres[np.arange(_LOCAL_POINTS // len(_LOCAL_SPREADS)) % len(centres)]
        moved = picked + rng.normal(0.0, spread, picked.shape)
        parts.append(space.snap(np.clip(moved, 0.0, 1.0)))
    rows = space.discrete_choices(_MAX_COMBINATIONS)
    if rows is not None and len(rows) > 1:
        parts += [_with(space, row, parts[0], rng) for row in rows]
    points = np.concatenate(parts)
    return points[is_feasible(space, points, feasible)]


def _with(space: BoxSpace, row: Array, spread: Array, rng: np.random.Generator) -> Array:
    """Return points (k, dim) with the integers and categoricals of `row`, NaN in its continuous coordinates."""
    count = max(_CLIMBS, _SPREAD_POINTS // _MAX_COMBINATIONS)
    points = np.where(np.isnan(row), spread[:count], row)
    if not space.constraints or space.satisfied(space.from_unit(points)).any() or not np.isnan(row).any():
        return points
    polytope = space.polytope
    fibre = polytope.fibre(polytope.from_unit(row[None])[0])
    points[:, np.isnan(row)] = fibre.walk(len(points), rng)
    return points


def _starts(raw: Array, values: Array, continuous: npt.NDArray[np.bool_]) -> list[int]:
    """Return where to climb from: the best candidates that are not close, and the best of each combination."""
    picked: list[int] = []
    combinations: set[tuple[float, ...]] = set()
    for i in np.argsort(-values, kind="stable").tolist():
        if not math.isfinite(values[i]):
            break
        combination = tuple(raw[i, ~continuous].tolist())
        apart = not picked or np.abs(raw[picked] - raw[i]).max(axis=1).min() >= _SEPARATION
        if (combination not in combinations and len(combinations) < _MAX_COMBINATIONS) or (
            len(picked) < _CLIMBS and apart
        ):
            picked.append(i)
            combinations.add(combination)
    return picked or [int(np.argmax(values))]


def _gradient_climb(
    space: BoxSpace, acquisition: Acquisition, starts: Array, continuous: npt.NDArray[np.bool_]
) -> Array:
    """Return where climbs from starts (k, dim) along the continuous coordinates end (k, dim)."""
    rows, limits = space.unit_inequalities()
    constraints = [
        (torch.as_tensor(np.flatnonzero(row)), torch.as_tensor(row[row != 0]), float(limit))
        for row, limit in zip(rows, limits, strict=True)
        if row[continuous].any()
    ]
    options: dict[str, int] = {"maxiter": _ITERATIONS}
    if constraints:
        options["max_optimization_problem_aggregation_size"] = 1
    points = torch.as_tensor(starts).unsqueeze(-2)
    try:
        ends, _ = gen_candidates_scipy(
            points,
            lambda x: acquisition(x.squeeze(-2)),  # pyright: ignore[reportArgumentType] # any callable will do
            lower_bounds=torch.zeros(space.dim, dtype=torch.float64),
            upper_bounds=torch.ones(space.dim, dtype=torch.float64),
            inequality_constraints=constraints or None,
            fixed_features={int(i): points[:, 0, i] for i in np.flatnonzero(~continuous)} or None,
            options=options,
        )
    except RuntimeError:  # not a number somewhere on the way; the starts are good points already
        return starts
    ends = ends.squeeze(-2).detach().numpy()
    return np.where(np.isfinite(ends).all(axis=1, keepdims=True), ends, starts)


def _neighbours(space: BoxSpace, point: Array) -> Array:
    """Return points (k, dim) that differ from `point` in one integer or categorical; of an integer, near values."""
    found = []
    for i, p in enumerate(space.free):
        if isinstance(p, Continuous):
            continue
        here = int(point[i] * p.count)
        others = [b for b in range(p.count) if b != here]
        if not isinstance(p, Categorical):
            others.sort(key=lambda b: abs(b - here))
        for other in others[:_MAX_NEIGHBOURS]:
            moved = point.copy()
            moved[i] = (other + 0.5) / p.count
            found.append(moved)
    return np.array(found).reshape(-1, space.dim)


def _values(acquisition: Acquisition, points: Array) -> Array:
    """Return the acquisition at points (k, dim), -inf where it is not a number."""
    with torch.no_grad():
        values = acquisition(torch.as_tensor(points)).numpy()
    return np.where(np.isnan(values), -np.inf, values)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Use one thread, so that sums come in one order and small matrices are not slowed down."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        torch.set_num_threads(threads)
