"""One body in its stance as a trimesh scene: its visual meshes where they are found, else primitives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from trimesh.transformations import rotation_matrix
from trimesh.visual.color import ColorVisuals

from morphgen.errors import MorphologyError
from morphgen.factory import BodyFactory
from morphgen.files import write_bytes
from morphgen.palette import PALETTE, Color
from morphgen.urdf.meshes import face_colors, has_colors, read_stl, scaled
from morphgen.urdf.tree import ACTUATED, Array, Shape, Tree, read_tree
from morphgen.urdf.xml import Element, read_vector
from morphgen.views.gltf import to_glb

WORLD = "/world"  # no link of a robot is called so
_SECTIONS = 48


def body_scene(factory: BodyFactory, design: ArrayLike) -> trimesh.Scene:
    """The body of one design (d,) in its stance: z up, forward x, the floor at z = 0, the base above the origin.

    Each link is a node, named as in the URDF, below that of its parent; its shapes are nodes `link/0`, `link/1`.
    Meshes keep the colours of their file, else they have that of the URDF's <material>, else one by part of
    the robot. A link whose visual mesh is missing shows its collision primitives; `scene.metadata["missing"]`
    lists the reasons. So does every link of a robot without visuals, or one whose missing mesh cannot be
    stretched by its scale alone.

    Raises:
        MorphologyError: the design is out of bounds.
    """
    source = _Shapes(factory, design)
    stance = factory.stance(np.asarray(design, dtype=np.float64)[None])
    angles = dict(zip(factory.layout.joints, stance.joints[0].ravel(), strict=True))
    scene = trimesh.Scene(base_frame=WORLD)
    tree = source.tree
    root = tree.links[tree.root].name
    scene.graph.update(frame_from=WORLD, frame_to=root, matrix=np.eye(4))
    for joint in tree.joints:
        pose = _pose(joint.position, joint.rotation)
        if joint.kind in ACTUATED and joint.name in angles:
            pose = pose @ rotation_matrix(angles[joint.name], joint.axis)
        scene.graph.update(frame_from=tree.links[joint.parent].name, frame_to=tree.links[joint.child].name, matrix=pose)
    base = scene.graph.get(factory.layout.base, root)[0]
    height = _pose(np.array([0, 0, stance.base_height[0]]), np.eye(3))
    scene.graph.update(frame_from=WORLD, frame_to=root, matrix=height @ np.linalg.inv(base))
    for link, name in enumerate(x.name for x in tree.links):
        for i, (mesh, pose) in enumerate(source.of(link)):
            node = f"{name}/{i}"
            scene.add_geometry(mesh, node_name=node, geom_name=node, parent_node_name=name, transform=pose)
    scene.metadata["missing"] = source.missing
    return scene


def export_glb(scene: trimesh.Scene, path: Path) -> None:
    """Write a scene as binary glTF, whose up is y, atomically."""
    turned = scene.copy()
    turned.apply_transform(rotation_matrix(-np.pi / 2, [1, 0, 0]))
    write_bytes(path, to_glb(turned))


class _Shapes:
    """What to show of each link of one body."""

    def __init__(self, factory: BodyFactory, design: ArrayLike) -> None:
        self.missing: list[str] = []
        self._factory = factory
        self._baked: dict[str, bytes] = {}
        try:
            scaled_urdf = factory.scaled_urdf(design)
            text, self._baked = scaled_urdf.text, scaled_urdf.meshes
        except MorphologyError as error:  # a mesh that has to be made anew is missing
            text = factory.urdf(design)
            self.missing.append(str(error))
        self.tree = read_tree(text, factory.name)
        self._materials = _materials(self.tree)
        self._has_visuals = not self.missing and any(not shape.collision for shape in self.tree.shapes)
        self._part = _parts(factory)

    def of(self, link: int) -> list[tuple[trimesh.Trimesh, Array]]:
        """Meshes of a link, scaled and coloured, and their poses (4, 4) in it."""
        own = [(g, shape) for g, shape in enumerate(self.tree.shapes) if shape.link == link]
        if self._has_visuals:
            try:
                return [self._placed(g, shape) for g, shape in own if not shape.collision]
            except MorphologyError as error:
                self.missing.append(str(error))
        return [self._placed(g, shape) for g, shape in own if shape.collision]

    def _placed(self, g: int, shape: Shape) -> tuple[trimesh.Trimesh, Array]:
        mesh = primitive_mesh(shape) if shape.mesh is None else self._mesh(g, shape)
        if not has_colors(mesh):  # colours by face take long to make from those by vertex
            mesh.visual = ColorVisuals(mesh, face_colors=np.tile(self._color(shape), (len(mesh.faces), 1)))
        return mesh, _pose(shape.position, shape.rotation)

    def _mesh(self, g: int, shape: Shape) -> trimesh.Trimesh:
        assert shape.mesh is not None
        # a mesh made for this body lost its colours, but has the faces of the robot's own
        original = self._factory.robot.tree.shapes[g].mesh
        assert original is not None
        loaded = self._factory.meshes.load(original, f"link '{self.tree.links[shape.link].name}' visual")
        if shape.mesh not in self._baked:
            return scaled(loaded, np.diag(shape.size))
        mesh = read_stl(self._baked[shape.mesh])
        if (colors := face_colors(loaded)) is not None:
            mesh.visual = ColorVisuals(mesh, face_colors=colors)
        return mesh

    def _color(self, shape: Shape) -> Color:
        for material in shape.element.findall("material"):
            color = material.find("color")
            if color is not None:
                return _rgba(color)
            if (name := material.get("name", "")) in self._materials:
                return self._materials[name]
        return PALETTE[self._part.get(shape.link, "trunk")]


def primitive_mesh(shape: Shape) -> trimesh.Trimesh:
    """A box, cylinder, capsule or sphere as a mesh in its own axes."""
    radius, length, _ = shape.size
    if shape.kind == "box":
        return trimesh.creation.box(shape.size)
    if shape.kind == "cylinder":
        return trimesh.creation.cylinder(radius, length, sections=_SECTIONS)
    if shape.kind == "capsule":
        return trimesh.creation.capsule(length, radius, count=(_SECTIONS, _SECTIONS // 2))
    return trimesh.creation.uv_sphere(radius, count=(_SECTIONS // 2, _SECTIONS))


def _pose(position: Array, rotation: Array) -> Array:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return pose


def _materials(tree: Tree) -> dict[str, Color]:
    """Colours of materials by name; those of the robot come before those that a visual defines."""
    colors: dict[str, Color] = {}
    for material in (*tree.element.findall("material"), *tree.element.iter("material")):
        color = material.find("color")
        if color is not None:
            colors.setdefault(material.get("name", ""), _rgba(color))
    return colors


def _rgba(color: Element) -> Color:
    r, g, b, a = np.clip(read_vector(color, "rgba", (0.8, 0.8, 0.8, 1), "material"), 0, 1)
    return (round(255 * r), round(255 * g), round(255 * b), round(255 * a))


def _parts(factory: BodyFactory) -> dict[int, str]:
    """Part of the robot by link, without the trunk's."""
    names: dict[int, str] = {}
    for leg in factory.robot.leg_map.legs:
        for part, name in zip(leg.parts, ("hip", "thigh", "shank"), strict=True):
            names |= dict.fromkeys(part.links, name)
        names[leg.foot] = "foot"
    return names
