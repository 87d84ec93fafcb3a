"""Inertias that no rigid body can have: finding them, and the nearest one that a body can."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np

from morphgen.errors import MorphologyError
from morphgen.urdf.tree import INERTIA_KEYS, Array, Inertial, Tree, parse_tree
from morphgen.urdf.xml import Element, format_vector

_FLAT = 1e-9
"""Least thickness: smallest over largest second moment; below it rounding decides whether a simulator accepts."""
_FLOOR = 1e-6
"""Thickness that a repaired link gets."""
_NONE = 1e-12
"""Moment [kg m^2] up to which an inertia is none; simulators refuse eigenvalues not much smaller."""
_PLACEHOLDER = 1e-5
"""Mass [kg] up to which a link is a mere frame, whose inertia means nothing."""
_BALL = 0.02
"""Radius [m] of the ball that stands for a link without inertia and without a primitive collision."""


@dataclass(frozen=True)
class Defect:
    """An inertial that cannot be used.

    Attributes:
        link: index of the link.
        problem: what is wrong.
        repairable: whether `repair_tree` can help; a missing or negative mass cannot be guessed.
        placeholder: whether the link has next to no mass or inertia, so that repairing it changes nothing.
    """

    link: int
    problem: str
    repairable: bool
    placeholder: bool = False


def check_inertia(inertial: Inertial) -> str | None:
    """What is wrong with an inertial; None if a rigid body can have it.

    A body is possible if the second moments Sig = tr(I)/2 1 - I are positive: then I is positive definite and its
    principal moments satisfy A + B > C. No inertia at all is a point mass, which is possible.
    """
    if inertial.mass < 0:
        return f"its mass of {inertial.mass:g} kg is negative"
    if not inertial.inertia.any():
        return None
    if _is_point(inertial):
        return f"its inertia of at most {np.abs(inertial.inertia).max():.3g} kg m^2 is next to none"
    a, b, c = np.linalg.eigvalsh(inertial.inertia)
    if a <= 0:
        return f"its inertia is not positive definite (principal moments {a:.3g}, {b:.3g}, {c:.3g})"
    if (a + b - c) / 2 < _FLAT * (b + c - a) / 2:
        return f"its principal moments {a:.3g}, {b:.3g}, {c:.3g} break A + B > C"
    return None


def repair_inertia(inertial: Inertial) -> Inertial:
    """The inertial with second moments projected to positive ones; mass and centre of mass stay.

    The negative eigenvalues of Sig = tr(I)/2 1 - I become 1e-6 of the largest, the others stay.
    """
    inertia = inertial.inertia
    values, axes = np.linalg.eigh(np.trace(inertia) / 2 * np.eye(3) - inertia)
    values = np.maximum(values, _FLOOR * np.abs(values).max())
    sigma = (axes * values) @ axes.T
    repaired = values.sum() * np.eye(3) - (sigma + sigma.T) / 2
    return Inertial(inertial.mass, inertial.com, repaired)


def find_defects(tree: Tree) -> list[Defect]:
    """Every link whose inertial is not possible, and every moving part without a mass or an inertia."""
    found: list[Defect] = []
    for i, link in enumerate(tree.links):
        problem = None if link.inertial is None else check_inertia(link.inertial)
        if link.inertial is not None and problem is not None:
            small = link.inertial.mass <= _PLACEHOLDER or _is_point(link.inertial)
            found.append(Defect(i, problem, link.inertial.mass >= 0, small and link.inertial.mass >= 0))
    for part in _moving_parts(tree):
        inertials = [(link, inertial) for link in part if (inertial := tree.links[link].inertial) is not None]
        heavy = [(link, inertial) for link, inertial in inertials if inertial.mass > 0]
        if not heavy:
            found.append(Defect(part[0], "the moving part has no mass", False))
        elif all(_is_point(inertial) for _, inertial in heavy):
            heaviest = max(heavy, key=lambda pair: pair[1].mass)[0]
            found.append(Defect(heaviest, "its inertia is zero, and nothing fixed to it has one", True))
    return found


def repair_tree(tree: Tree) -> tuple[Tree, list[str]]:
    """A copy with possible inertias, and a sentence for each change.

    Impossible inertias are replaced by the nearest possible ones (`repair_inertia`), placeholders
    become balls, and a moving part of point masses gets that of a solid ball as large as its collision.

    Raises:
        MorphologyError: a negative mass, or a moving part without any; names every such link.
    """
    return _repaired(tree, find_defects(tree))


def with_valid_inertia(tree: Tree, allow_repair: bool = False) -> tuple[Tree, list[str]]:
    """As `repair_tree` if that is allowed; else only placeholders (up to 1e-5 kg or 1e-12 kg m^2) are.

    Raises:
        MorphologyError: a defect that may not or cannot be repaired; names every such link and the remedy.
    """
    defects = find_defects(tree)
    forbidden = [defect for defect in defects if not (allow_repair or defect.placeholder) and defect.repairable]
    if forbidden:
        raise MorphologyError(
            f"{_listed(tree, forbidden)}; correct the file, or let the nearest possible inertia be taken "
            "(--repair, repair=True)"
        )
    return _repaired(tree, defects)


def _repaired(tree: Tree, defects: list[Defect]) -> tuple[Tree, list[str]]:
    hopeless = [defect for defect in defects if not defect.repairable]
    if hopeless:
        raise MorphologyError(f"{_listed(tree, hopeless)}; give it a mass in an <inertial>")
    if not defects:
        return tree, []
    edited = parse_tree(copy.deepcopy(tree.element))
    notes = []
    for defect in defects:
        inertial = edited.links[defect.link].inertial
        assert inertial is not None
        if defect.placeholder and _is_point(inertial):
            new, done = np.zeros((3, 3)), "taken as a point"
        elif defect.placeholder:
            new = max(np.diag(inertial.inertia).max(), 0.0) * np.eye(3)
            done = f"a placeholder of {inertial.mass:g} kg, taken as a ball"
        elif _is_point(inertial):
            radius = _ball_radius(edited, defect.link)
            new = 0.4 * inertial.mass * radius**2 * np.eye(3)
            done = f"it gets that of a ball of {radius * 1000:.0f} mm radius"
        else:
            new = repair_inertia(inertial).inertia
            a, b, c = np.linalg.eigvalsh(new)
            done = f"the nearest possible ones are {a:.3g}, {b:.3g}, {c:.3g}"
        _write(edited.links[defect.link].element, new)
        notes.append(f"link '{edited.links[defect.link].name}': {defect.problem}; {done}")
    return parse_tree(edited.element), notes


def _is_point(inertial: Inertial) -> bool:
    return bool(np.abs(inertial.inertia).max() <= _NONE)


def _listed(tree: Tree, defects: list[Defect]) -> str:
    return "; ".join(f"link '{tree.links[defect.link].name}': {defect.problem}" for defect in defects)


def _moving_parts(tree: Tree) -> list[list[int]]:
    """Links joined by fixed joints, root first; without an empty root that carries a floating base."""
    part_of = {tree.root: tree.root}
    for joint in tree.joints:  # parents come before children
        part_of[joint.child] = part_of[joint.parent] if joint.kind == "fixed" else joint.child
    parts: dict[int, list[int]] = {}
    for link, root in part_of.items():
        parts.setdefault(root, []).append(link)
    if any(joint.kind == "floating" and part_of[joint.parent] == tree.root for joint in tree.joints):
        del parts[tree.root]
    return list(parts.values())


def _ball_radius(tree: Tree, link: int) -> float:
    """Of the ball with the volume of the link's largest primitive collision."""
    volumes = []
    for shape in tree.shapes:
        if shape.link == link and shape.collision:
            a, b, c = shape.size
            volumes += {
                "box": [a * b * c],
                "cylinder": [np.pi * a**2 * b],
                "capsule": [np.pi * a**2 * b + 4 / 3 * np.pi * a**3],
                "sphere": [4 / 3 * np.pi * a**3],
            }.get(shape.kind, [])
    return float((max(volumes) * 3 / (4 * np.pi)) ** (1 / 3)) if volumes else _BALL


def _write(link: Element, inertia: Array) -> None:
    """Set the inertia, in link axes."""
    inertial = link.find("inertial")
    assert inertial is not None
    origin, element = inertial.find("origin"), inertial.find("inertia")
    if origin is not None and origin.get("rpy") is not None:
        origin.set("rpy", "0 0 0")
    if element is None:
        element = inertial.makeelement("inertia", {})
        inertial.append(element)
    values = (inertia[0, 0], inertia[0, 1], inertia[0, 2], inertia[1, 1], inertia[1, 2], inertia[2, 2])
    for key, value in zip(INERTIA_KEYS, values, strict=True):
        element.set(key, format_vector([value]))
