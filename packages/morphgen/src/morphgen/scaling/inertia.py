"""How mass, centre of mass and inertia of n links follow a stretch along one axis.

Every rule works on second moments Sig = integral of r r^T dm = tr(I)/2 1 - I, for which a stretch is a congruence:
what was a possible rigid body stays one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

_ROD_SHARE = 0.999
"""Of the largest rod that a link can contain, so that what is left has thickness."""


@dataclass(frozen=True)
class Masses:
    """Mass (n,) [kg], centre of mass (n, 3) [m], inertia about it (n, 3, 3) [kg m^2]; link axes."""

    mass: Array
    com: Array
    inertia: Array


def second_moment(inertia: Array) -> Array:
    """Sig = tr(I)/2 1 - I for inertias (..., 3, 3)."""
    return np.trace(inertia, axis1=-2, axis2=-1)[..., None, None] / 2 * np.eye(3) - inertia


def from_second_moment(sigma: Array) -> Array:
    """I = tr(Sig) 1 - Sig for second moments (..., 3, 3)."""
    return np.trace(sigma, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - sigma


def stretch_map(axis: Array, scale: Array) -> Array:
    """S = 1 + (xi - 1) e e^T for a unit axis (3,) and scales (n,): (n, 3, 3)."""
    along = np.outer(axis, axis)
    return np.eye(3) + (scale[:, None, None] - 1) * along


def stretch_vectors(vectors: Array, axis: Array, scale: Array) -> Array:
    """S v for vectors (n, 3), a unit axis (3,) and scales (n,); exact if the axis is a coordinate axis."""
    k = int(np.argmax(np.abs(axis)))
    if abs(axis[k]) == 1.0:
        out = vectors.copy()
        out[:, k] *= scale
        return out
    return vectors + ((scale - 1) * (vectors @ axis))[:, None] * axis


def box_inertia(mass: ArrayLike, length: ArrayLike, width: ArrayLike) -> Array:
    """Principal inertia (..., 3) of a uniform box of square section about its centre [kg m^2] (Table II)."""
    mass, length, width = (np.asarray(v, dtype=np.float64) for v in (mass, length, width))
    ixx = mass / 12 * (width**2 + length**2)
    return np.stack([ixx, ixx, mass * width**2 / 6], axis=-1)


def stretched(link: Masses, axis: Array, scale: Array, factor: Array) -> Masses:
    """Rule `stretch`: every point r of the links moves to S r, and their mass is multiplied by `factor`.

    Sig' = factor S Sig S; for a box along the axis and factor = xi this is Table II exactly.
    """
    s = stretch_map(axis, scale)
    sigma = factor[:, None, None] * (s @ second_moment(link.inertia) @ s)
    inertia = np.where(
        ((scale == 1) & (factor == 1))[:, None, None], link.inertia, from_second_moment((sigma + _t(sigma)) / 2)
    )
    return Masses(link.mass * factor, stretch_vectors(link.com, axis, scale), inertia)


def lumped(link: Masses, joint: Array, axis: Array, length: float, scale: Array, factor: Array, shift: Array) -> Masses:
    """Rule `lumped`: a thin uniform rod from joint to joint scales, the rest stays at the proximal joint as a motor.

    The rod's mass puts its centre where the link's is: m_r = m (c - o).e / (L/2), but at most what leaves a
    possible rigid body. The rod follows length and mass (xi L, xi m_r), the motor neither.

    Args:
        link: n equal nominal links.
        joint: (3,) proximal joint o in the link frame.
        axis: (3,) unit vector e from joint to joint.
        length: distance L along it [m].
        scale: (n,) length scale xi.
        factor: (n,) mass factor, of rod and motor alike, besides the length's.
        shift: (n,) way of the motor along the segment, in scaled lengths.
    """
    mass, com = float(link.mass[0]), link.com[0]
    moment = second_moment(link.inertia[0]) + mass * np.outer(com, com)
    tip = joint + length * axis
    rod_first = (joint + tip) / 2
    cross = np.outer(joint, tip)
    rod_second = (np.outer(joint, joint) + np.outer(tip, tip)) / 3 + (cross + cross.T) / 6
    share = min(
        mass * float((com - joint) @ axis) / (length / 2),
        _ROD_SHARE * _largest_share(mass, com, moment, rod_first, rod_second),
    )
    share = max(share, 0.0)
    motor_mass = mass - share
    motor_first = mass * com - share * rod_first
    motor_second = moment - share * rod_second

    start = stretch_vectors(np.repeat(joint[None], len(scale), axis=0), axis, scale)
    end = start + (scale * length)[:, None] * axis
    way = start - joint + (shift * scale * length)[:, None] * axis
    outer = way[:, :, None] * motor_first
    first = motor_first + motor_mass * way
    second = motor_second + outer + _t(outer) + motor_mass * way[:, :, None] * way[:, None]
    rod = share * scale
    first = first + rod[:, None] * (start + end) / 2
    ends = start[:, :, None] * end[:, None]
    squares = start[:, :, None] * start[:, None] + end[:, :, None] * end[:, None]
    second = second + rod[:, None, None] * (squares / 3 + (ends + _t(ends)) / 6)

    total = motor_mass + rod
    centre = first / total[:, None]
    sigma = second - total[:, None, None] * centre[:, :, None] * centre[:, None]
    inertia = from_second_moment((sigma + _t(sigma)) / 2)
    same = (scale == 1) & (shift == 0)
    return Masses(
        factor * np.where(same, mass, total),
        np.where(same[:, None], com, centre),
        factor[:, None, None] * np.where(same[:, None, None], link.inertia, inertia),
    )


def _largest_share(mass: float, com: Array, moment: Array, rod_first: Array, rod_second: Array) -> float:
    """The largest rod [kg] for which body minus rod has a positive semidefinite pseudo-inertia."""
    body, rod = (
        np.block([[m2, m1[:, None]], [m1[None], np.array([[m0]])]])
        for m0, m1, m2 in (
            (mass, mass * com, moment),
            (1.0, rod_first, rod_second),
        )
    )
    values, vectors = np.linalg.eigh(body)
    if values[0] <= 1e-14 * values[-1]:  # a flat body contains no rod of another direction
        return 0.0
    root = vectors / np.sqrt(values)
    return 1 / float(np.linalg.eigvalsh(root.T @ rod @ root)[-1])


def _t(matrix: Array) -> Array:
    return np.swapaxes(matrix, -1, -2)
