"""From links to what moves: composite parts of n bodies, in frames parallel to the base."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morphgen.errors import MorphologyError
from morphgen.scaling.bodies import Bodies, Robot
from morphgen.scaling.inertia import Masses
from morphgen.skeleton import Skeleton
from morphgen.urdf.feet import ball_index
from morphgen.urdf.legs import Part
from morphgen.urdf.tree import Array, Tree

TRUNK, HIP, THIGH, SHANK, FOOT = range(-1, 4)


@dataclass(frozen=True)
class Collisions:
    """Collision primitives of n bodies, in the frames of `Skeleton`'s parts; of a foot the ball first.

    Attributes:
        leg: (G,) leg of each, -1 for the trunk.
        part: (G,) 0 to 3 for hip, thigh, shank and foot, -1 for the trunk.
        kind: G kinds as in `Shape`.
        position: (n, G, 3) [m].
        rotation: (n, G, 3, 3).
        size: (n, G, 3) as `Shape.size`.
    """

    leg: tuple[int, ...]
    part: tuple[int, ...]
    kind: tuple[str, ...]
    position: Array
    rotation: Array
    size: Array


@dataclass(frozen=True)
class _Placed:
    """Where the links of a part are: displacement (n, k, 3) from its frame and rotation (k, 3, 3) to the base's."""

    part: Part
    displacement: Array
    rotation: Array


def articulate(robot: Robot, bodies: Bodies) -> tuple[Skeleton, Collisions]:
    """Reduce n bodies to trunk and legs.

    Raises:
        MorphologyError: a moving part without mass or with an impossible inertia.
    """
    tree, leg_map = robot.tree, robot.leg_map
    n = bodies.n
    trunk = _place(tree, bodies, leg_map.trunk, np.eye(3))
    base = _composite(bodies, trunk, trunk.part.links)
    origin = np.zeros((n, 4, 4, 3))
    mass, com, inertia = np.zeros((n, 4, 4)), np.zeros((n, 4, 4, 3)), np.zeros((n, 4, 4, 3, 3))
    axes, limits, radius = np.zeros((4, 3, 3)), np.zeros((4, 3, 6)), np.zeros((n, 4))
    placed: dict[tuple[int, int], _Placed] = {(TRUNK, TRUNK): trunk}
    for i, leg in enumerate(leg_map.legs):
        above = trunk
        for k, (j, part) in enumerate(zip(leg.joints, leg.parts, strict=True)):
            joint = tree.joints[j]
            at = above.part.links.index(joint.parent)
            turn = above.rotation[at]
            origin[:, i, k] = above.displacement[:, at] + _turned(turn, bodies.joint_position[:, j])
            above = _place(tree, bodies, part, turn @ joint.rotation)
            axes[i, k] = above.rotation[0] @ joint.axis
            limits[i, k] = _limits(tree, j)
            placed[i, k] = above
        shank = above
        at = shank.part.links.index(leg.foot)
        ball = ball_index(tree, leg.foot)
        centre = _turned(shank.rotation[at], bodies.shape_position[:, ball])
        origin[:, i, FOOT] = shank.displacement[:, at] + centre
        radius[:, i] = bodies.shape_size[:, ball, 0]
        foot = _Placed(Part((leg.foot,), np.zeros((1, 3)), np.eye(3)[None]), -centre[:, None], shank.rotation[at][None])
        placed[i, FOOT] = foot
        for k, (place, links) in enumerate(
            (
                (placed[i, HIP], leg.parts[0].links),
                (placed[i, THIGH], leg.parts[1].links),
                (shank, tuple(link for link in leg.parts[2].links if link != leg.foot)),
                (foot, (leg.foot,)),
            )
        ):
            whole = _composite(bodies, place, links)
            mass[:, i, k], com[:, i, k], inertia[:, i, k] = whole.mass, whole.com, whole.inertia
    skeleton = Skeleton(
        joint_origin=origin,
        link_mass=mass,
        link_com=com,
        link_inertia=inertia,
        base_mass=base.mass,
        base_com=base.com,
        base_inertia=base.inertia,
        foot_radius=radius,
        axis=axes,
        lower=limits[..., 0],
        upper=limits[..., 1],
        effort=limits[..., 2],
        velocity=limits[..., 3],
        damping=limits[..., 4],
        friction=limits[..., 5],
    )
    return skeleton, _collisions(robot, bodies, placed)


def _place(tree: Tree, bodies: Bodies, part: Part, rotation: Array) -> _Placed:
    """Follow the fixed joints of a part whose frame is turned by `rotation` from the base's."""
    displacement = np.zeros((bodies.n, len(part.links), 3))
    rotations = np.array([rotation @ relative for relative in part.rotation])
    index = {link: k for k, link in enumerate(part.links)}
    for link in part.links[1:]:
        j = tree.above(link)
        assert j is not None
        parent = index[tree.joints[j].parent]
        step = _turned(rotations[parent], bodies.joint_position[:, j])
        displacement[:, index[link]] = displacement[:, parent] + step
    return _Placed(part, displacement, rotations)


def _composite(bodies: Bodies, placed: _Placed, links: tuple[int, ...]) -> Masses:
    """Mass, centre and inertia of some links of a part, about its frame, in base axes."""
    index = {link: k for k, link in enumerate(placed.part.links)}
    pieces = []
    for link in links:
        if not bodies.mass[:, link].any():
            continue
        turn = placed.rotation[index[link]]
        com = placed.displacement[:, index[link]] + _turned(turn, bodies.com[:, link])
        inertia = bodies.inertia[:, link]
        pieces.append((bodies.mass[:, link], com, inertia if _is_identity(turn) else turn @ inertia @ turn.T))
    if not pieces:
        return Masses(np.zeros(bodies.n), np.zeros((bodies.n, 3)), np.zeros((bodies.n, 3, 3)))
    if len(pieces) == 1:  # exactly the link's own numbers
        return Masses(*pieces[0])
    mass = np.sum([m for m, _, _ in pieces], axis=0)
    com = np.sum([m[:, None] * c for m, c, _ in pieces], axis=0) / mass[:, None]
    inertia = np.zeros((bodies.n, 3, 3))
    for m, c, own in pieces:
        arm = c - com
        square = (arm**2).sum(axis=-1)[:, None, None] * np.eye(3)
        inertia += own + m[:, None, None] * (square - arm[:, :, None] * arm[:, None])
    return Masses(mass, com, inertia)


def _limits(tree: Tree, j: int) -> tuple[float, ...]:
    """Lower, upper, effort, velocity (inf where not given or zero), damping, friction (nan where not given)."""
    joint = tree.joints[j]

    def positive(value: float | None) -> float:
        return value if value else np.inf

    if positive(joint.effort) < 0 or positive(joint.velocity) < 0:
        raise MorphologyError(f"joint '{joint.name}': its effort and velocity limits must not be negative")
    unknown = [np.nan if v is None else v for v in (joint.damping, joint.friction)]
    return (joint.lower, joint.upper, positive(joint.effort), positive(joint.velocity), *unknown)


def _collisions(robot: Robot, bodies: Bodies, placed: dict[tuple[int, int], _Placed]) -> Collisions:
    tree = robot.tree
    feet = {leg.foot for leg in robot.leg_map.legs}
    balls = {ball_index(tree, foot) for foot in feet}
    indices: list[int] = []
    rows: list[tuple[int, int, str, Array, Array, Array]] = []
    for (leg, k), place in placed.items():
        for at, link in enumerate(place.part.links):
            if k == SHANK and link in feet:
                continue
            turn = place.rotation[at]
            for g, shape in enumerate(tree.shapes):
                if shape.link != link or not shape.collision:
                    continue
                if shape.kind == "mesh":
                    raise MorphologyError(
                        f"link '{tree.links[link].name}' collision: the mesh '{shape.mesh}' was not replaced "
                        "by a primitive"
                    )
                position = place.displacement[:, at] + _turned(turn, bodies.shape_position[:, g])
                rotation = bodies.shape_rotation[:, g]
                indices.append(g)
                rows.append(
                    (
                        leg,
                        k,
                        shape.kind,
                        position,
                        rotation if _is_identity(turn) else turn @ rotation,
                        bodies.shape_size[:, g],
                    )
                )
    # the ball comes first, as the geom that is the foot
    order = sorted(range(len(rows)), key=lambda r: (*rows[r][:2], indices[r] not in balls))
    rows = [rows[r] for r in order]
    return Collisions(
        leg=tuple(row[0] for row in rows),
        part=tuple(row[1] for row in rows),
        kind=tuple(row[2] for row in rows),
        position=np.stack([row[3] for row in rows], axis=1),
        rotation=np.stack([row[4] for row in rows], axis=1),
        size=np.stack([row[5] for row in rows], axis=1),
    )


def _turned(rotation: Array, vectors: Array) -> Array:
    """R v for vectors (n, 3); without rounding where R is the identity."""
    return vectors if _is_identity(rotation) else vectors @ rotation.T


def _is_identity(rotation: Array) -> bool:
    return np.array_equal(rotation, np.eye(3))
