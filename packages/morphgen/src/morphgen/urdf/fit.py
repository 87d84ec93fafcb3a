"""Collision meshes replaced by boxes, cylinders and spheres, which every simulator and every scaling rule knows."""

from __future__ import annotations

import copy
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal
from xml.etree.ElementTree import Element

import numpy as np
import trimesh
from lxml import etree  # pyright: ignore[reportAttributeAccessIssue]
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import ConvexHull, QhullError
from trimesh.bounds import oriented_bounds, oriented_bounds_2D
from trimesh.nsphere import minimum_nsphere

from morphgen.errors import MorphologyError
from morphgen.urdf.meshes import MeshFinder
from morphgen.urdf.tree import Shape, Tree, rpy_of
from morphgen.urdf.xml import format_vector

Array = NDArray[np.float64]

SNAP = 0.05  # volume given away to keep the mesh's axes
THINNEST = 1e-3  # of a flat mesh [m]
LONGEST_FOOT = 2.5  # times its width
_ALONG = ([1, 2, 0], [2, 0, 1], [0, 1, 2])  # columns of a frame that bring its x, y or z to the place of z


@dataclass(frozen=True)
class Primitive:
    """A shape in the axes of the mesh that it encloses.

    Attributes:
        kind: of shape; no capsule, which the URDF specification and most of its readers lack.
        position: (3,) of its centre [m].
        rotation: (3, 3) from its axes to the mesh's.
        size: (3,) as in `Shape`.
    """

    kind: Literal["box", "cylinder", "sphere"]
    position: Array
    rotation: Array
    size: Array

    @property
    def volume(self) -> float:
        """[m^3]."""
        if self.kind == "box":
            return float(self.size.prod())
        radius, length, _ = self.size
        return float(np.pi * radius**2 * (length if self.kind == "cylinder" else 4 / 3 * radius))


def fit_primitive(mesh: trimesh.Trimesh, scale: ArrayLike = (1, 1, 1)) -> Primitive:
    """The smallest box or cylinder around a mesh.

    Its axes are the mesh's own, or share one with them, where that costs at most 5 % of volume: a leg that is
    modelled straight stays straight. The same mesh always gives the same answer.

    Args:
        mesh: its vertices [m].
        scale: (3,) of the mesh along its axes; negative mirrors.
    """
    points = _outermost(mesh, scale)
    best: list[Primitive] = []
    for frames in _frames(points):
        shapes = [shape for frame in frames for shape in (_box(points, frame), *_cylinders(points, frame))]
        best.append(min(shapes, key=lambda shape: shape.volume))
    smallest = min(shape.volume for shape in best)
    return next(shape for shape in best if shape.volume <= (1 + SNAP) * smallest)


def fit_sphere(mesh: trimesh.Trimesh, scale: ArrayLike = (1, 1, 1)) -> Primitive:
    """The smallest sphere around a mesh; arguments as for `fit_primitive`."""
    centre, radius = _ball(_outermost(mesh, scale))
    return Primitive("sphere", centre, np.eye(3), np.array([radius, 0.0, 0.0]))


def with_primitives(tree: Tree, finder: MeshFinder, feet: Collection[int]) -> Tree:
    """A copy of a robot, XML included, whose collision meshes are primitives.

    Args:
        tree: the robot; it stays as it is.
        finder: gives the meshes.
        feet: indices of the links whose meshes become spheres.

    Raises:
        MorphologyError: a mesh is not found or unusable, or that of a foot is too long for a ball.
    """
    root = copy.deepcopy(tree.element)
    twin = dict(zip(tree.element.iter(), root.iter(), strict=True))
    fitted: dict[tuple[object, ...], Primitive] = {}
    shapes: list[Shape] = []
    for shape in tree.shapes:
        element = twin[shape.element]
        if shape.collision and shape.mesh is not None:
            where = f"link '{tree.links[shape.link].name}' collision"
            foot = shape.link in feet
            key = (shape.mesh, *shape.size, foot)
            if key not in fitted:
                mesh = finder.load(shape.mesh, where)
                fitted[key] = _fit_foot(mesh, shape.size, where) if foot else fit_primitive(mesh, shape.size)
            shape = _replaced(shape, fitted[key])
            _write(element, shape)
        shapes.append(replace(shape, element=element))
    return replace(
        tree,
        links=tuple(replace(link, element=twin[link.element]) for link in tree.links),
        joints=tuple(replace(joint, element=twin[joint.element]) for joint in tree.joints),
        shapes=tuple(shapes),
        element=root,
    )


def _fit_foot(mesh: trimesh.Trimesh, scale: Array, where: str) -> Primitive:
    width, longest = np.sort(mesh.extents * np.abs(scale))[1:]
    if longest > LONGEST_FOOT * width:
        raise MorphologyError(
            f"{where}: the mesh of this foot is {longest:.3f} m long and {width:.3f} m wide, which no ball replaces; "
            "give the link a <sphere> where it touches the ground, or name another link as the foot"
        )
    return fit_sphere(mesh, scale)


def _replaced(shape: Shape, primitive: Primitive) -> Shape:
    return replace(
        shape,
        kind=primitive.kind,
        position=shape.position + shape.rotation @ primitive.position,
        rotation=shape.rotation @ primitive.rotation,
        size=primitive.size,
        mesh=None,
    )


def _write(element: Element, shape: Shape) -> None:
    """Put a primitive in the place of the <mesh> of a <collision>."""
    origin = element.find("origin")
    if origin is None:
        origin = etree.Element("origin")
        element.insert(0, origin)
    origin.set("xyz", format_vector(shape.position))
    origin.set("rpy", format_vector(rpy_of(shape.rotation)))
    geometry = element.find("geometry")
    assert geometry is not None  # read_tree saw it
    mesh = geometry.find("mesh")
    assert mesh is not None
    mesh.tag = shape.kind
    mesh.attrib.clear()
    if shape.kind == "box":
        mesh.set("size", format_vector(shape.size))
        return
    mesh.set("radius", format_vector(shape.size[:1]))
    if shape.kind == "cylinder":
        mesh.set("length", format_vector(shape.size[1:2]))


def _outermost(mesh: trimesh.Trimesh, scale: ArrayLike) -> Array:
    """Corners of the convex hull of the scaled mesh; all its vertices if it is flat."""
    points = np.asarray(mesh.vertices, dtype=np.float64) * np.asarray(scale, dtype=np.float64)
    try:
        return points[np.sort(ConvexHull(points).vertices)]
    except QhullError:
        return np.unique(points, axis=0)


def _frames(points: Array) -> Iterator[list[Array]]:
    """Rotations to try: the mesh's axes, then those that share one with it, then the free ones."""
    yield [np.eye(3)]
    turned = []
    for axis in range(3):
        across = [i for i in range(3) if i != axis]
        try:
            to_rectangle = oriented_bounds_2D(points[:, across])[0][:2, :2]
        except QhullError:  # flat, seen along this axis
            continue
        frame = np.eye(3)
        frame[np.ix_(across, across)] = to_rectangle.T
        turned.append(_upright(frame))
    if turned:
        yield turned
    # a point or a line has no such frame, and something flat has no volume to divide by
    with suppress(QhullError, ValueError), np.errstate(invalid="ignore"):
        yield [_upright(oriented_bounds(points)[0][:3, :3].T)]


def _upright(frame: Array) -> Array:
    """The same axes, named and signed so that the rotation is as small as possible."""
    ordered = frame[:, linear_sum_assignment(-np.abs(frame))[1]]
    ordered = ordered * np.where(np.diag(ordered) < 0, -1.0, 1.0)
    if np.linalg.det(ordered) < 0:
        ordered[:, np.argmin(np.diag(ordered))] *= -1
    return ordered


def _box(points: Array, frame: Array) -> Primitive:
    inside = points @ frame
    low, high = inside.min(axis=0), inside.max(axis=0)
    return Primitive("box", frame @ (low + high) / 2, frame, np.maximum(high - low, THINNEST))


def _cylinders(points: Array, frame: Array) -> Iterator[Primitive]:
    for columns in _ALONG:
        rotation = frame[:, columns]
        inside = points @ rotation
        centre, radius = _ball(inside[:, :2])
        low, high = inside[:, 2].min(), inside[:, 2].max()
        size = np.array([max(radius, THINNEST / 2), max(high - low, THINNEST), 0.0])
        yield Primitive("cylinder", rotation @ [*centre, (low + high) / 2], rotation, size)


def _ball(points: Array) -> tuple[Array, float]:
    """Centre and radius of the smallest circle or sphere around points (n, 2 or 3)."""
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    centres = [middle]
    if np.ptp(points, axis=0).min() > 1e-9:
        with suppress(QhullError, ValueError):  # points on a plane or a line
            centres.append(minimum_nsphere(points)[0])
    radii = [float(np.linalg.norm(points - centre, axis=1).max()) for centre in centres]
    return centres[int(np.argmin(radii))], min(radii)
