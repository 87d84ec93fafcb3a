"""How a primitive follows a stretch along one axis."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from morphgen.scaling.inertia import stretch_vectors

Array = NDArray[np.float64]

_PARALLEL = 2e-3
"""Files write 3.1415 for pi: a mesh this far off the stretch axis counts as parallel [rad]."""


def stretch_shape(kind: str, position: Array, rotation: Array, size: Array, g: int, axis: Array, scale: Array) -> None:
    """Stretch shape g of n bodies in place.

    Its centre moves with the link. A box is stretched along its own axis nearest to the stretch, a cylinder or
    capsule along its own axis, which turns if it is oblique; radii stay. A mesh is stretched along its own axis
    if that is parallel to the stretch; for others see `bake_axis`.

    Args:
        kind: of the shape.
        position: (n, G, 3) in the link frame [m].
        rotation: (n, G, 3, 3) in the link frame.
        size: (n, G, 3).
        g: which shape.
        axis: (3,) unit vector in the link frame.
        scale: (n,).
    """
    position[:, g] = stretch_vectors(position[:, g], axis, scale)
    if kind == "sphere":
        return
    along = np.abs(rotation[0, g].T @ axis)
    if kind == "mesh":
        k = bake_axis(rotation[0, g], axis)
        if k is not None:
            size[:, g, k] *= scale
        return
    k = int(np.argmax(along)) if kind == "box" else 2
    which = k if kind == "box" else 1
    own = rotation[:, g, :, k]
    moved = stretch_vectors(own, axis, scale)
    if along[k] > 1 - 1e-12:
        size[:, g, which] *= scale
    elif along[k] > 1e-12:
        factor = np.linalg.norm(moved, axis=-1)
        size[:, g, which] *= factor
        rotation[:, g] = _turn(own, moved / factor[:, None]) @ rotation[:, g]


def bake_axis(rotation: Array, axis: Array) -> int | None:
    """The axis of a mesh along which a scale stretches it; None if it is oblique and has to be baked."""
    along = np.abs(rotation.T @ axis)
    k = int(np.argmax(along))
    return k if np.arccos(min(along[k], 1.0)) <= _PARALLEL else None


def _turn(start: Array, end: Array) -> Array:
    """(n, 3, 3) the least rotations that take unit vectors (n, 3) to others less than half a turn away."""
    v = np.cross(start, end)
    cosine = (start * end).sum(axis=-1)
    zero = np.zeros(len(v))
    cross = np.stack([zero, -v[:, 2], v[:, 1], v[:, 2], zero, -v[:, 0], -v[:, 1], v[:, 0], zero], axis=-1)
    cross = cross.reshape(-1, 3, 3)
    return np.eye(3) + cross + cross @ cross / (1 + cosine)[:, None, None]
