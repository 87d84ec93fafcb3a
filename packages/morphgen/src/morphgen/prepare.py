"""From the text of a URDF to a robot that can be scaled: repaired, legs found, collisions as primitives."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from morphgen.scaling.bodies import Robot
from morphgen.scaling.segments import find_segments
from morphgen.urdf.feet import clear_feet, with_feet
from morphgen.urdf.fit import with_primitives
from morphgen.urdf.legs import find_legs, lock_joints
from morphgen.urdf.meshes import MeshFinder
from morphgen.urdf.repair import with_valid_inertia
from morphgen.urdf.tree import read_tree


def prepare(
    text: str,
    source: str,
    meshes: MeshFinder,
    *,
    repair: bool = False,
    lock: Collection[str] = (),
    hips: Mapping[str, str] | None = None,
) -> tuple[Robot, list[str]]:
    """Make a robot ready to be scaled.

    Args:
        text: of the URDF.
        source: its name, for messages.
        meshes: finds the meshes of collisions.
        repair: whether impossible inertias are repaired instead of refused.
        lock: joints that are fixed at zero.
        hips: hip joint of each of FL, FR, RL, RR, where the legs are not found by their place.

    Returns:
        The robot, and notes on everything that was replaced or repaired.

    Raises:
        MorphologyError: not a quadruped that can be scaled; names element and remedy.
    """
    tree, notes = with_valid_inertia(read_tree(text, source), allow_repair=repair)
    tree = lock_joints(tree, lock)
    leg_map = find_legs(tree, hips)
    replaced = [g for g, s in enumerate(tree.shapes) if s.collision and s.kind == "mesh"]
    if replaced:
        tree = with_primitives(tree, meshes, [leg.foot for leg in leg_map.legs])
        tree = lock_joints(clear_feet(tree, leg_map, replaced), lock)
        notes.append(f"{len(replaced)} collision meshes were replaced by primitives around them")
    tree, made = with_feet(tree, leg_map)
    tree = lock_joints(tree, lock)
    leg_map = find_legs(tree, hips)
    return Robot(tree, leg_map, find_segments(tree, leg_map)), [*notes, *made]
