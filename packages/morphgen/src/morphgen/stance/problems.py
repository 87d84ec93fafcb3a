"""Why a body cannot stand."""

from __future__ import annotations

import numpy as np

from morphgen.scaling.articulate import Collisions
from morphgen.simulation.layout import Layout
from morphgen.skeleton import Array, Skeleton
from morphgen.stance.clearance import links_clear
from morphgen.stance.kinematics import forward_kinematics
from morphgen.stance.search import knee_clearance
from morphgen.stance.stability import LEAST_BUCKLING_FACTOR, buckling_factor
from morphgen.stance.stance import LEAST_LOAD, Stance
from morphgen.stance.statics import GRAVITY, foot_load

_TOUCHING = 1e-3
_MM = 1000.0


def stance_problems(
    body: Skeleton, collisions: Collisions, stance: Stance, stiffness: Array, layout: Layout
) -> tuple[str, ...]:
    """What is wrong with the stance of one body (n = 1), a phrase each that names foot, joint or link; () if nothing.

    Where no sound stance exists, the one looked at has the feet under the thigh joints.

    Args:
        body: the body.
        collisions: its primitives.
        stance: of `solve_stance`.
        stiffness: (1, 12) kp of the servos [N m/rad].
        layout: its names.
    """
    if stance.feasible[0]:
        return ()
    problems: list[str] = []
    poses = forward_kinematics(body, stance.joints)
    height = float(stance.base_height[0])
    for name, gap in zip(layout.feet, height + poses.joint[0, :, 3, 2] - body.foot_radius[0], strict=True):
        if gap > _TOUCHING:
            problems.append(f"foot '{name}' hangs {gap * _MM:.0f} mm above the floor, out of reach")
    knees = layout.joints[2::3]
    for name, knee, least in zip(
        knees, height + poses.joint[0, :, 2, 2], np.broadcast_to(knee_clearance(body)[0], 4), strict=True
    ):
        if knee < least:
            problems.append(f"knee '{name}' is {knee * _MM:.0f} mm above the floor, it needs {least * _MM:.0f} mm")
    for what, value, low, high in (
        ("angle", stance.joints[0], body.lower, body.upper),
        ("torque", stance.torque[0], -body.effort, body.effort),
    ):
        stopped = ((value <= low) | (value >= high)).ravel()
        problems += [
            f"joint '{name}' is at its {what} limit" for name, at in zip(layout.joints, stopped, strict=True) if at
        ]
    load = foot_load(body, poses)[0] / (GRAVITY * body.total_mass[0])
    problems += [
        f"foot '{name}' carries {share:.0%} of the weight, it should carry {LEAST_LOAD:.0%}"
        for name, share in zip(layout.feet, load, strict=True)
        if share < LEAST_LOAD
    ]
    if not problems and not links_clear(body, poses, stance.base_height, collisions)[0]:
        problems.append("a link other than the feet touches the floor")
    if not problems and buckling_factor(body, poses, stiffness.reshape(1, 4, 3))[0] < LEAST_BUCKLING_FACTOR:
        problems.append("the servos are too soft for the weight: raise kp (Drive, --kp)")
    return tuple(problems) or ("there is no level stance with all feet on the floor",)
