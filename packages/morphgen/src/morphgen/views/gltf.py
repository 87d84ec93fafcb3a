"""Surfaces as browsers draw them: glTF, matt, round parts smooth and edges sharp."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh
from trimesh.graph import smooth_shade
from trimesh.visual.color import ColorVisuals

from morphgen.urdf.meshes import has_colors

_CREASE, _MOST_FACES = 0.6, 10_000
"""Angle [rad] from which an edge is sharp, and the size from which a mesh keeps the normals of its vertices."""
_MATT = {"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.75}}


def to_glb(shown: trimesh.Trimesh | trimesh.Scene) -> bytes:
    """A mesh or a scene as binary glTF in its own axes, coloured by vertex."""
    scene = trimesh.Scene(shown) if isinstance(shown, trimesh.Trimesh) else shown.copy()
    for name, mesh in scene.geometry.items():
        assert isinstance(mesh, trimesh.Trimesh)
        scene.geometry[name] = _surface(mesh)
    data = scene.export(file_type="glb", tree_postprocessor=_make_matt)
    assert isinstance(data, bytes)
    return data


def _surface(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    shown = smooth_shade(mesh, angle=_CREASE) if len(mesh.faces) <= _MOST_FACES else mesh.copy()
    _ = shown.vertex_normals  # are written once they are known
    if has_colors(shown):
        colors = shown.visual.vertex_colors.copy()  # pyright: ignore[reportOptionalMemberAccess, reportAttributeAccessIssue]
        # glTF takes the colours of vertices as linear in light
        colors[:, :3] = np.round(255 * _linear(colors[:, :3] / 255))
        shown.visual = ColorVisuals(shown, vertex_colors=colors)
    return shown


def _linear(color: np.ndarray) -> np.ndarray:
    """Of sRGB in 0..1 (IEC 61966-2-1)."""
    return np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)


def _make_matt(tree: dict[str, Any]) -> None:
    """Without a material, glTF means metal."""
    tree["materials"] = [_MATT]
    for mesh in tree["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["material"] = 0
