"""Examine a bundle before it meets a robot: intact, consistent, reproducible, and made for that robot."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from deploy.bundles.golden import GoldenResult, check_golden
from deploy.bundles.loading import load_bundle
from deploy.bundles.manifest import Bundle, Joint
from deploy.errors import RobotError
from deploy.policy.onnx_runtime import OnnxRuntime
from deploy.policy.torchscript_runtime import TorchScriptRuntime
from deploy.robots.specs import mismatches, spec_of

ANGLE_TOLERANCE = 1e-3
"""Difference of a joint limit in the URDF and in the manifest that does not count, rad."""

EFFORT_TOLERANCE = 1e-3
"""Relative difference of a torque limit that does not count."""


@dataclass(frozen=True)
class Diagnosis:
    """What the doctor found.

    Attributes:
        bundle: The bundle, its files intact.
        golden: How well each runtime reproduces the golden trace, by name.
        skipped: What was not examined, and why.
        problems: One sentence each; empty: fit to run.
    """

    bundle: Bundle
    golden: Mapping[str, GoldenResult]
    skipped: tuple[str, ...]
    problems: tuple[str, ...]


def examine(folder: str | Path, robot: str | None = None, design: Mapping[str, float] | None = None) -> Diagnosis:
    """Examine a bundle.

    Args:
        folder: Folder of the bundle.
        robot: Robot that it shall run on, such as "go2"; None for none in particular.
        design: Scales that this robot was built with, by parameter; what is missing is 1.

    Returns:
        What was found; a bundle that is not intact raises instead.

    Raises:
        BundleError: A file is missing, added or changed, or the golden trace is not reproduced.
        RobotError: No robot of that name is known.
    """
    bundle = load_bundle(folder)
    golden, skipped, problems = {"onnx": check_golden(bundle, OnnxRuntime(bundle))}, [], _body_problems(bundle)
    if bundle.policy.torchscript is None:
        skipped.append("TorchScript: the bundle holds none")
    elif importlib.util.find_spec("torch") is None:
        skipped.append("TorchScript: torch is not installed (extra torch)")
    else:
        golden["torchscript"] = check_golden(bundle, TorchScriptRuntime(bundle))
    if importlib.util.find_spec("mujoco") is None:
        skipped.append("scene: MuJoCo is not installed (extra sim)")
    else:
        problems += _scene_problems(bundle)
    if robot is None:
        skipped.append("robot: none named (--robot)")
    else:
        problems += mismatches(bundle, spec_of(robot), design)
    return Diagnosis(bundle, golden, tuple(skipped), tuple(problems))


def _body_problems(bundle: Bundle) -> list[str]:
    """Where URDF and servo gains contradict the manifest."""
    problems = []
    for joint in bundle.joints:
        torque = abs(joint.kp * (joint.target_offset - joint.stance))
        if torque > joint.torque_limit:
            problems.append(
                f"gains: {joint.name} needs {torque:.1f} N m to hold the stance, its limit is "
                f"{joint.torque_limit:.1f} N m; export the bundle again"
            )
        if joint.kd == 0:
            problems.append(f"gains: {joint.name} has no damping (kd 0); export the bundle again")
    path = bundle.path(bundle.robot.urdf)
    try:
        root = ElementTree.fromstring(path.read_bytes())
    except ElementTree.ParseError as error:
        return [*problems, f"{path}: not XML ({error}); export the bundle again"]
    elements = {element.get("name"): element for element in root.iter("joint")}
    return [*problems, *(f"{path}: {text}" for joint in bundle.joints for text in _urdf_problems(joint, elements))]


def _urdf_problems(joint: Joint, elements: Mapping[str | None, ElementTree.Element]) -> list[str]:
    element = elements.get(joint.name)
    if element is None:
        return [f"no joint {joint.name} in it; it describes another robot: export the bundle again"]
    limit = element.find("limit")
    if limit is None:
        return []
    problems = []
    for name, wanted in (("lower", joint.lower), ("upper", joint.upper)):
        found = float(limit.get(name, wanted))
        if not abs(found - wanted) <= ANGLE_TOLERANCE:
            problems.append(f"joint {joint.name}: {name} is {found:g} rad, the manifest says {wanted:g}")
    effort = float(limit.get("effort", joint.torque_limit))
    if not abs(effort - joint.torque_limit) <= EFFORT_TOLERANCE * joint.torque_limit:
        problems.append(f"joint {joint.name}: effort is {effort:g} N m, the manifest says {joint.torque_limit:g}")
    return problems


def _scene_problems(bundle: Bundle) -> list[str]:
    from deploy.robots.mujoco_robot import MujocoRobot

    try:
        MujocoRobot(bundle)
    except RobotError as error:
        return [str(error)]
    return []
