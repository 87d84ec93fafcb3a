"""Which links of a robot a design parameter stretches, and along which axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morphgen.errors import MorphologyError
from morphgen.urdf.feet import ball_index
from morphgen.urdf.legs import LegMap, Part
from morphgen.urdf.tree import Array, Tree

_STRAIGHT = 1e-9
_PLACEHOLDER = 0.01
"""A link with less than this share of its neighbour's mass only names a frame."""

Way = dict[int, list[tuple[Array, int | None]]]
"""Links between the frame of a part and its next joint, each with its steps, in its own axes, and the next link."""


@dataclass(frozen=True)
class Segment:
    """A part that scales along one axis.

    Links on the way from its frame to the next joint, and collision-only covers on them, are stretched. Links
    without extent along the axis (drives), with a mass of their own beside the way (rotors, sensors) and the ball
    of the foot are moved.

    Attributes:
        part: its links.
        axis: (3,) unit vector e in the part's frame, normal to the proximal hinge.
        length: distance from joint to joint along it [m].
        stretched: (k,) which of the part's links are stretched.
        main: index of the heaviest stretched link.
    """

    part: Part
    axis: Array
    length: float
    stretched: tuple[bool, ...]
    main: int

    def axis_in(self, link: int) -> Array:
        """(3,) the axis in the frame of one of the links (its index in the tree)."""
        return _snapped(self.part.rotation[self.part.links.index(link)].T @ self.axis)


@dataclass(frozen=True)
class Segments:
    """The scaling segments: hip, thigh and shank of the four legs, and the trunk along x."""

    legs: tuple[tuple[Segment, Segment, Segment], ...]
    trunk: Segment


def find_segments(tree: Tree, leg_map: LegMap) -> Segments:
    """The segments of a robot whose legs all end in a ball (see `with_feet`).

    Raises:
        MorphologyError: a thigh or shank without length.
    """
    legs = []
    for leg in leg_map.legs:
        hip, thigh, shank = leg.parts
        hinges = [tree.joints[j].axis for j in leg.joints]
        foot = shank.links.index(leg.foot)
        tips = [
            _joint_place(tree, hip, leg.joints[1]),
            _joint_place(tree, thigh, leg.joints[2]),
            shank.position[foot],
        ]
        ways = [_way(tree, hip, [leg.joints[1]]), _way(tree, thigh, [leg.joints[2]]), _way_to(tree, shank, leg.foot)]
        legs.append(
            tuple(
                _segment(tree, part, hinge, tip, way, None if k < 2 else leg.foot, must=k > 0)
                for k, (part, hinge, tip, way) in enumerate(zip((hip, thigh, shank), hinges, tips, ways, strict=True))
            )
        )
    hips = [leg.joints[0] for leg in leg_map.legs]
    places = np.array([_joint_place(tree, leg_map.trunk, hip) for hip in hips])
    way = _way(tree, leg_map.trunk, hips)
    length = float(places[:2, 0].mean() - places[2:, 0].mean())
    axis = np.array([1.0, 0.0, 0.0])
    trunk = _finish(tree, leg_map.trunk, axis, length, way, None)
    return Segments(tuple(legs), trunk)


def _joint_place(tree: Tree, part: Part, joint: int) -> Array:
    i = part.links.index(tree.joints[joint].parent)
    return part.position[i] + part.rotation[i] @ tree.joints[joint].position


def _way(tree: Tree, part: Part, joints: list[int]) -> Way:
    """The way from the part's root to these joints."""
    way: Way = {}
    for j in joints:
        joint = tree.joints[j]
        way.setdefault(joint.parent, []).append((joint.position, None))
        for link, steps in _way_to(tree, part, joint.parent).items():
            way.setdefault(link, []).extend(steps)
    return way


def _way_to(tree: Tree, part: Part, link: int) -> Way:
    way: Way = {}
    while link != part.root:
        above = tree.above(link)
        assert above is not None
        joint = tree.joints[above]
        way.setdefault(joint.parent, []).append((joint.position, link))
        link = joint.parent
    return way


def _segment(tree: Tree, part: Part, hinge: Array, tip: Array, way: Way, foot: int | None, must: bool) -> Segment:
    across = tip - hinge * (hinge @ tip)
    length = float(np.linalg.norm(across))
    if length < 1e-6:
        if must:
            raise MorphologyError(
                f"link '{tree.links[part.root].name}' has no length: the next joint lies on its own joint's axis"
            )
        return Segment(part, np.zeros(3), 0.0, (False,) * len(part.links), part.root)
    return _finish(tree, part, _snapped(across / length), length, way, foot)


def _finish(tree: Tree, part: Part, axis: Array, length: float, way: Way, foot: int | None) -> Segment:
    stretched: dict[int, bool] = {}
    for i, link in enumerate(part.links):
        local = part.rotation[i].T @ axis
        if link == foot:
            stretched[link] = _carries_structure(tree, link)
        elif link in way:
            stretched[link] = any(abs(step @ local) > _STRAIGHT for step, _ in way[link]) or any(
                following is not None and _mass(tree, link) < _PLACEHOLDER * _mass(tree, following)
                for _, following in way[link]
            )
        else:
            above = tree.above(link)
            assert above is not None
            stretched[link] = stretched[tree.joints[above].parent] and _belongs_to_parent(tree, link)
    if not any(stretched.values()):
        stretched[part.root] = True
    masses = {link: _mass(tree, link) for link, is_stretched in stretched.items() if is_stretched}
    main = max(masses, key=lambda link: masses[link])
    return Segment(part, axis, length, tuple(stretched[link] for link in part.links), main)


def _belongs_to_parent(tree: Tree, link: int) -> bool:
    """Whether a link beside the way is a cover without mass, or holds the inertia of its massless parent."""
    above = tree.above(link)
    assert above is not None
    joint = tree.joints[above]
    if tree.links[link].inertial is None:
        return any(s.link == link and s.collision for s in tree.shapes)
    return not joint.position.any() and _mass(tree, joint.parent) < _PLACEHOLDER * _mass(tree, link)


def _carries_structure(tree: Tree, foot: int) -> bool:
    """Whether the mass of a foot link lies along the shank and not in its ball."""
    inertial = tree.links[foot].inertial
    if inertial is None or inertial.mass <= 0:
        return False
    ball = tree.shapes[ball_index(tree, foot)]
    return float(np.linalg.norm(inertial.com - ball.position)) > 2 * float(ball.size[0])


def _mass(tree: Tree, link: int) -> float:
    inertial = tree.links[link].inertial
    return 0.0 if inertial is None else inertial.mass


def _snapped(axis: Array) -> Array:
    """The axis, made exact if it is a coordinate axis up to rounding."""
    k = int(np.argmax(np.abs(axis)))
    if 1 - abs(axis[k]) < 1e-12 and np.all(np.abs(np.delete(axis, k)) < 1e-9):
        out = np.zeros(3)
        out[k] = np.sign(axis[k])
        return out
    return axis / np.linalg.norm(axis)
