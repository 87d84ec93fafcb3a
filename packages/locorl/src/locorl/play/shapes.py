"""The visible geoms of a model as triangles."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.transformations import quaternion_matrix

from locorl.interfaces import Array

Color = tuple[int, int, int]
_HIDDEN_GROUP = 3
"""Geoms of this group and beyond are not shown, as in MuJoCo's own viewers."""
_SECTIONS = 24
_SHADE = 12
"""Step to which the colours of a height field are rounded."""


class Surface(NamedTuple):
    """Triangles in one colour.

    Attributes:
        vertices: (V, 3), m.
        faces: vertices of each triangle, counter-clockwise from outside, (F, 3).
        color: red, green, blue from 0 to 255.
        opacity: from 0 to 1.
    """

    vertices: Array
    faces: NDArray[np.int64]
    color: Color
    opacity: float


def surfaces(model: mujoco.MjModel) -> dict[int, list[Surface]]:
    """The visible surfaces of each body that has any, in the body's frame, one for each colour.

    Body 0 is the world, which also holds whatever is fixed to it. Planes, which have no end, are left out.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    parts: dict[tuple[int, tuple[int, ...]], list[trimesh.Trimesh]] = {}
    for geom in range(model.ngeom):
        mesh, colors = _mesh(model, geom), _colors(model, geom)
        if mesh is None or model.geom_group[geom] >= _HIDDEN_GROUP or not colors[0, 3]:
            continue
        body = int(model.geom_bodyid[geom])
        if model.body_weldid[body] == 0:
            body, pose = 0, np.eye(4)
            pose[:3, :3], pose[:3, 3] = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
        else:
            pose = quaternion_matrix(model.geom_quat[geom])
            pose[:3, 3] = model.geom_pos[geom]
        mesh.apply_transform(pose)
        colors = np.broadcast_to(colors, (len(mesh.vertices), 4))[mesh.faces[:, 0]]
        for color in np.unique(colors, axis=0):
            faces = mesh.faces[(colors == color).all(axis=1)]
            part = trimesh.Trimesh(mesh.vertices, faces, process=False)
            part.remove_unreferenced_vertices()
            parts.setdefault((body, tuple(color.tolist())), []).append(part)
    found: dict[int, list[Surface]] = {}
    for (body, (red, green, blue, alpha)), meshes in parts.items():
        whole = trimesh.util.concatenate(meshes)
        found.setdefault(body, []).append(Surface(whole.vertices, whole.faces, (red, green, blue), alpha / 255))
    return found


def _colors(model: mujoco.MjModel, geom: int) -> NDArray[np.uint8]:
    """Red, green, blue and opacity of a geom, (1, 4), or of each node of a height field whose texture tells, (V, 4).

    Colours of a texture are rounded, so that few differ.
    """
    material = model.geom_matid[geom]
    rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
    color = np.rint(255 * rgba).astype(np.uint8)[None]
    texture = -1 if material < 0 else model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB]
    if texture < 0 or model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_HFIELD:
        return color
    field, count = model.geom_dataid[geom], int(model.tex_width[texture] * model.tex_height[texture])
    shape = model.tex_height[texture], model.tex_width[texture], model.tex_nchannel[texture]
    if shape != (model.hfield_nrow[field], model.hfield_ncol[field], 3):
        return color
    start = int(model.tex_adr[texture])
    texels = model.tex_data[start : start + 3 * count].reshape(count, 3)
    rounded = texels // _SHADE * _SHADE + _SHADE // 2
    return np.concatenate((rounded, np.broadcast_to(color[:, 3:], (count, 1))), axis=1)


def _mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    """The surface of a geom in its own frame; None for a plane or what has no surface."""
    kind, size = mujoco.mjtGeom(int(model.geom_type[geom])), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return trimesh.creation.box(2 * size)
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return trimesh.creation.icosphere(subdivisions=2, radius=size[0])
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return trimesh.creation.icosphere(subdivisions=3).apply_scale(size)
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return trimesh.creation.capsule(2 * size[1], size[0], count=(_SECTIONS, _SECTIONS))
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return trimesh.creation.cylinder(size[0], 2 * size[1], sections=_SECTIONS)
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.mesh(int(model.geom_dataid[geom]))
        vertices = slice(int(mesh.vertadr[0]), int(mesh.vertadr[0] + mesh.vertnum[0]))
        faces = slice(int(mesh.faceadr[0]), int(mesh.faceadr[0] + mesh.facenum[0]))
        return trimesh.Trimesh(model.mesh_vert[vertices], model.mesh_face[faces], process=False)
    if kind == mujoco.mjtGeom.mjGEOM_HFIELD:
        return _relief(model, int(model.geom_dataid[geom]))
    return None


def _relief(model: mujoco.MjModel, field: int) -> trimesh.Trimesh:
    """The top of a height field, its cells split as MuJoCo splits them."""
    rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
    half_x, half_y, height, _ = model.hfield_size[field]
    start = int(model.hfield_adr[field])
    z = height * model.hfield_data[start : start + rows * columns]
    y, x = np.meshgrid(np.linspace(-half_y, half_y, rows), np.linspace(-half_x, half_x, columns), indexing="ij")
    node = np.arange(rows * columns).reshape(rows, columns)
    near, right, left, far = (part.ravel() for part in (node[:-1, :-1], node[:-1, 1:], node[1:, :-1], node[1:, 1:]))
    faces = np.concatenate((np.stack((near, right, far), axis=1), np.stack((near, far, left), axis=1)))
    return trimesh.Trimesh(np.stack((x.ravel(), y.ravel(), z), axis=1), faces, process=False)
