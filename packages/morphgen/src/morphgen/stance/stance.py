"""A level stance for each body, and the joint torques that hold it against gravity.

The default puts the feet under the thigh joints, the hips 0.75 of the shorter leg pair above the feet. Where that is
not sound, the sound stance nearest to it on a grid of hip heights and foot offsets is taken, see `search`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from morphgen.scaling.articulate import Collisions
from morphgen.skeleton import Array, Skeleton
from morphgen.stance.clearance import links_clear
from morphgen.stance.inverse import SagittalLegs, leg_angles, sagittal_legs
from morphgen.stance.kinematics import forward_kinematics
from morphgen.stance.search import HEIGHT_RATIO, candidates, knee_clearance
from morphgen.stance.statics import GRAVITY, foot_load, static_torque

LEAST_LOAD = 0.05
"""Share of the weight that each foot must carry at least; on a rectangle of feet the centre of mass then lies
inside by a tenth of its length and width."""
_Arrays = TypeVar("_Arrays", Skeleton, SagittalLegs, Collisions)
_SHARED = {"axis", "lower", "upper", "effort", "velocity", "damping", "friction"}
_CHUNK = 256
"""Bodies searched at a time; bounds the memory."""
_FIRST_TRIES, _TRIES, _TRIES_AT_ONCE = 4, 512, 2048
"""Candidates looked at: of each body in the first round, of each body in all, of all bodies in one round."""


@dataclass(frozen=True)
class Stance:
    """Stances of n bodies on a level floor at z = 0, the base level with its origin at x = y = 0.

    Attributes:
        joints: (n, 4, 3) angles of hip, thigh and knee [rad]; where no level stance exists, the nearest one.
        torque: (n, 4, 3) joint torques that hold it, clipped to the limits [N m].
        base_height: (n,) height of the base origin [m]; the lowest foot ball touches the floor.
        hip_height: (n,) mean height of the thigh joints [m].
        foot_offset: (n, 4) how far each foot lies in front of its thigh joint [m]; 0 in the default stance.
        feasible: (n,) whether the stance is sound: all feet reach the floor, the joint limits are kept, the knees
            keep their clearance, less torque is needed than the limits, and every foot carries at least 5 % of
            the weight.
    """

    joints: Array
    torque: Array
    base_height: Array
    hip_height: Array
    foot_offset: Array
    feasible: NDArray[np.bool_]


def solve_stance(
    body: Skeleton, knees: Sequence[int | None] | None = None, *, collisions: Collisions | None = None
) -> Stance:
    """Stances of n bodies; see `Stance`.

    Args:
        body: n bodies.
        knees: for each leg (FL, FR, RL, RR) 1 for a knee that bends backwards, -1 for one that bends forwards, or
            None for the side that the joint limits tell, backwards if they do not.
        collisions: primitives of the bodies, to be kept off the floor; None looks at the knee joints alone.

    Raises:
        MorphologyError: hips do not turn about x, or thighs and knees about y, at zero angles.
    """
    legs = sagittal_legs(body, knees)
    height = HEIGHT_RATIO * legs.length.sum(axis=-1).min(axis=1)
    everyone = _Bodies(body, legs, collisions)
    stance = _stand(everyone, height, np.zeros((body.n, 4)))
    unsound = np.flatnonzero(~stance.feasible)
    for start in range(0, len(unsound), _CHUNK):
        rows = unsound[start : start + _CHUNK]
        found, better = _nearest_sound(everyone.take(rows))
        for field in fields(Stance):
            getattr(stance, field.name)[rows[found]] = getattr(better, field.name)[found]
    return stance


@dataclass(frozen=True)
class _Bodies:
    skeleton: Skeleton
    legs: SagittalLegs
    collisions: Collisions | None

    def take(self, rows: NDArray[np.intp]) -> _Bodies:
        own = [field.name for field in fields(Skeleton) if field.name not in _SHARED]
        shapes = self.collisions
        return _Bodies(
            _take(self.skeleton, own, rows),
            _take(self.legs, ["length", "rest", "bend"], rows),
            None if shapes is None else _take(shapes, ["position", "rotation", "size"], rows),
        )


def _take(item: _Arrays, names: Sequence[str], rows: NDArray[np.intp]) -> _Arrays:
    return replace(item, **{name: getattr(item, name)[rows] for name in names})


def _stand(bodies: _Bodies, height: Array, offset: Array) -> Stance:
    """Stances with thigh joints at a mean height (n,) above the feet's centres and feet offset (n, 4) forward [m]."""
    body, legs = bodies.skeleton, bodies.legs
    n = body.n
    zero = forward_kinematics(body, np.zeros((n, 4, 3)))
    hip_z = zero.joint[:, :, 1, 2]
    base_height = height - hip_z.mean(axis=1) + body.foot_radius.mean(axis=1)
    solution = leg_angles(legs, base_height[:, None] + hip_z - body.foot_radius, offset)
    angles = np.concatenate([np.zeros((n, 4, 1)), solution.joint], axis=-1)
    within = (angles >= body.lower) & (angles <= body.upper)
    angles = np.clip(angles, body.lower, body.upper)

    poses = forward_kinematics(body, angles)
    base_height = base_height + _lift(poses.joint, base_height, body.foot_radius)
    clear = base_height[:, None] + poses.joint[:, :, 2, 2] >= knee_clearance(body)
    load = foot_load(body, poses)
    balanced = load >= LEAST_LOAD * GRAVITY * body.total_mass[:, None]
    torque = static_torque(body, poses, load)
    strong = np.abs(torque) < body.effort
    feasible = (solution.reachable & clear & balanced).all(axis=1) & (within & strong).all(axis=(1, 2))
    if bodies.collisions is not None:
        feasible &= links_clear(body, poses, base_height, bodies.collisions)
    return Stance(
        joints=angles,
        torque=np.clip(torque, -body.effort, body.effort),
        base_height=base_height,
        hip_height=base_height + poses.joint[:, :, 1, 2].mean(axis=1),
        foot_offset=poses.joint[:, :, 3, 0] - poses.joint[:, :, 1, 0],
        feasible=feasible,
    )


def _nearest_sound(bodies: _Bodies) -> tuple[NDArray[np.bool_], Stance]:
    """Whether each of m bodies has a sound stance on the grid, (m,), and the one nearest to the default."""
    m = bodies.skeleton.n
    grid = candidates(bodies.skeleton, bodies.legs)
    count = np.minimum(grid.count, _TRIES)
    left, start, tries = np.flatnonzero(count), 0, _FIRST_TRIES
    height, offset, found = np.zeros(m), np.zeros((m, 4)), np.zeros(m, dtype=bool)
    while len(left):
        tries = min(tries, max(1, _TRIES_AT_ONCE // len(left)))
        ranks = np.minimum(start + np.arange(tries), count[left, None] - 1)
        heights, offsets = grid.at(left[:, None], ranks)
        rows = np.repeat(left, tries)
        stance = _stand(bodies.take(rows), heights.ravel(), offsets.reshape(-1, 4))
        sound = stance.feasible.reshape(-1, tries)
        first, hit = sound.argmax(axis=1), sound.any(axis=1)
        height[left[hit]], offset[left[hit]] = heights[hit, first[hit]], offsets[hit, first[hit]]
        found[left[hit]] = True
        start, tries = start + tries, 2 * tries
        left = left[~hit & (start < count[left])]
    return found, _stand(bodies, height, offset)


def _lift(joint: Array, base_height: Array, foot_radius: Array) -> Array:
    """How far to raise each base so that its lowest foot sphere touches the floor."""
    return -(base_height[:, None] + joint[:, :, 3, 2] - foot_radius).min(axis=1)
