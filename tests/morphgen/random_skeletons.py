"""Random quadrupeds as skeletons, and the MuJoCo spec of one, built part by part."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import mujoco
import numpy as np
from morphgen.skeleton import Skeleton

LEGS = ("FL", "FR", "RL", "RR")
PARTS = ("hip", "thigh", "shank", "foot")
SIDE = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])


def random_inertia(rng: np.random.Generator, *shape: int, size: float) -> np.ndarray:
    """(*shape, 3, 3) inertias per unit mass of clouds of points, so they are those of rigid bodies."""
    points = rng.normal(size=(*shape, 8, 3)) * size
    points -= points.mean(axis=-2, keepdims=True)
    second = np.einsum("...pi,...pj->...ij", points, points) / 8
    return np.trace(second, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - second


def random_skeleton(rng: np.random.Generator, n: int = 1) -> Skeleton:
    """n bodies with oblique segments, lateral offsets, axes of either sign and feet of several radii, no limits."""
    side = np.concatenate([SIDE, np.ones((4, 1))], axis=1)
    origin = np.stack(
        [
            rng.uniform((0.2, 0.05, -0.03), (0.3, 0.1, 0.03), (n, 4, 3)) * side,
            rng.uniform((-0.02, 0.05, -0.02), (0.02, 0.12, 0.02), (n, 4, 3)) * side,
            rng.uniform((-0.1, -0.1, -0.3), (0.1, 0.1, -0.2), (n, 4, 3)),
            rng.uniform((-0.12, -0.05, -0.33), (0.12, 0.05, -0.22), (n, 4, 3)),
        ],
        axis=2,
    )
    mass = rng.uniform((0.5, 0.5, 0.1, 0.02), (1.5, 1.5, 0.3, 0.1), (n, 4, 4))
    base_mass = rng.uniform(8, 25, n)
    axis = np.zeros((4, 3, 3))
    axis[:, 0, 0], axis[:, 1, 1], axis[:, 2, 1] = rng.choice([-1.0, 1.0], (3, 4))
    return Skeleton(
        joint_origin=origin,
        link_mass=mass,
        link_com=rng.normal(size=(n, 4, 4, 3)) * 0.03
        + np.concatenate([origin[:, :, 1:], np.zeros((n, 4, 1, 3))], 2) / 2,
        link_inertia=mass[..., None, None] * random_inertia(rng, n, 4, 4, size=0.04),
        base_mass=base_mass,
        base_com=rng.uniform(-0.03, 0.03, (n, 3)),
        base_inertia=base_mass[:, None, None] * random_inertia(rng, n, size=0.15),
        foot_radius=rng.uniform(0.015, 0.03, (n, 4)),
        axis=axis,
        lower=np.full((4, 3), -np.inf),
        upper=np.full((4, 3), np.inf),
        effort=np.full((4, 3), np.inf),
        velocity=np.full((4, 3), np.inf),
        damping=np.full((4, 3), 0.1),
        friction=np.full((4, 3), 0.1),
    )


def straight_skeleton(thigh: float = 0.25, shank: float = 0.25, n: int = 1) -> Skeleton:
    """n equal bodies whose mass is all in the base, with straight legs: numbers to work with by hand."""
    straight = np.zeros((4, 4, 3))
    straight[:, 0] = SIDE @ np.array([[0.2, 0, 0], [0, 0.05, 0]])
    straight[:, 1, 1] = 0.1 * SIDE[:, 1]
    straight[:, 2, 2], straight[:, 3, 2] = -thigh, -shank
    axis = np.tile(np.eye(3)[[0, 1, 1]], (4, 1, 1))
    return Skeleton(
        joint_origin=np.tile(straight, (n, 1, 1, 1)),
        link_mass=np.zeros((n, 4, 4)),
        link_com=np.zeros((n, 4, 4, 3)),
        link_inertia=np.zeros((n, 4, 4, 3, 3)),
        base_mass=np.full(n, 10.0),
        base_com=np.zeros((n, 3)),
        base_inertia=np.tile(np.eye(3), (n, 1, 1)),
        foot_radius=np.full((n, 4), 0.02),
        axis=axis,
        lower=np.full((4, 3), -np.inf),
        upper=np.full((4, 3), np.inf),
        effort=np.full((4, 3), np.inf),
        velocity=np.full((4, 3), np.inf),
        damping=np.zeros((4, 3)),
        friction=np.zeros((4, 3)),
    )


def build_spec(body: Skeleton, row: int = 0, *, kp: float = 0.0, kd: float = 0.0) -> mujoco.MjSpec:
    """One of the bodies, free above a plane at z = 0, with position servos where kp is given.

    Feet are spheres; every other joint carries a sphere of 1 cm, named as its body, so that a knee that meets the
    floor shows as a contact.
    """
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, -9.81]
    spec.option.timestep = 0.002
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05], contype=0)
    base = spec.worldbody.add_body(name="base")
    base.add_freejoint()
    _set_inertial(base, body.base_mass[row], body.base_com[row], body.base_inertia[row])
    for i, leg in enumerate(LEGS):
        parent = base
        for k, part in enumerate(PARTS):
            parent = parent.add_body(name=f"{leg}_{part}", pos=body.joint_origin[row, i, k])
            _set_inertial(parent, body.link_mass[row, i, k], body.link_com[row, i, k], body.link_inertia[row, i, k])
            radius = body.foot_radius[row, i] if part == "foot" else 0.01
            parent.add_geom(name=parent.name, size=[radius, 0, 0], conaffinity=0)
            if part == "foot":
                continue
            joint = parent.add_joint(name=parent.name, axis=body.axis[i, k])
            joint.damping[0], joint.frictionloss = body.damping[i, k], body.friction[i, k]
            joint.armature = 0.01 if kp else 0.0
            if kp:
                servo = spec.add_actuator(name=parent.name, target=parent.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
                servo.set_to_position(kp=kp, kv=kd)
    return spec


def posed(
    body: Skeleton, angles: np.ndarray, height: float = 0.0, row: int = 0
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Model and data of one body with its base level at a height and the joints at angles (4, 3)."""
    model = build_spec(body, row).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = [0, 0, height, 1, 0, 0, 0, *angles.ravel()]
    mujoco.mj_forward(model, data)
    return model, data


def _set_inertial(part: mujoco.MjsBody, mass: float, com: np.ndarray, inertia: np.ndarray) -> None:
    part.explicitinertial = True
    part.mass, part.ipos = mass, com
    part.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
