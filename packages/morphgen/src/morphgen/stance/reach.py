"""How far the feet reach."""

from __future__ import annotations

import numpy as np

from morphgen.skeleton import Array, Skeleton


def leg_reach(body: Skeleton) -> Array:
    """Least and largest distance (n, 4, 2) of each foot centre from its thigh joint's axis [m].

    Over the range of the knee; distances are in the plane of thigh and shank, whose joints are parallel.
    """
    knee = body.axis[:, 2]
    thigh, shank = (
        vectors - (vectors * knee).sum(axis=-1, keepdims=True) * knee
        for vectors in (
            body.joint_origin[:, :, 2],
            body.joint_origin[:, :, 3],
        )
    )
    across = np.cross(knee, shank)
    # d^2 = |thigh|^2 + |shank|^2 + 2 (thigh . shank cos q + thigh . across sin q), largest at q = straight
    fixed = (thigh**2).sum(axis=-1) + (shank**2).sum(axis=-1)
    even, odd = (thigh * shank).sum(axis=-1), (thigh * across).sum(axis=-1)
    straight = np.arctan2(odd, even)
    lower = np.maximum(body.lower[:, 2], -np.pi)
    span = np.minimum(body.upper[:, 2], lower + 2 * np.pi) - lower

    def distance(angle: Array) -> Array:
        return np.sqrt(np.maximum(fixed + 2 * (even * np.cos(angle) + odd * np.sin(angle)), 0.0))

    ends = np.stack([distance(lower + 0 * straight), distance(lower + span + 0 * straight)])
    extremes = []
    for angle, pick in ((straight + np.pi, np.min), (straight, np.max)):
        inside = (angle - lower) % (2 * np.pi) <= span
        extremes.append(np.where(inside, distance(angle), pick(ends, axis=0)))
    return np.stack(extremes, axis=-1)
