"""Finding trunk, legs and feet of a quadruped by the topology of its tree."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from morphgen.errors import MorphologyError
from morphgen.urdf.tree import ACTUATED, Array, Tree

QUARTERS = ("FL", "FR", "RL", "RR")
"""Front left, front right, rear left, rear right: the order of legs everywhere."""
_ABOUT = 0.9
"""Least cosine between a hip's axis and x; how exact it must be is the stance's to say."""


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
class _Chain:
    """Moving joints, and the part beyond each, from a joint on the trunk outwards to a leaf or a fork.

    Attributes:
        joints: their indices.
        parts: as many.
        fork: indices of the joints after the last part; none, or several.
    """

    joints: tuple[int, ...]
    parts: tuple[Part, ...]
    fork: tuple[int, ...]


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
        MorphologyError: no such legs, or `hips` names joints that are none; names what was found instead and the
            remedy.
    """
    trunk = _part(tree, _base(tree))
    chains = [_chain(tree, joint) for joint in _next_joints(tree, trunk)]
    legs = _by_place(tree, trunk, chains) if hips is None else _by_name(tree, trunk, chains, hips)
    return LegMap(trunk, tuple(_leg(tree, k, chain) for k, chain in enumerate(legs)))  # pyright: ignore[reportArgumentType]


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


def _chain(tree: Tree, first: int) -> _Chain:
    joints, parts = [first], [_part(tree, tree.joints[first].child)]
    while len(following := _next_joints(tree, parts[-1])) == 1:
        joints += following
        parts.append(_part(tree, tree.joints[following[0]].child))
    return _Chain(tuple(joints), tuple(parts), tuple(following))


def _names(tree: Tree, joints: Sequence[int]) -> str:
    return " - ".join(tree.joints[j].name for j in joints)


def _listed(names: Iterable[str]) -> str:
    return ", ".join(f"'{name}'" for name in names) or "none"


def _problem(tree: Tree, trunk: Part, chain: _Chain) -> str | None:
    """Why a chain is no leg; None if it can be one."""
    if chain.fork:
        return (
            f"link '{tree.links[chain.parts[-1].root].name}' forks into the joints "
            f"{_listed(tree.joints[j].name for j in chain.fork)}; a leg has one joint after the other: lock the "
            "surplus ones (--lock)"
        )
    for joint in (tree.joints[j] for j in chain.joints):
        if joint.kind not in ACTUATED:
            return f"joint '{joint.name}': a {joint.kind} joint has no place in a leg; lock it (--lock)"
    if len(chain.joints) == 3:
        return None
    advice = (
        "lock wheels or surplus joints (--lock)"
        if len(chain.joints) > 3
        else "lock it if it is no leg (--lock); legs of fewer joints are not supported"
    )
    return (
        f"a leg has 3 actuated joints in a row (hip, thigh, knee); the chain on '{tree.links[trunk.root].name}' is "
        f"{_names(tree, chain.joints)}: {advice}"
    )


def _by_name(tree: Tree, trunk: Part, chains: Sequence[_Chain], hips: Mapping[str, str]) -> list[_Chain]:
    """The chains whose first joints are named, in the order of `QUARTERS`."""
    if set(hips) != set(QUARTERS):
        raise MorphologyError(f"hip joints are needed for {', '.join(QUARTERS)}, got {', '.join(hips)}")
    starting = {tree.joints[chain.joints[0]].name: chain for chain in chains}
    problems = {name: _no_hip(tree, trunk, chain) for name, chain in starting.items()}
    can_be = f"hip joints can be {_listed(name for name, problem in problems.items() if problem is None)}"
    quarters: dict[str, str] = {}
    for quarter in QUARTERS:
        name = hips[quarter]
        problem = problems[name] if name in problems else _elsewhere(tree, name)
        if problem is not None:
            raise MorphologyError(f"'{name}', named for {quarter} (--hips), is no hip joint: {problem}; {can_be}")
        if name in quarters:
            raise MorphologyError(
                f"hip joint '{name}' is named for {quarters[name]} and for {quarter} (--hips); {can_be}"
            )
        quarters[name] = quarter
    for name, chain in starting.items():
        if name not in quarters:
            raise MorphologyError(
                _problem(tree, trunk, chain)
                or f"the joints {_names(tree, chain.joints)} belong to none of the legs that are named (--hips); "
                "lock them (--lock)"
            )
    return [starting[hips[quarter]] for quarter in QUARTERS]


def _no_hip(tree: Tree, trunk: Part, chain: _Chain) -> str | None:
    """Why the first joint of a chain is no hip; None if it can be one."""
    joint = tree.joints[chain.joints[0]]
    axis = trunk.rotation[trunk.links.index(joint.parent)] @ joint.rotation @ joint.axis
    if len(chain.joints) == 3 and joint.kind in ACTUATED and abs(axis[0]) < _ABOUT:
        return f"it turns about {np.round(axis, 4)} of the base, a hip joint about x (forward)"
    return _problem(tree, trunk, chain)


def _elsewhere(tree: Tree, name: str) -> str:
    """Why a joint that is no moving one on the trunk is no hip."""
    if name not in {joint.name for joint in tree.joints}:
        return "there is no such joint"
    return "it is fixed" if tree.joints[tree.joint(name)].kind == "fixed" else "it is not on the trunk"


def _by_place(tree: Tree, trunk: Part, chains: Sequence[_Chain]) -> list[_Chain]:
    """The four chains in the order of `QUARTERS`, by the places of their thigh joints."""
    for problem in (_problem(tree, trunk, chain) for chain in chains):
        if problem is not None:
            raise MorphologyError(problem)
    if len(chains) != 4:
        found = "; ".join(_names(tree, chain.joints) for chain in chains) or "none"
        raise MorphologyError(
            f"expected 4 legs on link '{tree.links[trunk.root].name}', found {len(chains)}: {found}"
            + ("; lock the joints of an arm (--lock)" if len(chains) > 4 else "")
        )
    places = [_thigh_place(tree, trunk, chain) for chain in chains]
    offset = np.array(places) - np.mean(places, axis=0)
    sides = [(bool(x > 0), bool(y > 0)) for x, y, _ in offset]
    wanted = [(True, True), (True, False), (False, True), (False, False)]
    if sorted(sides) != sorted(wanted):
        rows = ", ".join(
            f"'{tree.joints[chain.joints[0]].name}' at ({place[0]:.3f}, {place[1]:.3f})"
            for chain, place in zip(chains, places, strict=True)
        )
        raise MorphologyError(
            f"the legs do not lie in the four quarters of the base frame, x forward and y left: {rows}; turn the "
            f"base frame or name the hip joint of each quarter (--hips {' '.join(QUARTERS)}, "
            f"hips={{'{QUARTERS[0]}': ..., ...}})"
        )
    return [chains[sides.index(side)] for side in wanted]


def _thigh_place(tree: Tree, trunk: Part, chain: _Chain) -> Array:
    """(3,) place of the thigh joint in the base frame [m]."""
    hip, thigh = (tree.joints[j] for j in chain.joints[:2])
    i, k = trunk.links.index(hip.parent), chain.parts[0].links.index(thigh.parent)
    inside = chain.parts[0].position[k] + chain.parts[0].rotation[k] @ thigh.position
    return trunk.position[i] + trunk.rotation[i] @ (hip.position + hip.rotation @ inside)


def _leg(tree: Tree, quarter: int, chain: _Chain) -> Leg:
    name = QUARTERS[quarter]
    (hip, thigh, knee), parts = chain.joints, chain.parts
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
