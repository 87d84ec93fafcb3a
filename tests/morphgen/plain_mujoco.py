"""A URDF compiled by MuJoCo alone: an independent judge of what was exported."""

from __future__ import annotations

import mujoco
import numpy as np
from lxml import etree


def compile_urdf(text: str) -> mujoco.MjModel:
    """A free robot whose links keep their masses and names."""
    root = etree.fromstring(text.encode())
    for link in root.findall("link"):
        for visual in link.findall("visual"):  # MuJoCo refuses several materials and cannot find packages
            link.remove(visual)
    for joint in root.findall("joint[@type='floating']"):  # which it only takes on top of a link called world
        joint.set("type", "fixed")
    spec = mujoco.MjSpec.from_string(etree.tostring(root, encoding="unicode"))
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    spec.compiler.fusestatic = False
    spec.worldbody.first_body().add_freejoint()
    return spec.compile()


def mass_matrix(model: mujoco.MjModel, data: mujoco.MjData, joints: tuple[str, ...]) -> np.ndarray:
    """(6 + k, 6 + k) of the free base and these joints, without armature."""
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    full -= np.diag(model.dof_armature)
    order = [*range(6), *(int(model.joint(name).dofadr[0]) for name in joints)]
    return full[np.ix_(order, order)]


def pose(model: mujoco.MjModel, base: np.ndarray, joints: tuple[str, ...], angles: np.ndarray) -> mujoco.MjData:
    """The robot with its base at (7,) and its joints at these angles."""
    data = mujoco.MjData(model)
    data.qpos[:7] = base
    for name, angle in zip(joints, angles, strict=True):
        data.qpos[model.joint(name).qposadr[0]] = angle
    mujoco.mj_forward(model, data)
    return data


def random_poses(n: int, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Bases (7,) and angles (12,)."""
    rng = np.random.default_rng(seed)
    poses = []
    for _ in range(n):
        quat = rng.normal(size=4)
        poses.append((np.concatenate([rng.normal(size=3), quat / np.linalg.norm(quat)]), rng.uniform(-1, 1, 12)))
    return poses


def ball_centre(model: mujoco.MjModel, data: mujoco.MjData, body: str) -> np.ndarray:
    """(3,) centre of the sphere on a body."""
    spheres = np.flatnonzero(
        (model.geom_bodyid == model.body(body).id) & (model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE)
    )
    assert len(spheres) == 1
    return data.geom_xpos[spheres[0]].copy()
