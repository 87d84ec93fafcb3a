"""The chosen body as coloured triangles that a page can draw at once."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import trimesh
from morphgen import BodyFactory
from morphgen.urdf.meshes import face_colors
from morphgen.views.scene import body_scene

from legged_codesign.robots import body_factory
from legged_codesign.run_folder import read_config

CORNER = np.dtype([("position", "<f4", 3), ("color", "u1", 4)])
"""A corner of a triangle: position [m], z up and the floor at 0, and colour."""


def triangles(scene: trimesh.Scene) -> bytes:
    """The triangles of a scene, three corners of `CORNER` each, one after the other."""
    parts = []
    for node in scene.graph.nodes_geometry:
        pose, name = scene.graph[node]
        mesh = scene.geometry[name]
        if not isinstance(mesh, trimesh.Trimesh):
            continue
        part = np.zeros((len(mesh.faces), 3), CORNER)
        part["position"] = trimesh.transform_points(mesh.vertices, pose)[mesh.faces]
        part["color"] = _colors(mesh)[:, None]
        parts.append(part.tobytes())
    return b"".join(parts)


class Bodies:
    """Draws the bodies of a run.

    Args:
        folder: of the run.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._factory: BodyFactory | None = None
        self._drawn: dict[tuple[float, ...], bytes] = {}

    def nominal(self) -> bytes:
        """The triangles of the robot as it is."""
        return self._draw(tuple(self._robot().space.nominal))

    def of(self, params: Mapping[str, float | int | str]) -> bytes:
        """The triangles of the body with these design parameters.

        Raises:
            RunError, MorphologyError, LookupError, OSError: the robot cannot be loaded any more.
            KeyError: a parameter is missing.
        """
        return self._draw(tuple(float(params[name]) for name in self._robot().space.names))

    def _robot(self) -> BodyFactory:
        if self._factory is None:
            config = read_config(self._folder)
            self._factory = body_factory(config.robot, config.bodies)
        return self._factory

    def _draw(self, design: tuple[float, ...]) -> bytes:
        if design not in self._drawn:
            if len(self._drawn) > 8:  # a long search has many best bodies, meshes of robots are large
                self._drawn.clear()
            self._drawn[design] = triangles(body_scene(self._robot(), np.array(design)))
        return self._drawn[design]


def _colors(mesh: trimesh.Trimesh) -> np.ndarray:
    """Colour of each face, (F, 4), from 0 to 255."""
    colors = face_colors(mesh)
    return np.full((len(mesh.faces), 4), (200, 200, 200, 255)) if colors is None else colors
