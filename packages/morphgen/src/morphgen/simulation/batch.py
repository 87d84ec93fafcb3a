"""n bodies as per-simulation fields of one compiled MuJoCo model."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from morphgen.simulation.layout import Layout
from morphgen.simulation.model import Drive, collision_geom
from morphgen.stance.skeleton import Array, Skeleton
from morphgen.stance.solve import Stance
from morphgen.urdf.legs import LegMap


@dataclass(frozen=True)
class BodyBatch:
    """n bodies that share the structure of one model.

    Attributes:
        designs: (n, d) design vectors.
        model: the nominal body in its scene.
        fields: every MjModel field that differs between bodies, (n, *shape of the field); write them through
            `mujoco.batch.Batch.expand()`, then call `Batch.set_const()`, which derives the rest.
        stance_qpos: (n, nq) stance on a floor at z = 0: base at x = y = 0 and level.
        stance_ctrl: (n, 12) servo targets that hold the stance: its angles + static torque / kp [rad].
        feasible: (n,) whether the stance is sound, see `morphgen.stance.Stance`.
        kp: (n, 12) servo stiffness [N m/rad].
        kd: (n, 12) servo damping [N m s/rad].
        torque_limit: (n, 12) [N m].
        velocity_limit: (n, 12) [rad/s]; data for controllers, not enforced by the model.
        joint_lower: (n, 12) [rad].
        joint_upper: (n, 12) [rad].
        total_mass: (n,) [kg].
        hip_height: (n,) height of the thigh joint axes above the floor in the stance [m].
    """

    designs: Array
    model: mujoco.MjModel
    fields: Mapping[str, Array]
    stance_qpos: Array
    stance_ctrl: Array
    feasible: NDArray[np.bool_]
    kp: Array
    kd: Array
    torque_limit: Array
    velocity_limit: Array
    joint_lower: Array
    joint_upper: Array
    total_mass: Array
    hip_height: Array

    @property
    def n(self) -> int:
        """Number of bodies."""
        return len(self.designs)

    def take(self, ids: ArrayLike) -> BodyBatch:
        """The bodies with these row numbers, (m,), in this order; repeats allowed."""
        rows = np.asarray(ids)
        if rows.ndim != 1 or not np.issubdtype(rows.dtype, np.integer):
            raise TypeError(f"ids must be a vector of integers, got shape {rows.shape} of {rows.dtype}")
        shared = ("model", "fields")
        arrays = {name: getattr(self, name)[rows] for name in self.__dataclass_fields__ if name not in shared}
        return replace(self, **arrays, fields={name: values[rows] for name, values in self.fields.items()})


def make_batch(
    designs: Array,
    model: mujoco.MjModel,
    bodies: Skeleton,
    stance: Stance,
    leg_map: LegMap,
    layout: Layout,
    drive: Drive,
) -> BodyBatch:
    """Assemble a batch from the compiled nominal model and the numbers of n bodies."""
    n = len(designs)
    qpos = np.zeros((n, model.nq))
    qpos[:] = model.qpos0
    free = model.joint(f"{layout.base}_free").qposadr[0]
    qpos[:, free : free + 7] = (0, 0, 0, 1, 0, 0, 0)
    qpos[:, free + 2] = stance.base_height
    addresses = [model.joint(name).qposadr[0] for name in layout.joints]
    joints = stance.joints.reshape(n, -1)
    qpos[:, addresses] = joints

    def per_body(values: Array | float) -> Array:
        return np.tile(np.broadcast_to(values, (4, 3)).ravel(), (n, 1))

    return BodyBatch(
        designs=designs,
        model=model,
        fields=model_fields(model, bodies, leg_map),
        stance_qpos=qpos,
        stance_ctrl=joints + stance.torque.reshape(n, -1) / drive.kp,
        feasible=stance.feasible,
        kp=per_body(drive.kp),
        kd=per_body(drive.kd),
        torque_limit=per_body(bodies.effort),
        velocity_limit=per_body(bodies.velocity),
        joint_lower=per_body(bodies.lower),
        joint_upper=per_body(bodies.upper),
        total_mass=bodies.total_mass,
        hip_height=stance.hip_height,
    )


def model_fields(model: mujoco.MjModel, bodies: Skeleton, leg_map: LegMap) -> dict[str, Array]:
    """The MjModel fields that scaling changes, (n, *shape): masses, inertias, knees, ankles and boxes.

    A box keeps its centre of mass at its centre and its axes principal at every scale, so the frames that the
    compiler flagged as equal (`geom_sameframe`) stay equal and MuJoCo's shortcut for them stays valid.
    """
    names = ("body_mass", "body_inertia", "body_pos", "body_ipos", "geom_pos", "geom_size")
    fields = {name: np.repeat(np.asarray(getattr(model, name))[None], bodies.n, axis=0) for name in names}
    for i, leg in enumerate(leg_map.legs):
        ids = [model.body(name).id for name in leg.links]
        for part, link in ((0, 1), (1, 2)):
            body, geom = ids[link], model.geom(collision_geom(leg.links[link], 0)).id
            fields["body_mass"][:, body] = bodies.link_mass[:, i, link]
            fields["body_inertia"][:, body] = bodies.segment_inertia[:, i, part]
            fields["body_ipos"][:, body] = bodies.link_com[:, i, link]
            fields["geom_pos"][:, geom] = bodies.link_com[:, i, link]
            fields["geom_size"][:, geom] = bodies.segment_box[:, i, part] / 2
            fields["body_pos"][:, ids[link + 1]] = bodies.joint_origin[:, i, link + 1]
    return fields
