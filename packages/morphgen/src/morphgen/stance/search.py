"""The grid of hip heights and foot offsets on which stances other than the default are looked for."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from morphgen.skeleton import Array, Skeleton
from morphgen.stance.inverse import SagittalLegs, leg_angles
from morphgen.stance.kinematics import forward_kinematics

HEIGHT_RATIO = 0.75
"""Height of the thigh joints above the feet's centres over the length (thigh + shank) of the shorter leg pair."""
HEIGHTS = np.linspace(0.5, 0.95, 10)
"""Ratios that are tried where the default is not sound."""
OFFSETS = np.linspace(-0.5, 0.5, 21)
"""Foot in front of the thigh joint over the length of the leg; the same for left and right."""
KNEE_CLEARANCE = 0.03
"""Least height of a knee axis above the floor [m]."""
KNEE_CLEARANCE_RATIO = 30 / 22
"""The same over the foot's radius, for robots with larger feet than Go2's: limbs are about as thick as their feet."""
_FRONT, _HIND = [0, 1], [2, 3]


@dataclass(frozen=True)
class Candidates:
    """Stances of m bodies in which every leg on its own is sound, nearest to the default first.

    The distance to the default is the root of the sum of squares of the change of height ratio and of both foot
    offset ratios.

    Attributes:
        count: (m,) number of candidates.
        order: (m, g) cells of the grid, of which the first `count` are candidates.
        height: (m, h) hip heights above the feet's centres [m].
        offset: (m, f, 4) offsets of each foot [m].
    """

    count: NDArray[np.intp]
    order: NDArray[np.intp]
    height: Array
    offset: Array

    def at(self, body: NDArray[np.intp], rank: NDArray[np.intp]) -> tuple[Array, Array]:
        """Heights (...) and offsets (..., 4) of the candidates (...) of bodies (...)."""
        shape = (len(HEIGHTS), len(OFFSETS), len(OFFSETS))
        i, front, hind = np.unravel_index(self.order[body, rank], shape)
        offset = np.where([True, True, False, False], self.offset[body, front], self.offset[body, hind])
        return self.height[body, i], offset


def knee_clearance(body: Skeleton) -> Array:
    """(n, 4) least height of each knee axis above the floor [m]: 3 cm, more for feet of more than 22 mm radius."""
    return np.maximum(KNEE_CLEARANCE, KNEE_CLEARANCE_RATIO * body.foot_radius)


def candidates(body: Skeleton, legs: SagittalLegs) -> Candidates:
    """The candidates of m bodies: legs reach the floor, keep limits and clearance, and front and hind do not cross.

    Legs do not cross if those in front end before those behind begin: from the thigh joint, knee and foot that lie
    furthest back to those that lie furthest in front is at least a foot's diameter.
    """
    zero = forward_kinematics(body, np.zeros((body.n, 4, 3))).joint[:, :, 1]
    leg_length = legs.length.sum(axis=-1)
    pair_length = np.repeat(leg_length.reshape(-1, 2, 2).min(axis=-1), 2, axis=1)
    height = HEIGHTS * leg_length.min(axis=1)[:, None]
    offset = OFFSETS[:, None] * pair_length[:, None]

    radius, hip_z = body.foot_radius, zero[..., 2]
    same_floor = hip_z - hip_z.mean(axis=1, keepdims=True) - (radius - radius.mean(axis=1, keepdims=True))
    reach = (height[:, :, None] + same_floor[:, None])[:, :, None]
    grid_legs = replace(
        legs, length=legs.length[:, None, None], rest=legs.rest[:, None, None], bend=legs.bend[:, None, None]
    )
    solution = leg_angles(grid_legs, reach, offset[:, None])
    thigh = legs.length[:, None, None, :, 0]
    knee_x, knee_z = -thigh * np.sin(solution.thigh), reach + radius[:, None, None] - thigh * np.cos(solution.thigh)
    sound = solution.reachable & solution.within & (knee_z >= knee_clearance(body)[:, None, None])

    ends = zero[:, None, None, :, 0] + np.stack(np.broadcast_arrays(0.0, knee_x, offset[:, None]))
    front_end, hind_end = ends.min(axis=0)[..., _FRONT].min(axis=-1), ends.max(axis=0)[..., _HIND].max(axis=-1)
    apart = front_end[..., :, None] - hind_end[..., None, :] >= 2 * radius.max(axis=1)[:, None, None, None]
    sound &= ((body.lower[:, 0] <= 0) & (body.upper[:, 0] >= 0)).all()
    front, hind = (sound[..., pair].all(axis=-1) for pair in (_FRONT, _HIND))
    mask = (front[..., :, None] & hind[..., None, :] & apart).reshape(body.n, -1)

    away = (HEIGHTS - HEIGHT_RATIO)[:, None, None] ** 2 + OFFSETS[:, None] ** 2 + OFFSETS**2
    nearest = np.argsort(away.ravel(), kind="stable")
    order = nearest[np.argsort(~mask[:, nearest], axis=1, kind="stable")]
    return Candidates(mask.sum(axis=1), order, height, offset)
