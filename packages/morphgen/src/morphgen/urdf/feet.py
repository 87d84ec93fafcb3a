"""A ball foot on its own link for every leg, made from the shank's lowest collision where a file has none."""

from __future__ import annotations

import copy
from collections.abc import Collection

import numpy as np

from morphgen.errors import MorphologyError
from morphgen.urdf.legs import Leg, LegMap, Part, has_ball
from morphgen.urdf.tree import Array, Shape, Tree, parse_tree
from morphgen.urdf.xml import Element, format_vector

_NEAR = 0.15
"""A sphere this close to the foot frame, over the length of the shank, is the foot."""


def ball_index(tree: Tree, foot: int) -> int:
    """Index of the sphere that is the ball of a foot link, after `with_feet`."""
    return next(g for g, s in enumerate(tree.shapes) if s.link == foot and s.collision and s.kind == "sphere")


def with_feet(tree: Tree, leg_map: LegMap) -> tuple[Tree, list[str]]:
    """A copy in which every leg ends in a link with a spherical collision, and what was done for it.

    A sphere at the end of the shank becomes the foot; so does the end of the farthest cylinder, capsule or
    box, as a ball that fits into it.

    Raises:
        MorphologyError: a shank without any collision to stand on.
    """
    footless = [leg for leg in leg_map.legs if leg.foot == leg.parts[2].root or not has_ball(tree, leg.foot)]
    if not footless:
        return tree, []
    root = copy.deepcopy(tree.element)
    edited = parse_tree(root)
    notes = [_give_foot(edited, leg) for leg in footless]
    return parse_tree(root), notes


def clear_feet(tree: Tree, leg_map: LegMap, shapes: Collection[int]) -> Tree:
    """A copy in which these collisions of the shanks end above the balls of the feet, which so touch first.

    Args:
        tree: the robot.
        leg_map: its legs.
        shapes: indices of collisions that enclose a mesh, and with it perhaps the foot.
    """
    edited = parse_tree(copy.deepcopy(tree.element))
    for leg in leg_map.legs:
        shank = leg.parts[2]
        if leg.foot == shank.root or not has_ball(tree, leg.foot):
            continue
        ball = edited.shapes[ball_index(edited, leg.foot)]
        at = shank.links.index(leg.foot)
        centre = shank.position[at] + shank.rotation[at] @ ball.position
        for g in shapes:
            if edited.shapes[g].link in shank.links and edited.shapes[g].link != leg.foot:
                _clear(edited.shapes[g], shank, centre, float(ball.size[0]))
    return parse_tree(edited.element)


def _clear(shape: Shape, shank: Part, ball: Array, radius: float) -> None:
    """Shorten a shape in place so that its rim stays above the ball (centre in the shank frame) when the leg leans."""
    i = shank.links.index(shape.link)
    axes = shank.rotation[i] @ shape.rotation
    along = axes.T @ (ball / np.linalg.norm(ball))
    k = int(np.argmax(np.abs(along)))
    if shape.kind == "sphere" or (shape.kind != "box" and k != 2):  # lies across the leg
        return
    entry = k if shape.kind == "box" else 1
    length = float(shape.size[entry])
    outwards = float(np.sign(along[k])) * shape.rotation[:, k]
    way = shank.rotation[i].T @ (ball - shank.position[i]) - shape.position
    width = float(np.delete(shape.size, k).max()) if shape.kind == "box" else 2 * float(shape.size[0])
    cap = width / 2 if shape.kind == "capsule" else 0.0
    # a stub stays where the ball is as thick as the shank is long
    cut = min(length / 2 + cap + max(radius, width) - float(way @ outwards), 0.9 * length)
    if cut <= 0:
        return
    origin, geometry = shape.element.find("origin"), shape.element.find(f"geometry/{shape.kind}")
    assert geometry is not None
    if origin is None:
        origin = shape.element.makeelement("origin", {})
        shape.element.append(origin)
    origin.set("xyz", format_vector(shape.position - cut / 2 * outwards))
    size = shape.size.copy()
    size[entry] -= cut
    if shape.kind == "box":
        geometry.set("size", format_vector(size))
    else:
        geometry.set("length", format_vector(size[1:2]))


def _give_foot(tree: Tree, leg: Leg) -> str:
    shank = leg.parts[2]
    name = tree.links[shank.root].name
    shapes = [s for s in tree.shapes if s.collision and s.link in shank.links and s.kind != "mesh"]
    if not shapes:
        raise MorphologyError(
            f"link '{name}': neither it nor its foot has a collision to stand on; give the foot a <sphere>"
        )
    own_link = leg.foot != shank.root
    target = shank.position[shank.links.index(leg.foot)] if own_link else None
    shape, centre, radius = _ball(shapes, shank, target)
    link = tree.links[leg.foot].element
    if not own_link:
        link = _add_link(tree, shank, f"{name}_foot", centre)
        local = np.zeros(3)
    else:
        i = shank.links.index(leg.foot)
        local = shank.rotation[i].T @ (centre - shank.position[i])
    if shape.kind == "sphere":  # the foot takes it over
        tree.links[shape.link].element.remove(shape.element)
    else:
        _clear(shape, shank, centre, radius)
    link.append(_sphere(link, local, radius))
    return (
        f"link '{link.get('name')}': a ball of {radius * 1000:.0f} mm radius is its foot, made from the "
        f"{shape.kind} on link '{tree.links[shape.link].name}'"
    )


def _ball(shapes: list[Shape], shank: Part, target: Array | None) -> tuple[Shape, Array, float]:
    """The shape that touches the ground, and centre (shank frame) and radius of a ball within its end."""
    best: tuple[float, Shape, Array, float] | None = None
    for shape in shapes:
        i = shank.links.index(shape.link)
        centre = shank.position[i] + shank.rotation[i] @ shape.position
        axes = shank.rotation[i] @ shape.rotation
        if shape.kind == "sphere":
            radius, ends = float(shape.size[0]), [centre]
        else:
            if shape.kind == "box":
                k = int(np.argmax(shape.size))
                radius, half = float(np.delete(shape.size, k).min() / 2), float(shape.size[k] / 2)
            else:
                k, radius, half = 2, float(shape.size[0]), float(shape.size[1] / 2)
            if shape.kind != "capsule":
                half = max(half - radius, 0.0)
            ends = [centre + sign * half * axes[:, k] for sign in (-1, 1)]
        for end in ends:
            # near the foot's frame if there is one, else far from the knee
            score = -float(np.linalg.norm(end - target)) if target is not None else float(np.linalg.norm(end) + radius)
            if best is None or score > best[0]:
                best = (score, shape, end, radius)
    assert best is not None
    score, shape, centre, radius = best
    if target is not None and -score > _NEAR * float(np.linalg.norm(target)) + radius:
        raise MorphologyError(
            "the foot link has no collision and no shape of the shank ends near it; give the foot a <sphere>"
        )
    return shape, centre, radius


def _add_link(tree: Tree, shank: Part, name: str, centre: Array) -> Element:
    root = tree.element
    link = root.makeelement("link", {"name": name})
    joint = root.makeelement("joint", {"name": f"{name}_joint", "type": "fixed"})
    for tag, attributes in (
        ("origin", {"xyz": format_vector(centre)}),
        ("parent", {"link": tree.links[shank.root].name}),
        ("child", {"link": name}),
    ):
        joint.append(root.makeelement(tag, attributes))
    root.append(link)
    root.append(joint)
    return link


def _sphere(link: Element, centre: Array, radius: float) -> Element:
    collision = link.makeelement("collision", {})
    collision.append(link.makeelement("origin", {"xyz": format_vector(centre)}))
    geometry = link.makeelement("geometry", {})
    geometry.append(link.makeelement("sphere", {"radius": format_vector([radius])}))
    collision.append(geometry)
    return collision
