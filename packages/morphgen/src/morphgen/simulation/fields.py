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
    *,
    turning: bool,
) -> dict[str, Array]:
    """The MjModel fields that scaling changes, (n, *shape): masses, inertias, joints and primitives.

    Parts equal to the nominal ones keep the compiler's numbers.

    Args:
        model: the compiled nominal body; with `turning`, its shortcuts for aligned frames (`body_sameframe`,
            `geom_sameframe`) are switched off where scaling breaks them.
        nominal: the numbers of that body.
        bodies: numbers of n bodies.
        collisions: their geoms.
        layout: names.
        turning: whether principal axes and geoms may turn; False keeps them parallel to their bodies.
    """
    n = bodies.n
    names = _ALWAYS + (_TURNING if turning else ())
    fields = {name: np.repeat(np.asarray(getattr(model, name))[None], n, axis=0) for name in names}
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
        if (inertia != unchanged).any():
            _write_inertia(fields, body, inertia)
    for g, name in enumerate(geom_names(collisions, layout)):
        geom = model.geom(name).id
        fields["geom_size"][:, geom] = geom_size(collisions.kind[g], collisions.size[:, g])
        fields["geom_pos"][:, geom] = collisions.position[:, g]
        if turning and (collisions.rotation[:, g] != nominal[1].rotation[:, g]).any():
            fields["geom_quat"][:, geom] = rotation_to_quat(collisions.rotation[:, g])
    if turning:
        _drop_shortcuts(model, fields)
    return fields


def geom_names(collisions: Collisions, layout: Layout) -> list[str]:
    """Names of the geoms in the order of `Collisions`."""
    count: dict[str, int] = {}
    names = []
    for leg, part in zip(collisions.leg, collisions.part, strict=True):
        body = layout.body(leg, part)
        count[body] = count.get(body, -1) + 1
        names.append(collision_geom(body, count[body]))
    return names


def _write_inertia(fields: dict[str, Array], body: int, inertia: Array) -> None:
    if not inertia[:, [0, 0, 1], [1, 2, 2]].any():
        fields["body_inertia"][:, body] = inertia[:, range(3), range(3)]
        if "body_iquat" in fields:
            fields["body_iquat"][:, body] = (1, 0, 0, 0)
        return
    values, vectors = np.linalg.eigh(inertia)
    vectors[..., 0] *= np.sign(np.linalg.det(vectors))[:, None]
    fields["body_inertia"][:, body] = values
    fields["body_iquat"][:, body] = rotation_to_quat(vectors)


def _drop_shortcuts(model: mujoco.MjModel, fields: dict[str, Array]) -> None:
    for name, position, rotation in (
        ("body_sameframe", "body_ipos", "body_iquat"),
        ("geom_sameframe", "geom_pos", "geom_quat"),
    ):
        changed = np.zeros(len(getattr(model, name)), dtype=bool)
        for field in (position, rotation):
            changed |= (fields[field] != np.asarray(getattr(model, field))).any(axis=(0, 2))
        if name == "geom_sameframe":  # it may also mean the frame of a body's inertia
            changed |= np.isin(
                model.geom_bodyid, np.flatnonzero((fields["body_ipos"] != model.body_ipos).any(axis=(0, 2)))
            )
        getattr(model, name)[changed] = 0
