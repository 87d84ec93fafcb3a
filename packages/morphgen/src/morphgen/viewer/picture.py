"""What the viewer shows of a design: surfaces in their places, measurements and verdicts; knows no browser."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from trimesh.transformations import quaternion_from_matrix

from morphgen.factory import BodyFactory
from morphgen.skeleton import Array
from morphgen.urdf.repair import check_inertia
from morphgen.urdf.tree import read_tree
from morphgen.views.dimensions import dimensions
from morphgen.views.scene import body_scene

_SAME = 1e-6
"""Largest distance [m] of surfaces that look the same."""


@dataclass(frozen=True)
class Solid:
    """A coloured surface in the world.

    Attributes:
        name: of its node in `body_scene`, the same for every design.
        mesh: in its own axes, before the scale; the nominal body's wherever a scale along its axes is all that
            tells the two apart.
        scale: (3,) factors along the mesh's axes.
        position: (3,) [m], z up from the floor.
        wxyz: (4,) unit quaternion.
    """

    name: str
    mesh: trimesh.Trimesh
    scale: Array
    position: Array
    wxyz: Array


@dataclass(frozen=True)
class Picture:
    """One design as it is shown.

    Attributes:
        design: (d,) values of the design parameters.
        solids: the robot in its stance, forward along x, the base above the origin.
        dimensions: measurements by name, the unit ending each name; see `views.dimensions`.
        links: number of links that have an inertia.
        invalid_links: those whose inertia no rigid body has, with the reason.
        problems: why the body cannot stand; empty when it is feasible.
        missing: visual meshes that are not shown, with the reason.
    """

    design: Array
    solids: tuple[Solid, ...]
    dimensions: dict[str, float]
    links: int
    invalid_links: dict[str, str]
    problems: tuple[str, ...]
    missing: tuple[str, ...]

    @property
    def feasible(self) -> bool:
        """Whether the body has a sound stance."""
        return not self.problems


class Pictures:
    """Makes the pictures of the bodies of one robot.

    Attributes:
        factory: of the robot.
        nominal: the unmodified robot.
    """

    def __init__(self, factory: BodyFactory) -> None:
        """Picture the nominal robot, whose surfaces the others share."""
        self.factory = factory
        self._meshes: dict[str, trimesh.Trimesh] = {}
        self.nominal = self.of(factory.space.nominal)
        self._meshes = {solid.name: solid.mesh for solid in self.nominal.solids}

    def of(self, design: ArrayLike) -> Picture:
        """The picture of one design (d,).

        Raises:
            MorphologyError: the design is out of bounds, or no body can be made of it.
        """
        checked = self.factory.space.validated(design)[0]
        scene = body_scene(self.factory, checked)
        links = read_tree(self.factory.urdf(checked), self.factory.name).links
        checks = {link.name: check_inertia(link.inertial) for link in links if link.inertial is not None}
        return Picture(
            design=checked,
            solids=tuple(self._solid(scene, node) for node in scene.graph.nodes_geometry),
            dimensions=dimensions(self.factory, checked),
            links=len(checks),
            invalid_links={name: problem for name, problem in checks.items() if problem is not None},
            problems=self.factory.problems(checked),
            missing=tuple(scene.metadata["missing"]),
        )

    def _solid(self, scene: trimesh.Scene, node: str) -> Solid:
        pose, geometry = scene.graph[node]
        mesh = scene.geometry[geometry]
        assert isinstance(mesh, trimesh.Trimesh)
        scale = np.ones(3)
        if (nominal := self._meshes.get(node)) is not None and (found := stretch(nominal, mesh)) is not None:
            mesh, scale = nominal, found
        return Solid(node, mesh, scale, pose[:3, 3], quaternion_from_matrix(pose))


def stretch(mesh: trimesh.Trimesh, other: trimesh.Trimesh) -> Array | None:
    """Factors (3,) along the axes of a mesh that make it another one; None if no factors do."""
    if mesh.faces.shape != other.faces.shape or mesh.vertices.shape != other.vertices.shape:
        return None
    size = np.abs(mesh.vertices).max(axis=0)
    scale = np.where(size > 0, np.abs(other.vertices).max(axis=0) / np.where(size > 0, size, 1), 1)
    # a check of faces would cost more than it tells: both come from the same shape of the URDF
    return scale if np.abs(mesh.vertices * scale - other.vertices).max() < _SAME else None
