"""Reading a URDF as far as it goes, and saying what was found."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from morphgen.errors import MorphologyError
from morphgen.factory import BodyFactory
from morphgen.inspection.findings import (
    Asymmetry,
    Inspection,
    JointFinding,
    LegFinding,
    LinkFinding,
    MeshFinding,
)
from morphgen.scaling.articulate import Collisions
from morphgen.scaling.bodies import Robot
from morphgen.skeleton import Array, Skeleton
from morphgen.stance.reach import leg_reach
from morphgen.urdf.legs import QUARTERS
from morphgen.urdf.meshes import MeshFinder
from morphgen.urdf.repair import check_inertia, find_defects
from morphgen.urdf.tree import Joint, Link, Tree, read_tree

PARTS = ("hip", "thigh", "shank", "foot")
_SAME = 1e-6
"""Differences below this [m] or [1] are rounding."""


def inspect(
    urdf: Path,
    *,
    mesh_paths: Sequence[Path] = (),
    repair: bool = False,
    lock: Collection[str] = (),
    hips: Mapping[str, str] | None = None,
) -> Inspection:
    """Say what is in a URDF and whether it can be scaled; what is wrong with it lands in `refused`.

    Args:
        urdf: the file.
        mesh_paths: folders in which meshes are looked for.
        repair: whether impossible inertias may be repaired.
        lock: joints to be fixed at zero.
        hips: hip joint of each of FL, FR, RL, RR, where the legs are not found by their place.

    Raises:
        OSError: the file cannot be opened.
        MorphologyError: a mesh path is not a folder.
    """
    finder = MeshFinder(urdf, mesh_paths)
    try:
        text = urdf.read_text(encoding="utf-8")
        tree = read_tree(text, str(urdf))
    except UnicodeDecodeError as error:
        return Inspection(str(urdf), refused=(f"{urdf}: not UTF-8 text ({error.reason}); save it as UTF-8",))
    except MorphologyError as error:
        return Inspection(str(urdf), refused=(str(error),))
    meshes = _meshes(tree, finder)
    findings = Inspection(
        file=str(urdf),
        robot=tree.name,
        total_mass=sum(link.inertial.mass for link in tree.links if link.inertial is not None),
        links=tuple(_link(tree, i, link) for i, link in enumerate(tree.links)),
        joints=tuple(_joint(joint) for joint in tree.joints if joint.kind != "fixed"),
        meshes=meshes,
        missing_inertials=tuple(
            link.name for i, link in enumerate(tree.links) if link.inertial is None and any(_shapes(tree, i))
        ),
        collision_only=tuple(
            link.name for i, link in enumerate(tree.links) if link.inertial is None and _shapes(tree, i)[0]
        ),
    )
    refused = [mesh.problem for mesh in meshes if mesh.collision and mesh.problem is not None]
    for defect in find_defects(tree):
        if not (defect.repairable and (repair or defect.placeholder)):
            remedy = "correct it, or let it be repaired (--repair)" if defect.repairable else "give it an <inertial>"
            refused.append(f"link '{tree.links[defect.link].name}': {defect.problem}; {remedy}")
    try:
        factory = BodyFactory(
            tree.name,
            text,
            rule="stretch",
            source=urdf,
            mesh_paths=mesh_paths,
            repair=repair,
            lock=lock,
            hips=hips,
        )
    except MorphologyError as error:
        # the reader stops at the first error, which may be one of those above
        message = str(error).removeprefix(f"{urdf}: ")
        known = any(message.split(": ")[0] == text.split(": ")[0] for text in refused)
        return replace(findings, refused=(*refused, *(() if known else (message,))))
    return _with_legs(replace(findings, refused=tuple(refused)), factory)


def _with_legs(findings: Inspection, factory: BodyFactory) -> Inspection:
    """Add what can be said once the legs are found."""
    robot, nominal = factory.robot, factory.space.nominal[None]
    part, stretched = _parts(robot)
    links = tuple(
        replace(link, part=part[link.name], stretched=stretched.get(link.name, False)) for link in findings.links
    )
    skeleton = factory.skeleton(nominal)
    stance = factory.stance(nominal)
    return replace(
        findings,
        hip_height=float(stance.hip_height[0]) if stance.feasible[0] else None,
        links=links,
        legs=tuple(_leg(robot, skeleton, k) for k in range(4)),
        asymmetries=tuple(_asymmetries(skeleton, factory.collisions(nominal))),
        carried=tuple(
            link.name for link in links if link.mass and not link.stretched and not link.part.endswith("foot")
        ),
        repaired=tuple(factory.notes),
    )


def _link(tree: Tree, i: int, link: Link) -> LinkFinding:
    collisions, visuals = _shapes(tree, i)
    inertial = link.inertial
    return LinkFinding(
        name=link.name,
        part="",
        mass=None if inertial is None else inertial.mass,
        com=None if inertial is None else tuple(inertial.com.tolist()),
        moments=None if inertial is None else tuple(np.linalg.eigvalsh(inertial.inertia).tolist()),
        problem=None if inertial is None else check_inertia(inertial),
        collisions=collisions,
        visuals=visuals,
        stretched=False,
    )


def _shapes(tree: Tree, link: int) -> tuple[int, int]:
    """Number of collisions and of visuals."""
    kinds = [shape.collision for shape in tree.shapes if shape.link == link]
    return sum(kinds), len(kinds) - sum(kinds)


def _joint(joint: Joint) -> JointFinding:
    limited = bool(np.isfinite(joint.lower) and np.isfinite(joint.upper))
    missing = {"limits": limited, "effort": joint.effort, "velocity": joint.velocity}
    return JointFinding(
        name=joint.name,
        kind=joint.kind,
        lower=joint.lower if limited else None,
        upper=joint.upper if limited else None,
        effort=joint.effort,
        velocity=joint.velocity,
        missing=() if joint.kind == "floating" else tuple(name for name, value in missing.items() if not value),
    )


def _meshes(tree: Tree, finder: MeshFinder) -> tuple[MeshFinding, ...]:
    users: dict[str, list[int]] = {}
    for g, shape in enumerate(tree.shapes):
        if shape.mesh is not None:
            users.setdefault(shape.mesh, []).append(g)
    found = []
    for name, indices in users.items():
        shapes = [tree.shapes[g] for g in indices]
        first = next((shape for shape in shapes if shape.collision), shapes[0])
        where = f"link '{tree.links[first.link].name}' {'collision' if first.collision else 'visual'}"
        path, problem = None, None
        try:
            path = str(finder.path(name, where))
        except MorphologyError as error:
            problem = str(error)
        links = tuple(dict.fromkeys(tree.links[shape.link].name for shape in shapes))
        found.append(MeshFinding(name, links, first.collision, path, problem))
    return tuple(found)


def _parts(robot: Robot) -> tuple[dict[str, str], dict[str, bool]]:
    """By link name: the part it belongs to, and whether it stretches."""
    names = [link.name for link in robot.tree.links]
    segments = [("trunk", robot.segments.trunk)]
    for quarter, leg in zip(QUARTERS, robot.segments.legs, strict=True):
        segments += [(f"{quarter} {part}", segment) for part, segment in zip(PARTS, leg, strict=False)]
    part, stretched = dict.fromkeys(names, ""), dict.fromkeys(names, False)
    for title, segment in segments:
        for link, is_stretched in zip(segment.part.links, segment.stretched, strict=True):
            part[names[link]], stretched[names[link]] = title, is_stretched
    for quarter, leg in zip(QUARTERS, robot.leg_map.legs, strict=True):
        part[names[leg.foot]] = f"{quarter} foot"
    return part, stretched


def _leg(robot: Robot, skeleton: Skeleton, k: int) -> LegFinding:
    leg, tree = robot.leg_map.legs[k], robot.tree
    shank = tuple(link for link in leg.parts[2].links if link != leg.foot)
    links = (leg.parts[0].links, leg.parts[1].links, shank, (leg.foot,))
    origin = skeleton.joint_origin[0, k]
    reach = leg_reach(skeleton)[0, k]
    return LegFinding(
        name=QUARTERS[k],
        joints=tuple(tree.joints[j].name for j in leg.joints),
        links=tuple(tuple(tree.links[link].name for link in part) for part in links),
        hip_offset=float(np.linalg.norm(origin[1])),
        thigh=float(skeleton.segment_length[0, k, 0]),
        shank=float(skeleton.segment_length[0, k, 1]),
        reach=(float(reach[0]), float(reach[1])),
        foot_radius=float(skeleton.foot_radius[0, k]),
    )


def _asymmetries(skeleton: Skeleton, collisions: Collisions) -> Iterator[Asymmetry]:
    """Left legs against the mirror images of the right ones, in frames parallel to the base."""
    mirror = np.array([1.0, -1.0, 1.0])
    for pair, left, right in (("front", 0, 1), ("hind", 2, 3)):
        for k, part in enumerate(PARTS):
            name = f"{pair} {part}"

            def gap(vectors: Array, k: int = k, left: int = left, right: int = right) -> float:
                return 1000 * float(np.linalg.norm(vectors[0, left, k] - mirror * vectors[0, right, k]))

            inertia = skeleton.link_inertia[0, [left, right], k]
            own, other = inertia[0], mirror[:, None] * inertia[1] * mirror
            masses = skeleton.link_mass[0, [left, right], k]
            yield from _if_large(
                name, "place of its joint" if k < 3 else "place of its centre", gap(skeleton.joint_origin), "mm"
            )
            yield from _if_large(name, "centre of mass", gap(skeleton.link_com), "mm")
            yield from _if_large(name, "mass", _percent(masses[0] - masses[1], masses[0]), "%")
            yield from _if_large(name, "inertia", _percent(own - other, own), "%")
            yield from _if_large(name, "collision", _collision_gap(collisions, left, right, k, mirror), "mm")
    yield from _if_large("trunk", "centre of mass off the middle", 1000 * abs(float(skeleton.base_com[0, 1])), "mm")


def _if_large(part: str, quantity: str, difference: float, unit: str) -> Iterator[Asymmetry]:
    if difference > _SAME * (1000 if unit == "mm" else 100):
        yield Asymmetry(part, quantity, difference, unit)


def _percent(difference: Array | float, value: Array | float) -> float:
    size = float(np.linalg.norm(value))
    return 100 * float(np.linalg.norm(difference)) / size if size else 0.0


def _collision_gap(collisions: Collisions, left: int, right: int, part: int, mirror: Array) -> float:
    """Largest difference in place or size of the shapes of a part; inf if they differ in kind or number."""
    sides = [
        [g for g in range(len(collisions.kind)) if (collisions.leg[g], collisions.part[g]) == (leg, part)]
        for leg in (left, right)
    ]
    kinds = [[collisions.kind[g] for g in side] for side in sides]
    if kinds[0] != kinds[1]:
        return np.inf
    gaps = [0.0]
    for g, h in zip(*sides, strict=True):
        gaps.append(float(np.linalg.norm(collisions.position[0, g] - mirror * collisions.position[0, h])))
        gaps.append(float(np.abs(collisions.size[0, g] - collisions.size[0, h]).max()))
    return 1000 * max(gaps)
