"""Polytopes within a box, some coordinates integer: extreme points, emptiness, and uniform random points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.optimize import linprog

from codesign_bo.space.values import Array

_LP_TOLERANCE = 1e-10  # the smallest the solver takes
_FLAT = 1e-9  # a polytope narrower than this in some direction counts as flat there
_STEPS = 50  # of the walk, per dimension
_INFEASIBLE = 2


@dataclass(frozen=True, eq=False)
class Polytope:
    """The points v (m,) with `0 <= v <= upper` and `low <= matrix @ v <= high`.

    Attributes:
        matrix: One row per constraint (k, m), scaled so that `matrix @ v` has a range of about 1.
        low: Lower bounds (k,), -inf for none.
        high: Upper bounds (k,), inf for none.
        upper: Upper bounds of the coordinates (m,).
        integral: Which coordinates are integers (m,).
    """

    matrix: Array
    low: Array
    high: Array
    upper: Array
    integral: npt.NDArray[np.bool_]

    def from_unit(self, points: Array) -> Array:
        """Map points (n, m) of the unit cube to the polytope's coordinates: integer ones to the number of their bin."""
        return np.where(self.integral, np.rint(points * (self.upper + 1.0) - 0.5), points)

    def to_unit(self, points: Array) -> Array:
        """Map points (n, m) to the unit cube, integer coordinates to the middles of their bins."""
        return np.where(self.integral, (points + 0.5) / (self.upper + 1.0), points)

    def fibre(self, values: Array) -> Polytope:
        """Return the polytope over the coordinates that are NaN in `values` (m,), the others held there."""
        stays = np.isnan(values)
        shift = self.matrix[:, ~stays] @ values[~stays]
        low, high = self.low - shift, self.high - shift
        return Polytope(self.matrix[:, stays], low, high, self.upper[stays], self.integral[stays])

    def one_sided(self) -> tuple[Array, Array]:
        """Return the constraints as rows (r, m) and limits (r,): `rows @ v <= limits`."""
        rows, limits = np.concatenate([self.matrix, -self.matrix]), np.concatenate([self.high, -self.low])
        return rows[np.isfinite(limits)], limits[np.isfinite(limits)]

    def completable(self, points: Array) -> npt.NDArray[np.bool_]:
        """Return which points (n, m), NaN in coordinates that are not held, belong to a point of the polytope (n,)."""
        tied = self.matrix.any(axis=0)
        keys = [row.tobytes() for row in np.where(tied, points, 0.0)]
        verdicts = {key: not self.fibre(row).is_empty() for key, row in dict(zip(keys, points, strict=True)).items()}
        return np.array([verdicts[key] for key in keys])

    def is_empty(self) -> bool:
        """Return whether there is no point."""
        return self.extreme(np.zeros(len(self.upper))) is None

    def extreme(self, direction: Array) -> Array | None:
        """Return the point (m,) that lies farthest along `direction` (m,), or None if there is no point."""
        rows, limits = self.one_sided()
        if not rows.any():  # nothing to solve, and a space without coordinates is no linear program
            return None if (limits < -_FLAT).any() else np.where(direction > 0, self.upper, 0.0)
        return self._minimise(-direction, rows, limits)

    def nearest(self, target: Array) -> Array | None:
        """Return the point (m,) whose integer coordinates differ least from `target` (m,), or None.

        The differences count relative to the coordinate's range, and add up. Other coordinates are arbitrary.
        """
        rows, limits = self.one_sided()
        # One further variable per integer coordinate, which is at least the distance from the target.
        pick = np.eye(len(self.upper))[self.integral]
        slack = np.eye(len(pick))
        rows = np.block([[rows, np.zeros((len(rows), len(pick)))], [pick, -slack], [-pick, -slack]])
        limits = np.concatenate([limits, pick @ target, -pick @ target])
        return self._minimise(np.concatenate([0.0 * self.upper, 1.0 / (pick @ self.upper)]), rows, limits)

    def _minimise(self, cost: Array, rows: Array, limits: Array) -> Array | None:
        """Minimise over v and possibly further variables >= 0; return v."""
        m, further = len(self.upper), len(cost) - len(self.upper)
        result = linprog(
            cost,
            A_ub=rows,
            b_ub=limits,
            bounds=[(0.0, u) for u in self.upper] + [(0.0, None)] * further,
            integrality=np.concatenate([self.integral, np.zeros(further)]).astype(int),
            options={"primal_feasibility_tolerance": _LP_TOLERANCE},
        )
        if result.status == _INFEASIBLE:
            return None
        if not result.success:
            raise RuntimeError(f"the linear program of the constraints has no verdict: {result.message}")
        point = np.asarray(result.x, dtype=float)[:m]
        return np.where(self.integral, np.rint(point), point)

    @cached_property
    def frame(self) -> tuple[Array, Array]:
        """A simplex of extreme points: one corner (m,) and its edges (r, m); r is the polytope's own dimension.

        Each corner lies as far as possible from those before it, so that in the coordinates which the edges
        span even a very thin polytope is about as long as wide.

        Raises:
            ValueError: The polytope is empty.
        """
        corner = self.extreme(np.zeros(len(self.upper)))
        if corner is None:
            raise ValueError("an empty polytope has no corner")
        edges: list[Array] = []
        done = np.empty((0, len(corner)))  # orthonormal: along the edges, or across the polytope where it is flat
        while len(done) < len(corner):
            rest = np.eye(len(corner)) - done.T @ done
            direction = rest[np.argmax(np.linalg.norm(rest, axis=1))]
            direction = direction / np.linalg.norm(direction)
            ends = [e - corner for e in (self.extreme(direction), self.extreme(-direction)) if e is not None]
            edge = max(ends, key=lambda e: abs(direction @ e))
            if abs(direction @ edge) > _FLAT:
                edges.append(edge)
                direction = rest @ edge
            done = np.linalg.qr(np.vstack([done, direction]).T)[0].T
        return corner, np.array(edges).reshape(len(edges), len(corner))

    def walk(self, n: int, rng: np.random.Generator) -> Array:
        """Return n independent, nearly uniform points (n, m) of a polytope without integer coordinates.

        Hit-and-run (Smith 1984): from inside the simplex of `frame`, each of n walkers goes again and again
        to a random place on the chord in a random direction.
        """
        corner, edges = self.frame
        rows, limits = self.one_sided()
        box = np.eye(len(corner))
        limits = np.concatenate([limits, self.upper, 0.0 * self.upper]) - np.vstack([rows, box, -box]) @ corner
        rows = np.vstack([rows, box, -box]) @ edges.T
        moves = np.abs(rows).max(axis=1, initial=0.0) > 1e-3 * _FLAT  # the others are constant where it is flat
        rows, limits = rows[moves], limits[moves]
        at = np.full((n, len(edges)), 1.0 / (len(edges) + 1))
        for _ in range(_STEPS * len(edges)):
            direction = rng.standard_normal(at.shape)
            rate = direction @ rows.T
            with np.errstate(divide="ignore", invalid="ignore"):
                time = np.maximum(limits - at @ rows.T, 0.0) / rate
            ahead = np.where(rate > 0, time, np.inf).min(axis=1)
            behind = np.where(rate < 0, time, -np.inf).max(axis=1)
            at += (behind + (ahead - behind) * rng.random(n))[:, None] * direction
        return np.clip(corner + at @ edges, 0.0, self.upper)
