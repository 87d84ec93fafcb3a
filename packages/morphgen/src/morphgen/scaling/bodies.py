"""n bodies of one robot, link by link, as arrays: the scaling rules at work."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from morphgen.errors import MorphologyError
from morphgen.scaling.design import Morphology
from morphgen.scaling.inertia import Masses, box_inertia, lumped, stretch_vectors, stretched
from morphgen.scaling.segments import Segment, Segments
from morphgen.scaling.shapes import stretch_shape
from morphgen.urdf.feet import ball_index
from morphgen.urdf.legs import LegMap
from morphgen.urdf.tree import Array, Tree

Rule = Literal["paper", "stretch", "lumped"]
"""How thigh and shank scale:

- `paper`: Table II: they are uniform boxes, whatever their inertia was. Needs one upright box of square section each
  as collision.
- `stretch`: mass and inertia stretch along the segment (second-moment congruence); any valid inertia stays valid.
- `lumped`: a rod from joint to joint scales, the motor at the proximal joint does not.

Joints, collisions and visuals stretch alike under every rule.
"""
RULES: tuple[str, ...] = get_args(Rule)
"""How mass and inertia follow the length of a link."""


@dataclass(frozen=True)
class Robot:
    """A robot ready to be scaled: primitives as collisions, a ball for every foot.

    Attributes:
        tree: its links, joints and shapes.
        leg_map: where its legs are.
        segments: what scales.
    """

    tree: Tree
    leg_map: LegMap
    segments: Segments


@dataclass(frozen=True)
class Bodies:
    """Numbers of n bodies in the order of the tree's joints, links and shapes; frames as in the URDF.

    Attributes:
        joint_position: (n, J, 3) of the child frame in the parent's [m].
        mass: (n, L) [kg], 0 for a link without inertial.
        com: (n, L, 3) [m].
        inertia: (n, L, 3, 3) about the centre of mass, link axes [kg m^2].
        shape_position: (n, G, 3) [m].
        shape_rotation: (n, G, 3, 3).
        shape_size: (n, G, 3) as `Shape.size`.
    """

    joint_position: Array
    mass: Array
    com: Array
    inertia: Array
    shape_position: Array
    shape_rotation: Array
    shape_size: Array

    @property
    def n(self) -> int:
        """Number of bodies."""
        return len(self.mass)


def nominal_bodies(tree: Tree, n: int = 1) -> Bodies:
    """N copies of the robot as it is."""
    links, shapes = tree.links, tree.shapes
    empty = (0.0, np.zeros(3), np.zeros((3, 3)))
    inertials = [empty if x.inertial is None else (x.inertial.mass, x.inertial.com, x.inertial.inertia) for x in links]

    def repeated(rows: list[Array] | list[float], *shape: int) -> Array:
        return np.repeat(np.array(rows, dtype=np.float64).reshape(1, -1, *shape), n, axis=0)

    return Bodies(
        joint_position=repeated([joint.position for joint in tree.joints], 3),
        mass=repeated([row[0] for row in inertials]),
        com=repeated([row[1] for row in inertials], 3),
        inertia=repeated([row[2] for row in inertials], 3, 3),
        shape_position=repeated([shape.position for shape in shapes], 3),
        shape_rotation=repeated([shape.rotation for shape in shapes], 3, 3),
        shape_size=repeated([shape.size for shape in shapes], 3),
    )


def scale_bodies(robot: Robot, morphology: Morphology, rule: Rule, *, visuals: bool = False) -> Bodies:
    """Scale a robot into n bodies.

    Args:
        robot: the nominal robot.
        morphology: n designs.
        rule: see `Rule`.
        visuals: whether to scale the visual shapes too, which no simulation needs.

    Raises:
        MorphologyError: the robot does not fit the rule; names the link.
    """
    if rule not in RULES:
        raise MorphologyError(f"unknown scaling rule '{rule}'; known: {', '.join(RULES)}")
    bodies = nominal_bodies(robot.tree, morphology.n)
    _scale(robot.tree, bodies, robot.segments.trunk, morphology.trunk_length, morphology.trunk_mass, visuals)
    for i, (leg, segments) in enumerate(zip(robot.leg_map.legs, robot.segments.legs, strict=True)):
        for k, segment in enumerate(segments):
            length, factor = morphology.length[:, i, k], morphology.mass[:, i, k]
            if k == 0:
                _scale(robot.tree, bodies, segment, length, factor, visuals)
                continue
            if rule == "lumped":
                shift = morphology.motor if k == 1 else np.zeros(morphology.n)
                special = _lump(robot.tree, bodies, segment, length, factor, shift)
            elif rule == "paper":
                special = _box(robot.tree, bodies, segment, length, factor)
            else:
                special = None
            _scale(robot.tree, bodies, segment, length, length * factor, visuals)
            if special is not None:
                _put(bodies, segment.main, special)
        _scale_foot(robot.tree, bodies, leg.foot, morphology.foot, visuals)
    return bodies


def _scale(tree: Tree, bodies: Bodies, segment: Segment, length: Array, factor: Array, visuals: bool) -> None:
    """Stretch a segment in place."""
    for link, is_stretched in zip(segment.part.links, segment.stretched, strict=True):
        if not is_stretched:
            continue
        axis = segment.axis_in(link)
        _put(bodies, link, stretched(_get(bodies, link), axis, length, factor))
        for j in tree.below(link):
            bodies.joint_position[:, j] = stretch_vectors(bodies.joint_position[:, j], axis, length)
        for g, shape in enumerate(tree.shapes):
            if shape.link == link and (shape.collision or visuals):
                stretch_shape(
                    shape.kind, bodies.shape_position, bodies.shape_rotation, bodies.shape_size, g, axis, length
                )


def _box(tree: Tree, bodies: Bodies, segment: Segment, length: Array, factor: Array) -> Masses:
    """Mass, centre and inertia of a thigh or shank by Table II."""
    link = segment.main
    name = tree.links[link].name
    shapes = [g for g, shape in enumerate(tree.shapes) if shape.link == link and shape.collision]
    hint = "use rule 'stretch'"
    if len(shapes) != 1 or tree.shapes[shapes[0]].kind != "box":
        raise MorphologyError(f"link '{name}': Table II scaling needs exactly one collision, a box along z; {hint}")
    shape = tree.shapes[shapes[0]]
    size = shape.size
    if not np.array_equal(shape.rotation, np.eye(3)) or size[0] != size[1]:
        raise MorphologyError(
            f"link '{name}': Table II needs an upright collision box of square section (b, b, L), "
            f"got size {size}; {hint}"
        )
    if not np.array_equal(segment.axis_in(link), (0, 0, -1)) or shape.position[:2].any():
        raise MorphologyError(f"link '{name}': Table II needs its box and the next joint straight below it; {hint}")
    if not bodies.mass[:, link].all():
        raise MorphologyError(f"link '{name}': has no mass; give it an <inertial>")
    mass = bodies.mass[:, link] * length * factor
    scaled = size[2] * length
    com = np.zeros((bodies.n, 3))
    com[:, 2] = -scaled / 2
    inertia = np.zeros((bodies.n, 3, 3))
    inertia[:, range(3), range(3)] = box_inertia(mass, scaled, np.full(bodies.n, size[0]))
    return Masses(mass, com, inertia)


def _lump(tree: Tree, bodies: Bodies, segment: Segment, length: Array, factor: Array, shift: Array) -> Masses:
    link = segment.main
    i = segment.part.links.index(link)
    joint = -segment.part.rotation[i].T @ segment.part.position[i]
    return lumped(_get(bodies, link), joint, segment.axis_in(link), segment.length, length, factor, shift)


def _scale_foot(tree: Tree, bodies: Bodies, foot: int, scale: Array, visuals: bool) -> None:
    """A solid ball: mass by the cube and inertia by the fifth power of its radius; a foot with a shank keeps both."""
    ball = ball_index(tree, foot)
    inertial, shape = tree.links[foot].inertial, tree.shapes[ball]
    alone = inertial is None or float(np.linalg.norm(inertial.com - shape.position)) <= float(shape.size[0])
    if alone:
        bodies.mass[:, foot] *= scale**3
        bodies.inertia[:, foot] *= (scale**5)[:, None, None]
    for g, other in enumerate(tree.shapes):
        if g == ball or (other.link == foot and visuals and alone and not other.collision):
            bodies.shape_size[:, g] *= scale[:, None]


def _get(bodies: Bodies, link: int) -> Masses:
    return Masses(bodies.mass[:, link], bodies.com[:, link], bodies.inertia[:, link])


def _put(bodies: Bodies, link: int, masses: Masses) -> None:
    bodies.mass[:, link], bodies.com[:, link], bodies.inertia[:, link] = masses.mass, masses.com, masses.inertia
