"""A level stance for each body, and the joint targets that hold it against gravity.

Legs hang in vertical planes with the feet under the thigh joints and the knees bent backwards, so the
inverse kinematics is a triangle with sides thigh, shank and reach (from thigh joint down to foot centre).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morphgen.errors import MorphologyError
from morphgen.stance.skeleton import Array, Skeleton

GRAVITY = 9.81
HEIGHT_RATIO = 0.75
"""Reach in the stance over the length (thigh + shank) of the shorter leg pair."""
KNEE_CLEARANCE = 0.03
"""Least height of a knee axis above the floor [m]."""


@dataclass(frozen=True)
class Stance:
    """Stances of n bodies on a level floor at z = 0, the base level with its origin at x = y = 0.

    Attributes:
        joints: (n, 4, 3) angles of hip, thigh and knee [rad]; where no level stance exists, the nearest one.
        torque: (n, 4, 3) joint torques that hold it, clipped to the limits [N m].
        base_height: (n,) height of the base origin [m].
        hip_height: (n,) mean height of the thigh joints [m].
        feasible: (n,) whether the pose exists, keeps the joint limits and the knee clearance, and needs less
            torque than the limits.
    """

    joints: Array
    torque: Array
    base_height: Array
    hip_height: Array
    feasible: np.ndarray[tuple[int], np.dtype[np.bool_]]


@dataclass(frozen=True)
class LegPoses:
    """Forward kinematics of n bodies in base axes.

    Attributes:
        joint: (n, 4, 4, 3) positions of hip, thigh, knee and foot centre.
        rotation: (n, 4, 3, 3, 3) orientations of hip, thigh and shank (the foot has the shank's).
        axis: (n, 4, 3, 3) axes of hip, thigh and knee.
        com: (n, 4, 4, 3) centres of mass of hip, thigh, shank and foot.
    """

    joint: Array
    rotation: Array
    axis: Array
    com: Array


def forward_kinematics(body: Skeleton, angles: Array) -> LegPoses:
    """Poses of the leg links for joint angles (n, 4, 3) [rad], in base axes with the origin at the base's."""
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


def solve_stance(body: Skeleton) -> Stance:
    """Stances of n bodies; see `Stance`.

    The reach is 0.75 of the shorter leg pair's length, so that neither pair is stretched out.

    Raises:
        MorphologyError: hips do not turn about x, or thighs and knees about y.
    """
    if not (np.allclose(np.abs(body.axis[:, 0]), (1, 0, 0)) and np.allclose(np.abs(body.axis[:, 1:]), (0, 1, 0))):
        raise MorphologyError("the stance needs hip joints about x, and thigh and knee joints about y")
    thigh, shank = body.segment_length[..., 0], body.segment_length[..., 1]
    zero = forward_kinematics(body, np.zeros((body.n, 4, 3)))
    hip_z = zero.joint[:, :, 1, 2]
    shortest = (thigh + shank).min(axis=1)
    base_height = HEIGHT_RATIO * shortest - hip_z.mean(axis=1) + body.foot_radius.mean()
    reach = base_height[:, None] + hip_z - body.foot_radius

    cos_hip = (thigh**2 + reach**2 - shank**2) / (2 * thigh * reach)
    cos_knee = (reach**2 - thigh**2 - shank**2) / (2 * thigh * shank)
    solvable = (np.abs(cos_hip) <= 1) & (np.abs(cos_knee) <= 1)
    angles = np.zeros((body.n, 4, 3))
    # positive rotation about +y swings the knee backwards, negative folds the shank forwards again
    angles[..., 1] = np.arccos(np.clip(cos_hip, -1, 1)) * body.axis[:, 1, 1]
    angles[..., 2] = -np.arccos(np.clip(cos_knee, -1, 1)) * body.axis[:, 2, 1]
    within = (angles >= body.lower) & (angles <= body.upper)
    angles = np.clip(angles, body.lower, body.upper)

    poses = forward_kinematics(body, angles)
    base_height = base_height + _lift(poses.joint, base_height, body.foot_radius)
    clear = base_height[:, None] + poses.joint[:, :, 2, 2] >= KNEE_CLEARANCE
    torque = static_torque(body, poses)
    strong = np.abs(torque) < body.effort
    return Stance(
        joints=angles,
        torque=np.clip(torque, -body.effort, body.effort),
        base_height=base_height,
        hip_height=base_height + poses.joint[:, :, 1, 2].mean(axis=1),
        feasible=(solvable & clear).all(axis=1) & (within & strong).all(axis=(1, 2)),
    )


def static_torque(body: Skeleton, poses: LegPoses) -> Array:
    """Joint torques (n, 4, 3) [N m] that hold the links and push each foot down with its share of the weight.

    The four vertical foot forces balance weight, pitch and roll moment; of all that do, the ones with the
    least sum of squares are taken.
    """
    feet = poses.joint[:, :, 3]
    mass = body.link_mass.reshape(body.n, -1)
    moment = (mass[..., None] * poses.com.reshape(body.n, -1, 3)).sum(axis=1) + body.base_mass * body.base_com
    total = body.total_mass
    balance = np.stack([np.ones((body.n, 4)), feet[..., 0], feet[..., 1]], axis=1)
    load = np.stack([total, moment[:, 0], moment[:, 1]], axis=1) * GRAVITY
    foot_force = (np.linalg.pinv(balance) @ load[..., None])[..., 0]

    torque = np.zeros((body.n, 4, 3))
    for k in range(3):
        origin = poses.joint[:, :, k]
        vertical = _vertical_moment(feet - origin, foot_force)
        for link in range(k, 4):
            vertical -= _vertical_moment(poses.com[:, :, link] - origin, body.link_mass[:, :, link] * GRAVITY)
        torque[:, :, k] = -(poses.axis[:, :, k] * vertical).sum(axis=-1)
    return torque


def _vertical_moment(arm: Array, force: Array) -> Array:
    """Moment of an upward force at a lever arm."""
    return np.stack([arm[..., 1] * force, -arm[..., 0] * force, np.zeros_like(force)], axis=-1)


def _lift(joint: Array, base_height: Array, foot_radius: Array) -> Array:
    """How far to raise each base so that its lowest foot sphere touches the floor."""
    return -(base_height[:, None] + joint[:, :, 3, 2] - foot_radius).min(axis=1)


def _rotate(rotation: Array, vector: Array) -> Array:
    return (rotation @ vector[..., None])[..., 0]


def _rotation_about(axis: Array, angle: Array) -> Array:
    """Rodrigues' formula: axes (4, 3) and angles (n, 4) to matrices (n, 4, 3, 3)."""
    x, y, z = axis.T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(4, 3, 3)
    sin, cos = np.sin(angle)[..., None, None], np.cos(angle)[..., None, None]
    return np.eye(3) + sin * cross + (1 - cos) * (cross @ cross)
