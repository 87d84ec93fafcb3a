"""Forward kinematics of n bodies at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morphgen.skeleton import Array, Skeleton


@dataclass(frozen=True)
class LegPoses:
    """Poses of the legs of n bodies in base axes, the origin at the base link's.

    Attributes:
        joint: (n, 4, 4, 3) positions of hip, thigh, knee and foot centre [m].
        rotation: (n, 4, 3, 3, 3) orientations of hip, thigh and shank (the foot has the shank's).
        axis: (n, 4, 3, 3) unit axes of hip, thigh and knee.
        com: (n, 4, 4, 3) centres of mass of hip, thigh, shank and foot [m].
    """

    joint: Array
    rotation: Array
    axis: Array
    com: Array


def forward_kinematics(body: Skeleton, angles: Array) -> LegPoses:
    """Poses of the leg links for joint angles (n, 4, 3) [rad] of hip, thigh and knee."""
    n = body.n
    position, rotation = np.zeros((n, 4, 3)), np.broadcast_to(np.eye(3), (n, 4, 3, 3))
    joints, rotations, axes, coms = [], [], [], []
    for k in range(4):
        position = position + _rotate(rotation, body.joint_origin[:, :, k])
        if k < 3:
            rotation = rotation @ _rotation_about(body.axis[:, k], angles[:, :, k])
            axes.append(_rotate(rotation, np.broadcast_to(body.axis[:, k], (n, 4, 3))))
            rotations.append(rotation)
        joints.append(position)
        coms.append(position + _rotate(rotation, body.link_com[:, :, k]))
    return LegPoses(*(np.stack(parts, axis=2) for parts in (joints, rotations, axes, coms)))


def _rotate(rotation: Array, vector: Array) -> Array:
    return (rotation @ vector[..., None])[..., 0]


def _rotation_about(axis: Array, angle: Array) -> Array:
    """Rodrigues' formula: axes (4, 3) and angles (n, 4) to matrices (n, 4, 3, 3)."""
    x, y, z = axis.T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(4, 3, 3)
    sin, cos = np.sin(angle)[..., None, None], np.cos(angle)[..., None, None]
    return np.eye(3) + sin * cross + (1 - cos) * (cross @ cross)
