"""A URDF as typed links, joints and shapes, each still tied to its XML element."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from morphgen.errors import MorphologyError, naming
from morphgen.urdf.xml import named, parse_urdf, read_vector

Array = NDArray[np.float64]

ACTUATED = ("revolute", "continuous")
JOINT_TYPES = (*ACTUATED, "prismatic", "fixed", "floating")
INERTIA_KEYS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")

ShapeKind = Literal["box", "cylinder", "capsule", "sphere", "mesh"]


@dataclass(frozen=True)
class Inertial:
    """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m^2], both in link axes."""

    mass: float
    com: Array
    inertia: Array


@dataclass(frozen=True)
class Link:
    """A link; `inertial` is None where the file gives none."""

    name: str
    inertial: Inertial | None
    element: Element


@dataclass(frozen=True)
class Joint:
    """A joint between two links, given by their index in `Tree.links`.

    Attributes:
        name: of the joint.
        kind: revolute, continuous, prismatic, fixed or floating.
        parent: index of the parent link.
        child: index of the child link.
        position: (3,) of the child frame in the parent's [m].
        rotation: (3, 3) of the child frame in the parent's, at zero angle.
        axis: (3,) unit axis in the child frame.
        lower: lower limit [rad]; -inf where the file gives none.
        upper: upper limit [rad]; inf where the file gives none.
        effort: torque limit [N m]; None where the file gives none.
        velocity: velocity limit [rad/s]; None where the file gives none.
        damping: viscous friction [N m s/rad]; None where the file gives none.
        friction: dry friction [N m]; None where the file gives none.
        element: its XML.
    """

    name: str
    kind: str
    parent: int
    child: int
    position: Array
    rotation: Array
    axis: Array
    lower: float
    upper: float
    effort: float | None
    velocity: float | None
    damping: float | None
    friction: float | None
    element: Element


@dataclass(frozen=True)
class Shape:
    """A visual or collision geometry.

    Attributes:
        link: index of its link.
        collision: False for a visual.
        kind: of geometry.
        position: (3,) in the link frame [m].
        rotation: (3, 3) in the link frame.
        size: (3,) box: full sides; cylinder and capsule: radius, length (of a capsule without its caps), 0;
            sphere: radius, 0, 0; mesh: its scale.
        mesh: file name as written, for a mesh.
        element: the <visual> or <collision>.
    """

    link: int
    collision: bool
    kind: ShapeKind
    position: Array
    rotation: Array
    size: Array
    mesh: str | None
    element: Element


@dataclass(frozen=True)
class Tree:
    """A robot: one root link, joints from the root outwards.

    Attributes:
        name: of the robot.
        links: in the order of the file.
        joints: parents before children, else in the order of the file.
        shapes: visuals and collisions, link by link.
        root: index of the root link.
        element: the <robot>.
    """

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    shapes: tuple[Shape, ...]
    root: int
    element: Element

    def link(self, name: str) -> int:
        """Index of the link with this name."""
        for i, link in enumerate(self.links):
            if link.name == name:
                return i
        raise MorphologyError(f"there is no link '{name}'; known: {', '.join(x.name for x in self.links)}")

    def joint(self, name: str) -> int:
        """Index of the joint with this name."""
        for j, joint in enumerate(self.joints):
            if joint.name == name:
                return j
        raise MorphologyError(f"there is no joint '{name}'; known: {', '.join(x.name for x in self.joints)}")

    def below(self, link: int) -> list[int]:
        """Indices of the joints whose parent is this link."""
        return [j for j, joint in enumerate(self.joints) if joint.parent == link]

    def above(self, link: int) -> int | None:
        """Index of the joint whose child is this link; None for the root."""
        return next((j for j, joint in enumerate(self.joints) if joint.child == link), None)


def read_tree(text: str, source: str = "URDF") -> Tree:
    """Read the text of a URDF; units and frames as in the file, nothing repaired.

    Raises:
        MorphologyError: not a plain URDF (see `parse_urdf`), a joint without its links, a loop, several
            roots, an unknown joint type, or a number that is none; names file and element.
    """
    root = parse_urdf(text, source)
    with naming(source):
        return parse_tree(root)


def parse_tree(root: Element) -> Tree:
    """As `read_tree`, from a parsed <robot>, to whose elements the tree stays tied."""
    elements = named(root, "link")
    if not elements:
        raise MorphologyError("the robot has no links")
    index = {name: i for i, name in enumerate(elements)}
    joints = [_read_joint(joint, name, index) for name, joint in named(root, "joint").items()]
    parents: dict[int, Joint] = {}
    for joint in joints:
        if joint.child in parents:
            raise MorphologyError(
                f"link '{list(index)[joint.child]}' is the child of two joints, "
                f"'{parents[joint.child].name}' and '{joint.name}'"
            )
        parents[joint.child] = joint
    roots = [name for name, i in index.items() if i not in parents]
    if len(roots) != 1:
        raise MorphologyError(f"expected one root link, found {', '.join(roots) or 'none, the joints form a loop'}")
    links = tuple(Link(name, _read_inertial(element, f"link '{name}'"), element) for name, element in elements.items())
    shapes = tuple(
        _read_shape(shape, i, tag == "collision", f"link '{name}' {tag}")
        for i, (name, element) in enumerate(elements.items())
        for tag in ("visual", "collision")
        for shape in element.findall(tag)
    )
    ordered = _outwards(joints, index[roots[0]])
    if len(ordered) != len(joints):
        stray = next(joint.name for joint in joints if joint not in ordered)
        raise MorphologyError(f"joint '{stray}' is not connected to root link '{roots[0]}': the joints form a loop")
    return Tree(root.get("name") or "robot", links, tuple(ordered), shapes, index[roots[0]], root)


def _outwards(joints: list[Joint], root: int) -> list[Joint]:
    children: dict[int, list[Joint]] = {}
    for joint in joints:
        children.setdefault(joint.parent, []).append(joint)
    ordered: list[Joint] = []
    stack = list(reversed(children.get(root, [])))
    while stack:
        joint = stack.pop()
        ordered.append(joint)
        stack += reversed(children.get(joint.child, []))
    return ordered


def _read_joint(element: Element, name: str, index: dict[str, int]) -> Joint:
    where = f"joint '{name}'"
    kind = element.get("type", "")
    if kind not in JOINT_TYPES:
        raise MorphologyError(f"{where}: type '{kind}' is not supported ({', '.join(JOINT_TYPES)})")
    ends = []
    for role in ("parent", "child"):
        found = element.find(role)
        link = "" if found is None else found.get("link", "")
        if link not in index:
            raise MorphologyError(f"{where}: its {role} link '{link}' does not exist")
        ends.append(index[link])
    position, rotation = read_origin(element, where)
    axis = read_vector(element.find("axis"), "xyz", (1, 0, 0), f"{where} axis")
    length = float(np.linalg.norm(axis))
    if kind in ACTUATED:
        if length == 0:
            raise MorphologyError(f"{where}: its axis is zero")
        axis = axis / length
    limit, dynamics = element.find("limit"), element.find("dynamics")
    lower, upper = (_number(limit, key, where) for key in ("lower", "upper"))
    if kind == "revolute" and lower is not None and upper is not None and lower > upper:
        raise MorphologyError(f"{where}: its lower limit {lower:g} is above its upper limit {upper:g}")
    bounded = kind == "revolute"
    return Joint(
        name=name,
        kind=kind,
        parent=ends[0],
        child=ends[1],
        position=position,
        rotation=rotation,
        axis=axis,
        lower=lower if bounded and lower is not None else -np.inf,
        upper=upper if bounded and upper is not None else np.inf,
        effort=_number(limit, "effort", where),
        velocity=_number(limit, "velocity", where),
        damping=_number(dynamics, "damping", where),
        friction=_number(dynamics, "friction", where),
        element=element,
    )


def _number(element: Element | None, key: str, where: str) -> float | None:
    if element is None or element.get(key) is None:
        return None
    return float(read_vector(element, key, (0,), where)[0])


def _read_inertial(link: Element, where: str) -> Inertial | None:
    inertial = link.find("inertial")
    if inertial is None:
        return None
    com, rotation = read_origin(inertial, f"{where} inertial")
    mass = float(read_vector(inertial.find("mass"), "value", (0,), f"{where} mass")[0])
    element = inertial.find("inertia")
    ixx, ixy, ixz, iyy, iyz, izz = (
        float(read_vector(element, key, (0,), f"{where} inertia")[0]) for key in INERTIA_KEYS
    )
    inertia = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
    return Inertial(mass, com, rotation @ inertia @ rotation.T)


def _read_shape(element: Element, link: int, collision: bool, where: str) -> Shape:
    position, rotation = read_origin(element, where)
    geometry = element.find("geometry")
    found = [] if geometry is None else [child for child in geometry if isinstance(child.tag, str)]
    if len(found) != 1:
        raise MorphologyError(f"{where}: its <geometry> needs exactly one shape, it has {len(found)}")
    shape, kind = found[0], found[0].tag
    mesh = None
    if kind == "box":
        size = read_vector(shape, "size", (0, 0, 0), f"{where} box")
    elif kind in ("cylinder", "capsule"):
        size = np.array([_positive(shape, key, f"{where} {kind}") for key in ("radius", "length")] + [0.0])
    elif kind == "sphere":
        size = np.array([_positive(shape, "radius", f"{where} sphere"), 0.0, 0.0])
    elif kind == "mesh":
        mesh = shape.get("filename")
        if not mesh:
            raise MorphologyError(f"{where}: its <mesh> has no filename")
        size = read_vector(shape, "scale", (1, 1, 1), f"{where} mesh")
    else:
        raise MorphologyError(f"{where}: <{kind}> is no known shape (box, cylinder, capsule, sphere, mesh)")
    if kind == "box" and not np.all(size > 0):
        raise MorphologyError(f"{where}: the box needs a positive size, got {size}")
    return Shape(link, collision, kind, position, rotation, size, mesh, element)


def _positive(element: Element, key: str, where: str) -> float:
    value = float(read_vector(element, key, (0,), where)[0])
    if value <= 0:
        raise MorphologyError(f"{where}: {key} must be positive, got {value:g}")
    return value


def read_origin(element: Element, where: str) -> tuple[Array, Array]:
    """Position (3,) and rotation (3, 3) of an element's <origin>; zero and identity without one."""
    origin = element.find("origin")
    return (
        read_vector(origin, "xyz", (0, 0, 0), where),
        rotation_of(read_vector(origin, "rpy", (0, 0, 0), where)),
    )


def rotation_of(rpy: Array) -> Array:
    """(3, 3) rotation of URDF's fixed-axis roll, pitch and yaw [rad]."""
    if not rpy.any():
        return np.eye(3)
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rpy_of(rotation: Array) -> Array:
    """(3,) fixed-axis roll, pitch and yaw [rad] of a rotation (3, 3)."""
    pitch = np.arctan2(-rotation[2, 0], np.hypot(rotation[0, 0], rotation[1, 0]))
    if abs(np.cos(pitch)) < 1e-9:  # gimbal lock: yaw is free, so take 0
        return np.array([np.arctan2(-rotation[1, 2], rotation[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(rotation[2, 1], rotation[2, 2]), pitch, np.arctan2(rotation[1, 0], rotation[0, 0])])
