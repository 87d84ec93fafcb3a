"""The measurements of one body that a builder or a reader of a report asks for."""

from __future__ import annotations

from numpy.typing import ArrayLike

from morphgen.factory import BodyFactory
from morphgen.stance.reach import leg_reach

SEGMENTS = ("thigh", "shank")


def dimensions(factory: BodyFactory, design: ArrayLike) -> dict[str, float]:
    """Lengths [m], masses [kg] and stance of one design (d,); the unit ends each key.

    Left legs stand for both sides. Lengths run from joint axis to joint axis, or to the foot centre; masses
    are of one segment. The reach is the longest distance from thigh joint to foot centre that the knee
    allows, in the leg's plane.
    """
    body, stance = factory.skeleton(design), factory.stance(design)
    table: dict[str, float] = {}
    for leg, pair in ((0, "front"), (2, "hind")):
        for part, segment in enumerate(SEGMENTS):
            table[f"{pair}_{segment}_length_m"] = float(body.segment_length[0, leg, part])
            table[f"{pair}_{segment}_mass_kg"] = float(body.link_mass[0, leg, part + 1])
        table[f"{pair}_leg_reach_m"] = float(leg_reach(body)[0, leg, 1])
    table["foot_radius_m"] = float(body.foot_radius[0, 0])
    table["hip_spacing_m"] = float(body.joint_origin[0, 0, 0, 0] - body.joint_origin[0, 2, 0, 0])
    table["stance_hip_height_m"] = float(stance.hip_height[0])
    table["total_mass_kg"] = float(body.total_mass[0])
    return table
