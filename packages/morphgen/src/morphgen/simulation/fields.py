"""Per-body MjModel fields of n bodies, without a compilation per body."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

import mujoco
import numpy as np

from morphgen.scaling.articulate import Collisions
from morphgen.simulation.layout import Layout
from morphgen.simulation.model import collision_geom, geom_size, rotation_to_quat
from morphgen.skeleton import Array, Skeleton

_ALWAYS = ("body_mass", "body_inertia", "body_pos", "body_ipos", "geom_pos", "geom_size")
_TURNING = ("body_iquat", "geom_quat")


def model_fields(
    model: mujoco.MjModel,
    nominal: tuple[Skeleton, Collisions],
    bodies: Skeleton,
    collisions: Collisions,
    layout: Layout,
) -> dict[str, Array]:
    """The MjModel fields that scaling changes, (n, *shape): masses, inertias, joints and primitives.

    Parts equal to the nominal ones keep the compiler's numbers. Orientations are among the fields if any changes.

    Args:
        model: the compiled nominal body.
        nominal: the numbers of that body.
        bodies: numbers of n bodies.
        collisions: their geoms.
        layout: names.
    """
    n = bodies.n
    fields = {name: np.repeat(np.asarray(getattr(model, name))[None], n, axis=0) for name in (*_ALWAYS, *_TURNING)}
    parts = [(-1, -1), *((leg, part) for leg in range(4) for part in range(4))]
    for leg, part in parts:
        body = model.body(layout.body(leg, part)).id
        if leg < 0:
            mass, com, inertia = bodies.base_mass, bodies.base_com, bodies.base_inertia
            unchanged = nominal[0].base_inertia
        else:
            mass, com, inertia = (
                getattr(bodies, name)[:, leg, part] for name in ("link_mass", "link_com", "link_inertia")
            )
            unchanged = nominal[0].link_inertia[:, leg, part]
            fields["body_pos"][:, body] = bodies.joint_origin[:, leg, part]
        fields["body_mass"][:, body] = mass
        fields["body_ipos"][:, body] = com
        changed = (inertia != unchanged).any(axis=(1, 2))
        if changed.any():
            fields["body_inertia"][changed, body], fields["body_iquat"][changed, body] = _principal(inertia[changed])
    for g, name in enumerate(geom_names(collisions, layout)):
        geom = model.geom(name).id
        fields["geom_size"][:, geom] = geom_size(collisions.kind[g], collisions.size[:, g])
        fields["geom_pos"][:, geom] = collisions.position[:, g]
        turned = (collisions.rotation[:, g] != nominal[1].rotation[:, g]).any(axis=(1, 2))
        if turned.any():
            fields["geom_quat"][turned, geom] = rotation_to_quat(collisions.rotation[turned, g])
    return {k: v for k, v in fields.items() if k in _ALWAYS or (v != getattr(model, k)).any()}


def gain_fields(model: mujoco.MjModel, layout: Layout, kp: Array, kd: Array) -> dict[str, Array]:
    """Gain and bias of position servos, torque = kp ctrl - kp q - kd dq, for gains (n, 12)."""
    gain, bias = (
        np.repeat(np.asarray(values)[None], len(kp), axis=0)
        for values in (model.actuator_gainprm, model.actuator_biasprm)
    )
    ids = [model.actuator(name).id for name in layout.actuators]
    gain[:, ids, 0] = kp
    bias[:, ids, 1] = -kp
    bias[:, ids, 2] = -kd
    return {"actuator_gainprm": gain, "actuator_biasprm": bias}


def geom_names(collisions: Collisions, layout: Layout) -> list[str]:
    """Names of the geoms in the order of `Collisions`."""
    count: dict[str, int] = {}
    names = []
    for leg, part in zip(collisions.leg, collisions.part, strict=True):
        body = layout.body(leg, part)
        count[body] = count.get(body, -1) + 1
        names.append(collision_geom(body, count[body]))
    return names


def _principal(inertia: Array) -> tuple[Array, Array]:
    """Principal moments (n, 3) and the quaternions (n, 4) of their axes, for inertias (n, 3, 3)."""
    if not inertia[:, [0, 0, 1], [1, 2, 2]].any():
        return inertia[:, range(3), range(3)], np.tile([1.0, 0.0, 0.0, 0.0], (len(inertia), 1))
    values, vectors = np.linalg.eigh(inertia)
    vectors[..., 0] *= np.sign(np.linalg.det(vectors))[:, None]
    return values, rotation_to_quat(vectors)
