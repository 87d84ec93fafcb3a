"""Finding the four legs of a quadruped by the topology of its URDF."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree.ElementTree import Element

from morphgen.errors import MorphologyError
from morphgen.urdf.xml import named, read_vector

ACTUATED = ("revolute", "continuous")


@dataclass(frozen=True)
class Leg:
    """Names of one leg's parts.

    Attributes:
        front: whether the hip joint lies at positive x.
        left: whether the hip joint lies at positive y.
        joints: hip, thigh and knee joints.
        ankle: the fixed joint that carries the foot.
        links: hip, thigh, shank and foot links.
    """

    front: bool
    left: bool
    joints: tuple[str, str, str]
    ankle: str
    links: tuple[str, str, str, str]


@dataclass(frozen=True)
class LegMap:
    """The base link and the legs in the order front-left, front-right, rear-left, rear-right."""

    base: str
    legs: tuple[Leg, Leg, Leg, Leg]


def find_legs(root: Element) -> LegMap:
    """Find base and legs: four chains of three actuated joints on the root link, each ending in a ball foot.

    Front and hind are told by the sign of x of the hip joint, left and right by the sign of y.

    Raises:
        MorphologyError: no such four chains; names the joints or links found instead.
    """
    links, joints = named(root, "link"), named(root, "joint")
    children: dict[str, list[str]] = {name: [] for name in links}
    child_of: dict[str, str] = {}
    for name, joint in joints.items():
        parent, child = (_link_of(joint, role, links) for role in ("parent", "child"))
        if child in child_of.values():
            raise MorphologyError(f"link '{child}' is the child of two joints")
        if joint.get("type") not in (*ACTUATED, "fixed"):
            raise MorphologyError(
                f"joint '{name}': type '{joint.get('type')}' is not supported (revolute, continuous or fixed)"
            )
        children[parent].append(name)
        child_of[name] = child
    roots = [name for name in links if name not in child_of.values()]
    if len(roots) != 1:
        raise MorphologyError(f"expected one root link, found {', '.join(roots) or 'none'}")

    def actuated(link: str) -> list[str]:
        return [name for name in children[link] if joints[name].get("type") in ACTUATED]

    chains = []
    for hip in actuated(roots[0]):
        chain = [hip]
        while len(following := actuated(child_of[chain[-1]])) == 1:
            chain += following
        if len(chain) != 3 or following:
            raise MorphologyError(f"a leg has 3 actuated joints in a row; the chain at '{hip}' is {', '.join(chain)}")
        chains.append(chain)
    if len(chains) != 4:
        raise MorphologyError(f"expected 4 legs on link '{roots[0]}', found {len(chains)}")

    legs: dict[tuple[bool, bool], Leg] = {}
    for hip, thigh, knee in chains:
        position = read_vector(joints[hip].find("origin"), "xyz", (0, 0, 0), f"joint '{hip}'")
        side = (bool(position[0] > 0), bool(position[1] > 0))
        if side in legs:
            raise MorphologyError(
                f"hip joints '{hip}' and '{legs[side].joints[0]}' lie in the same quarter of the base; "
                "the base frame needs x forward and y left"
            )
        shank = child_of[knee]
        ankles = [name for name in children[shank] if _is_ball(links[child_of[name]])]
        if len(ankles) != 1:
            raise MorphologyError(f"link '{shank}' needs one fixed child with a sphere as collision, its foot")
        legs[side] = Leg(
            *side, (hip, thigh, knee), ankles[0], (child_of[hip], child_of[thigh], shank, child_of[ankles[0]])
        )
    order = ((True, True), (True, False), (False, True), (False, False))
    front_left, front_right, rear_left, rear_right = (legs[side] for side in order)
    return LegMap(roots[0], (front_left, front_right, rear_left, rear_right))


def _link_of(joint: Element, role: str, links: dict[str, Element]) -> str:
    element = joint.find(role)
    name = "" if element is None else element.get("link", "")
    if name not in links:
        raise MorphologyError(f"joint '{joint.get('name')}': its {role} link '{name}' does not exist")
    return name


def _is_ball(link: Element) -> bool:
    return link.find("collision/geometry/sphere") is not None
