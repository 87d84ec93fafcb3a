"""The URDF of one scaled body: the file as it was, with new numbers where scaling changed them."""

from __future__ import annotations

import copy
import hashlib
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphgen.scaling.bodies import Bodies, Robot
from morphgen.scaling.design import Morphology
from morphgen.scaling.inertia import stretch_map
from morphgen.scaling.segments import Segment
from morphgen.scaling.shapes import bake_axis
from morphgen.urdf.tree import INERTIA_KEYS, Array, Shape, parse_tree, rpy_of
from morphgen.urdf.xml import Element, format_vector, to_text

Bake = Callable[[Shape, Array], bytes]
"""A visual mesh and a linear map (3, 3) from its own to link axes -> a binary STL in link axes."""


@dataclass(frozen=True)
class ScaledUrdf:
    """A URDF and the meshes that had to be made for it.

    Attributes:
        text: of the URDF; numbers read back to the same float64.
        meshes: new mesh files by the relative name that the text uses.
    """

    text: str
    meshes: dict[str, bytes]


def write_urdf(
    robot: Robot, morphology: Morphology, nominal: Bodies, body: Bodies, bake: Bake | None = None
) -> ScaledUrdf:
    """Write one body (n = 1, with visuals); whatever it shares with the nominal one is left as it was, byte by byte.

    Args:
        robot: what was scaled.
        morphology: how (n = 1).
        nominal: its numbers.
        body: the scaled numbers.
        bake: makes the mesh of an oblique visual that no scale attribute can stretch; None leaves such visuals
            unstretched.
    """
    root = copy.deepcopy(robot.tree.element)
    tree = parse_tree(root)
    for i, link in enumerate(tree.links):
        if _differ(nominal, body, i, "mass", "com", "inertia"):
            _write_inertial(_child(link.element, "inertial"), body.mass[0, i], body.com[0, i], body.inertia[0, i])
    for j, joint in enumerate(tree.joints):
        if _differ(nominal, body, j, "joint_position"):
            _child(joint.element, "origin").set("xyz", format_vector(body.joint_position[0, j]))
    for g, shape in enumerate(tree.shapes):
        if _differ(nominal, body, g, "shape_position", "shape_rotation", "shape_size"):
            _write_shape(shape, body.shape_position[0, g], body.shape_rotation[0, g], body.shape_size[0, g])
    meshes = {} if bake is None else _bake_oblique(robot, tree.shapes, morphology, bake)
    return ScaledUrdf(to_text(root), meshes)


def relocate(text_root: Element, old: Path, new: Path) -> None:
    """Rewrite relative mesh paths, in place, so that they still resolve when the file moves between folders."""
    for mesh in text_root.iter("mesh"):
        name = mesh.get("filename", "")
        if name and "://" not in name and not os.path.isabs(name) and (old / name).exists():
            mesh.set("filename", Path(os.path.relpath(old / name, new)).as_posix())


def _differ(nominal: Bodies, body: Bodies, i: int, *fields: str) -> bool:
    return any(not np.array_equal(getattr(nominal, f)[0, i], getattr(body, f)[0, i]) for f in fields)


def _write_inertial(inertial: Element, mass: float, com: Array, inertia: Array) -> None:
    origin = _child(inertial, "origin")
    origin.set("xyz", format_vector(com))
    if "rpy" in origin.attrib:  # the inertia is given in link axes from here on
        origin.set("rpy", "0 0 0")
    _child(inertial, "mass").set("value", format_vector([mass]))
    element = _child(inertial, "inertia")
    rows, columns = np.triu_indices(3)
    for key, value in zip(INERTIA_KEYS, inertia[rows, columns], strict=True):
        element.set(key, format_vector([value]))


def _write_shape(shape: Shape, position: Array, rotation: Array, size: Array) -> None:
    origin = _child(shape.element, "origin")
    origin.set("xyz", format_vector(position))
    if not np.array_equal(rotation, shape.rotation):
        origin.set("rpy", format_vector(rpy_of(rotation)))
    geometry = shape.element.find(f"geometry/{shape.kind}")
    assert geometry is not None
    if shape.kind == "box":
        geometry.set("size", format_vector(size))
    elif shape.kind == "mesh":
        if not np.array_equal(size, shape.size):
            geometry.set("scale", format_vector(size))
    else:
        geometry.set("radius", format_vector([size[0]]))
        if shape.kind != "sphere":
            geometry.set("length", format_vector([size[1]]))


def oblique_visuals(robot: Robot, morphology: Morphology) -> Iterator[tuple[int, Array, Array]]:
    """Visual meshes of stretched links that no scale attribute can stretch.

    Args:
        robot: what is scaled.
        morphology: how, n designs; links that none of them stretches are left out.

    Yields:
        Index of the shape, the axis (3,) of the stretch in link axes, and the scales (n,).
    """
    for segment, scale in _scales(robot, morphology):
        for link, is_stretched in zip(segment.part.links, segment.stretched, strict=True):
            if not is_stretched or np.all(scale == 1.0):
                continue
            axis = segment.axis_in(link)
            for g, shape in enumerate(robot.tree.shapes):
                visual = shape.link == link and not shape.collision and shape.kind == "mesh"
                if visual and bake_axis(shape.rotation, axis) is None:
                    yield g, axis, scale


def _bake_oblique(robot: Robot, shapes: tuple[Shape, ...], morphology: Morphology, bake: Bake) -> dict[str, bytes]:
    """Replace visuals that no scale attribute can stretch by new meshes."""
    meshes: dict[str, bytes] = {}
    for g, axis, scale in oblique_visuals(robot, morphology):
        shape = shapes[g]
        linear = stretch_map(axis, scale)[0] @ shape.rotation @ np.diag(shape.size)
        data = bake(robot.tree.shapes[g], linear)
        # bodies that share a folder have meshes of their own
        digest = hashlib.sha256(data).hexdigest()[:12]
        name = f"baked/{robot.tree.links[shape.link].name.replace('/', '_')}_{g}_{digest}.stl"
        meshes[name] = data
        geometry = shape.element.find("geometry/mesh")
        assert geometry is not None
        geometry.set("filename", name)
        geometry.attrib.pop("scale", None)
        _child(shape.element, "origin").set("rpy", "0 0 0")
    return meshes


def _scales(robot: Robot, morphology: Morphology) -> list[tuple[Segment, Array]]:
    legs = [
        (segment, morphology.length[:, i, k])
        for i, leg in enumerate(robot.segments.legs)
        for k, segment in enumerate(leg)
    ]
    return [*legs, (robot.segments.trunk, morphology.trunk_length)]


def _child(parent: Element, tag: str) -> Element:
    found = parent.find(tag)
    if found is None:
        # lxml's factory, because its trees take no elements of the standard library
        found = parent.makeelement(tag, {})
        parent.append(found)
    return found
