"""Static stability of a stance that springs at the joints hold: the load factor at which it buckles."""

from __future__ import annotations

import numpy as np

from morphgen.skeleton import Array, Skeleton
from morphgen.stance.kinematics import LegPoses
from morphgen.stance.statics import GRAVITY, foot_load

LEAST_BUCKLING_FACTOR = 1.05
"""Below 1 a stance sways away within seconds; just above it, small errors tilt it and feet creep."""
_SINGULAR = 1e-9
"""Determinant of a leg's Jacobian [m^3]."""


def buckling_factor(body: Skeleton, poses: LegPoses, stiffness: Array) -> Array:
    """How many times its own weight each body could carry before its stance buckles, (n,); inf if never.

    A PD servo is a spring that holds the static torque at its target. While the feet roll without slip, a small
    motion x of the base (translation, rotation) turns the joints by A x and changes the potential energy by
    x' (K_e + K_g) x / 2. K_e = sum A' kp A is that of the springs; K_g, that of the weight, grows with the load. The
    stance is stable while the sum is positive definite; the factor is the least s for which K_e + s K_g is not.

    Args:
        body: n bodies, their bases level.
        poses: their legs, none stretched out.
        stiffness: (n, 4, 3) kp of hip, thigh and knee [N m/rad].
    """
    joint, axis = poses.joint, poses.axis
    foot = joint[:, :, 3]
    # rolling: the point of each ball that touches the floor is at rest, J q + [1, -r x] x = 0
    touching = foot - body.foot_radius[..., None] * np.array([0.0, 0.0, 1.0])
    hip, thigh, knee = (np.cross(axis[:, :, k], touching - joint[:, :, k]) for k in range(3))
    inverse = np.stack([np.cross(thigh, knee), np.cross(knee, hip), np.cross(hip, thigh)], axis=2)
    volume = (hip * inverse[:, :, 0]).sum(axis=-1)
    # a leg that is stretched out cannot follow; its springs then count as all but rigid
    inverse /= np.where(np.abs(volume) > _SINGULAR, volume, _SINGULAR)[..., None, None]
    motion = np.concatenate([np.broadcast_to(np.eye(3), (body.n, 4, 3, 3)), -_cross_matrix(touching)], axis=-1)
    follow = -inverse @ motion

    # moments of the weights beyond each joint less the load on the foot, about the joint; index 3 is the base
    weight = body.link_mass * GRAVITY
    load = foot_load(body, poses)[..., None]
    moment = np.stack(
        [
            (weight[:, :, k:, None] * (poses.com[:, :, k:] - joint[:, :, k, None])).sum(axis=2)
            - load * (foot - joint[:, :, k])
            for k in range(3)
        ],
        axis=2,
    )
    of_legs = (weight[..., None] * poses.com).sum(axis=2) - load * foot
    whole = of_legs.sum(axis=1) + (body.base_mass * GRAVITY)[:, None] * body.base_com

    # second derivatives of the height of a point: z . (a_i x (a_j x r)), j the joint nearer to the point
    up = np.array([0.0, 0.0, 1.0])
    bent = np.cross(axis, moment)
    joints = np.cross(up, axis) @ np.swapaxes(bent, -1, -2)
    joints = np.triu(joints) + np.swapaxes(np.triu(joints, 1), -1, -2)
    across = np.zeros((body.n, 4, 6, 3))
    across[:, :, 3:] = np.cross(up, np.eye(3)) @ np.swapaxes(bent, -1, -2)
    turned = np.cross(up, np.eye(3)) @ np.swapaxes(np.cross(np.eye(3), whole[:, None]), -1, -2)
    weigh = np.zeros((body.n, 6, 6))
    weigh[:, 3:, 3:] = (turned + np.swapaxes(turned, -1, -2)) / 2

    back = np.swapaxes(follow, -1, -2)
    mixed = across @ follow
    weigh += (back @ joints @ follow + mixed + np.swapaxes(mixed, -1, -2)).sum(axis=1)
    springs = (back @ (stiffness[..., None] * follow)).sum(axis=1)
    half = np.linalg.inv(np.linalg.cholesky(springs))
    worst = np.linalg.eigvalsh(-half @ weigh @ np.swapaxes(half, -1, -2))[:, -1]
    with np.errstate(divide="ignore"):
        return np.where(worst > 0, 1 / np.maximum(worst, 0), np.inf)


def _cross_matrix(r: Array) -> Array:
    """The matrices (..., 3, 3) of v -> r x v."""
    return np.swapaxes(np.cross(r[..., None, :], np.eye(3)), -1, -2)
