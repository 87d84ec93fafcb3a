"""Finding trunk, legs and feet of a quadruped by the topology of its tree."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from morphgen.errors import MorphologyError
from morphgen.urdf.tree import ACTUATED, Array, Tree

QUARTERS = ("FL", "FR", "RL", "RR")
"""Front left, front right, rear left, rear right: the order of legs everywhere."""


@dataclass(frozen=True)
class Part:
    """Links joined by fixed joints, so one rigid body; its frame is that of its root link.

    Attributes:
        links: their indices, the root first, parents before children.
        position: (k, 3) of each link's frame in the root's [m].
        rotation: (k, 3, 3) of each link's frame in the root's.
    """

    links: tuple[int, ...]
    position: Array
    rotation: Array

    @property
    def root(self) -> int:
        """Index of the root link."""
        return self.links[0]


@dataclass(frozen=True)
class Leg:
    """One leg.

    Attributes:
        front: whether it is one of the front legs.
        left: whether it is one of the left legs.
        joints: indices of hip, thigh and knee joint.
        parts: hip, thigh and shank; the shank includes the foot.
        foot: index of the foot link, a leaf of the shank with a ball as collision.
    """

    front: bool
    left: bool
    joints: tuple[int, int, int]
    parts: tuple[Part, Part, Part]
    foot: int


@dataclass(frozen=True)
class LegMap:
    """The trunk, whose root is the base link, and the legs in the order of `QUARTERS`."""

    trunk: Part
    legs: tuple[Leg, Leg, Leg, Leg]

    @property
    def base(self) -> int:
        """Index of the base link."""
        return self.trunk.root


def lock_joints(tree: Tree, names: Collection[str]) -> Tree:
    """A copy in which these joints are fixed at zero: the arm or the payload of a quadruped.

    Raises:
        MorphologyError: unknown joint.
    """
    locked = {tree.joint(name) for name in names}
    return replace(
        tree, joints=tuple(replace(j, kind="fixed") if i in locked else j for i, j in enumerate(tree.joints))
    )


def find_legs(tree: Tree, hips: Mapping[str, str] | None = None) -> LegMap:
    """Find trunk, legs and feet: four chains of three actuated joints on the trunk.

    Front and hind, left and right are told by the place of the thigh joints, not by names. The foot is the
    leaf of the shank with a spherical collision that is farthest from the knee, else the farthest leaf.

    Args:
        tree: of the robot.
        hips: hip joint of each of `QUARTERS`, for a robot whose legs are not found by their place.

    Raises:
        MorphologyError: no such legs; names what was found instead and the remedy.
    """
    trunk = _part(tree, _base(tree))
    chains = [_chain(tree, joint) for joint in _next_joints(tree, trunk)]
    if hips is not None:
        if set(hips) != set(QUARTERS):
            raise MorphologyError(f"hip joints are needed for {', '.join(QUARTERS)}, got {', '.join(hips)}")
        by_hip = {tree.joints[chain[0][0]].name: chain for chain in chains}
        for name in hips.values():
            if name not in by_hip:
                raise MorphologyError(f"'{name}' is no hip joint; joints on the trunk: {', '.join(by_hip) or 'none'}")
        chains = [by_hip[hips[quarter]] for quarter in QUARTERS]
    _require_four(tree, trunk, chains)
    order = range(4) if hips is not None else _quarters(tree, trunk, chains)
    legs = tuple(_leg(tree, k, *chains[i]) for k, i in enumerate(order))
    return LegMap(trunk, legs)  # pyright: ignore[reportArgumentType]


def _base(tree: Tree) -> int:
    floating = [joint for joint in tree.joints if joint.kind == "floating"]
    if not floating:
        return tree.root
    if len(floating) > 1 or floating[0].parent != tree.root or len(tree.below(tree.root)) > 1:
        raise MorphologyError(
            f"joint '{floating[-1].name}': a floating joint may only carry the base on an empty root link"
        )
    return floating[0].child


def _part(tree: Tree, root: int) -> Part:
    links, position, rotation = [root], [np.zeros(3)], [np.eye(3)]
    for i, link in enumerate(links):  # grows while it runs
        for j in tree.below(link):
            joint = tree.joints[j]
            if joint.kind == "fixed":
                links.append(joint.child)
                position.append(position[i] + rotation[i] @ joint.position)
                rotation.append(rotation[i] @ joint.rotation)
    return Part(tuple(links), np.array(position), np.array(rotation))


def _next_joints(tree: Tree, part: Part) -> list[int]:
    return [j for j, joint in enumerate(tree.joints) if joint.parent in part.links and joint.kind != "fixed"]


def _chain(tree: Tree, first: int) -> tuple[list[int], list[Part]]:
    """Moving joints and parts from a joint outwards, up to a leaf or a fork."""
    joints, parts = [first], [_part(tree, tree.joints[first].child)]
    while len(following := _next_joints(tree, parts[-1])) == 1:
        joints += following
        parts.append(_part(tree, tree.joints[following[0]].child))
    if following:
        names = ", ".join(f"'{tree.joints[j].name}'" for j in following)
        raise MorphologyError(
            f"link '{tree.links[parts[-1].root].name}' forks into the joints {names}; a leg has one joint after "
            "the other: lock the surplus ones (--lock)"
        )
    return joints, parts


def _require_four(tree: Tree, trunk: Part, chains: list[tuple[list[int], list[Part]]]) -> None:
    def names(joints: list[int]) -> str:
        return " - ".join(tree.joints[j].name for j in joints)

    for joints, _ in chains:
        for j in joints:
            if tree.joints[j].kind not in ACTUATED:
                raise MorphologyError(
                    f"joint '{tree.joints[j].name}': a {tree.joints[j].kind} joint has no place in a leg; "
                    "lock it (--lock)"
                )
    base = tree.links[trunk.root].name
    wrong = [joints for joints, _ in chains if len(joints) != 3]
    if wrong:
        advice = (
            "lock wheels or surplus joints (--lock)"
            if len(wrong[0]) > 3
            else "lock it if it is no leg (--lock); legs of fewer joints are not supported"
        )
        raise MorphologyError(
            f"a leg has 3 actuated joints in a row (hip, thigh, knee); the chain on '{base}' is {names(wrong[0])}: "
            + advice
        )
    if len(chains) != 4:
        found = "; ".join(names(joints) for joints, _ in chains) or "none"
        raise MorphologyError(
            f"expected 4 legs on link '{base}', found {len(chains)}: {found}"
            + ("; lock the joints of an arm (--lock)" if len(chains) > 4 else "")
        )


def _quarters(tree: Tree, trunk: Part, chains: list[tuple[list[int], list[Part]]]) -> list[int]:
    """Which chain is in each of `QUARTERS`, by the place of its thigh joint."""
    places = []
    for joints, parts in chains:
        hip, thigh = tree.joints[joints[0]], tree.joints[joints[1]]
        i, k = trunk.links.index(hip.parent), parts[0].links.index(thigh.parent)
        inside = parts[0].position[k] + parts[0].rotation[k] @ thigh.position
        at_hip = hip.position + hip.rotation @ inside
        places.append(trunk.position[i] + trunk.rotation[i] @ at_hip)
    offset = np.array(places) - np.mean(places, axis=0)
    sides = [(bool(x > 0), bool(y > 0)) for x, y, _ in offset]
    wanted = [(True, True), (True, False), (False, True), (False, False)]
    if sorted(sides) != sorted(wanted):
        rows = ", ".join(
            f"'{tree.joints[joints[0]].name}' at ({place[0]:.3f}, {place[1]:.3f})"
            for (joints, _), place in zip(chains, places, strict=True)
        )
        raise MorphologyError(
            f"the legs do not lie in the four quarters of the base frame, x forward and y left: {rows}; turn the "
            "base frame or name the hip joint of each quarter"
        )
    return [sides.index(side) for side in wanted]


def _leg(tree: Tree, quarter: int, joints: list[int], parts: list[Part]) -> Leg:
    name = QUARTERS[quarter]
    hip, thigh, knee = joints
    return Leg(
        name[0] == "F", name[1] == "L", (hip, thigh, knee), (parts[0], parts[1], parts[2]), _foot(tree, parts[2])
    )


def _foot(tree: Tree, shank: Part) -> int:
    """The foot link; the root of the shank where there is none."""
    parents = {tree.joints[j].parent for j in range(len(tree.joints))}
    leaves = [(i, link) for i, link in enumerate(shank.links) if i and link not in parents]
    far = {link: float(np.linalg.norm(shank.position[i])) for i, link in leaves}
    balls = [link for link in far if has_ball(tree, link)]
    touching = [link for link in far if any(s.link == link and s.collision for s in tree.shapes)]
    reach = max(far.values(), default=0.0)
    for candidates in (balls, touching, list(far)):
        # covers and sensors near the knee are no feet
        distal = [link for link in candidates if far[link] > 0.6 * reach]
        if distal:
            return max(distal, key=lambda link: far[link])
    return shank.root


def has_ball(tree: Tree, link: int) -> bool:
    """Whether a link has a sphere as collision."""
    return any(s.link == link and s.collision and s.kind == "sphere" for s in tree.shapes)
