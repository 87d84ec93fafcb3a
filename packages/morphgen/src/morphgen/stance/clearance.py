"""Height of collision primitives above the floor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from morphgen.scaling.articulate import Collisions
from morphgen.skeleton import Array, Skeleton
from morphgen.stance.kinematics import LegPoses

LINK_CLEARANCE_RATIO = 0.25
"""Least height of a primitive other than a foot's above the floor, over the foot's radius: 5 mm on Go2, which is more
than it sags."""
FOOT_REACH_RATIO = 3.0
"""A point of the shank this close to the foot's centre, over the foot's radius, counts as foot."""


def links_clear(body: Skeleton, poses: LegPoses, base_height: Array, collisions: Collisions) -> NDArray[np.bool_]:
    """Whether nothing but the feet comes near the floor at z = 0, (n,).

    Args:
        body: n bodies, their bases level.
        poses: their legs.
        base_height: (n,) height of the base origins [m].
        collisions: primitives of the same bodies.
    """
    leg, part = np.array(collisions.leg), np.array(collisions.part)
    low = lowest_points(poses, collisions)
    feet = poses.joint[:, leg, 3]
    radius = body.foot_radius[:, leg]
    own_foot = (part == 2) & (np.linalg.norm(low - feet, axis=-1) <= FOOT_REACH_RATIO * radius)
    clearance = np.where(leg < 0, body.foot_radius.max(axis=1)[:, None], radius) * LINK_CLEARANCE_RATIO
    return np.all((base_height[:, None] + low[..., 2] >= clearance) | own_foot | (part == 3), axis=1)


def lowest_points(poses: LegPoses, collisions: Collisions) -> Array:
    """The lowest point (n, G, 3) of each primitive in base axes, the origin at the base's [m]."""
    leg, part = np.array(collisions.leg), np.array(collisions.part)
    on_trunk = (leg < 0)[:, None]
    turn = np.where(on_trunk[..., None], np.eye(3), poses.rotation[:, leg, np.minimum(part, 2)])
    origin = np.where(on_trunk, 0.0, poses.joint[:, leg, part])
    centre = origin + (turn @ collisions.position[..., None])[..., 0]
    # the way down, seen from the primitive, and how far it reaches there
    down = -(turn @ collisions.rotation)[..., 2, :]
    size = collisions.size
    kind = np.array(collisions.kind)[:, None]
    with np.errstate(invalid="ignore"):  # an upright cylinder has no lowest point on its rim
        radial = np.nan_to_num(down[..., :2] / np.linalg.norm(down[..., :2], axis=-1, keepdims=True))
    side = np.sign(down)
    along = np.concatenate([np.zeros_like(radial), (side * size[..., 1:2] / 2)[..., 2:]], axis=-1)
    rim = np.concatenate([radial, np.zeros_like(radial[..., :1])], axis=-1)
    reach = np.select(
        [kind == "box", kind == "cylinder", kind == "capsule"],
        [side * size / 2, along + size[..., :1] * rim, along + size[..., :1] * down],
        size[..., :1] * down,
    )
    return centre + (turn @ collisions.rotation @ reach[..., None])[..., 0]
