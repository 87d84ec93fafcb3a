"""Foot loads and joint torques of n bodies that stand still on a level floor."""

from __future__ import annotations

import numpy as np

from morphgen.skeleton import Array, Skeleton
from morphgen.stance.kinematics import LegPoses

GRAVITY = 9.81


def foot_load(body: Skeleton, poses: LegPoses) -> Array:
    """Upward forces (n, 4) [N] of the floor on the feet.

    The four forces balance weight, pitch and roll moment; of all that do, the ones with the least sum of squares
    are taken. A negative one means that the foot would have to pull.
    """
    feet = poses.joint[:, :, 3]
    mass = body.link_mass.reshape(body.n, -1)
    leg_moment = (mass[..., None] * poses.com.reshape(body.n, -1, 3)).sum(axis=1)
    moment = leg_moment + body.base_mass[:, None] * body.base_com
    balance = np.stack([np.ones((body.n, 4)), feet[..., 0], feet[..., 1]], axis=1)
    weight = np.stack([body.total_mass, moment[:, 0], moment[:, 1]], axis=1) * GRAVITY
    return (np.linalg.pinv(balance) @ weight[..., None])[..., 0]


def static_torque(body: Skeleton, poses: LegPoses, load: Array | None = None) -> Array:
    """Joint torques (n, 4, 3) [N m] that hold the links and push each foot down with its load.

    Args:
        body: n bodies, their bases level.
        poses: their legs.
        load: (n, 4) upward forces on the feet [N]; None for `foot_load`.
    """
    if load is None:
        load = foot_load(body, poses)
    feet = poses.joint[:, :, 3]
    torque = np.zeros((body.n, 4, 3))
    for k in range(3):
        origin = poses.joint[:, :, k]
        vertical = _vertical_moment(feet - origin, load)
        for link in range(k, 4):
            vertical -= _vertical_moment(poses.com[:, :, link] - origin, body.link_mass[:, :, link] * GRAVITY)
        torque[:, :, k] = -(poses.axis[:, :, k] * vertical).sum(axis=-1)
    return torque


def _vertical_moment(arm: Array, force: Array) -> Array:
    """Moment of an upward force at a lever arm."""
    return np.stack([arm[..., 1] * force, -arm[..., 0] * force, np.zeros_like(force)], axis=-1)
