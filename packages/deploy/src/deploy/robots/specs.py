"""Robots as they are built: joint names in the order of their own controllers, limits and rates.

Sources: Go2: `go2_description.urdf` of unitree_ros (2025; older files give the calf 35.55 N m and 20.07 rad/s),
order of legs and 500 Hz of `LowState_` from unitree_sdk2. Lite3: `Lite3.urdf` of DeepRoboticsLab's
deep_robotics_model (December 2025), whose order of legs is that of its controller; it states no rates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

from deploy.bundles.manifest import Bundle
from deploy.errors import RobotError
from deploy.interfaces import RobotSpec

TOLERANCE = 1e-3
"""Relative difference of a torque and absolute difference of an angle (rad) or scale that do not count."""


def _spec(
    name: str,
    legs: Sequence[str],
    joint: str,
    foot: str,
    parts: Mapping[str, tuple[float, float, float, float]],
    hind: Mapping[str, tuple[float, float]],
    rate: float | None,
) -> RobotSpec:
    """A quadruped of four equal legs; `parts` holds lower, upper, torque and velocity, `hind` other angles."""
    rows = []
    for leg, (part, (lower, upper, torque, velocity)) in product(legs, parts.items()):
        if leg[0] != "F":
            lower, upper = hind.get(part, (lower, upper))
        rows.append((joint.format(leg=leg, part=part), lower, upper, torque, velocity))
    names, lowers, uppers, torques, velocities = zip(*rows, strict=True)
    feet = tuple(foot.format(leg=leg) for leg in legs)
    return RobotSpec(name, names, lowers, uppers, torques, velocities, feet, rate, rate)


GO2 = _spec(
    name="go2",
    legs=("FR", "FL", "RR", "RL"),
    joint="{leg}_{part}_joint",
    foot="{leg}_foot",
    parts={
        "hip": (-1.0472, 1.0472, 23.7, 30.1),
        "thigh": (-1.5708, 3.4907, 23.7, 30.1),
        "calf": (-2.7227, -0.83776, 45.43, 15.70),
    },
    hind={"thigh": (-0.5236, 4.5379)},
    rate=500.0,
)

LITE3 = _spec(
    name="lite3",
    legs=("FL", "FR", "HL", "HR"),
    joint="{leg}_{part}",
    foot="{leg}_FOOT",
    parts={
        "HipX": (-0.523, 0.523, 24.0, 26.2),
        "HipY": (-2.67, 0.314, 24.0, 26.2),
        "Knee": (0.524, 2.792, 36.0, 17.3),
    },
    hind={},
    rate=None,
)

ROBOTS: Mapping[str, RobotSpec] = {spec.name: spec for spec in (GO2, LITE3)}
"""Robots known by name."""


def spec_of(name: str) -> RobotSpec:
    """The robot called `name`.

    Raises:
        RobotError: No such robot is known.
    """
    if name not in ROBOTS:
        raise RobotError(f"robot {name!r} is not known; choose one of {', '.join(ROBOTS)}")
    return ROBOTS[name]


def mismatches(bundle: Bundle, spec: RobotSpec, design: Mapping[str, float] | None = None) -> list[str]:
    """Why a bundle must not run on a robot.

    Args:
        bundle: A verified bundle.
        spec: The robot; what it does not know is not compared.
        design: Scales that the legs of this robot were built with, by parameter; None or a missing one: 1.

    Returns:
        One sentence for each difference; empty where the bundle fits.
    """
    if joints := _joint_mismatches(bundle, spec):
        return joints
    return [
        *_design_mismatches(bundle, spec, design or {}),
        *_limit_mismatches(bundle, spec),
        *_rate_mismatches(bundle, spec),
    ]


def _joint_mismatches(bundle: Bundle, spec: RobotSpec) -> list[str]:
    if bundle.robot.name in ROBOTS and bundle.robot.name != spec.name and spec.name in ROBOTS:
        return [f"body: the bundle was made for a {bundle.robot.name}, this is a {spec.name}; take one made for it"]
    missing = [name for name in bundle.joint_names if name not in spec.joint_names]
    extra = [name for name in spec.joint_names if name not in bundle.joint_names]
    found = [f"joints: the bundle moves {missing}, which {spec.name} does not have"] if missing else []
    found += [f"joints: {spec.name} has {extra}, which the bundle does not move"] if extra else []
    return found


def _design_mismatches(bundle: Bundle, spec: RobotSpec, built: Mapping[str, float]) -> list[str]:
    trained = bundle.robot.design
    unknown = [name for name in built if name not in trained]
    found = [f"body: the bundle knows no design parameter {name!r}, only {list(trained)}" for name in unknown]
    for name, scale in trained.items():
        has = built.get(name, 1.0)
        if not abs(scale - has) <= TOLERANCE:
            found.append(
                f"body: the bundle was trained with {name} {scale:.4g}, this {spec.name} has {has:.4g}; "
                "build those legs and say so, or take a bundle for the legs it has"
            )
    return found


def _limit_mismatches(bundle: Bundle, spec: RobotSpec) -> list[str]:
    found = []
    for joint in bundle.joints:
        place = spec.joint_names.index(joint.name)
        if spec.lower is not None and spec.upper is not None:
            lower, upper = spec.lower[place], spec.upper[place]
            if joint.lower < lower - TOLERANCE or joint.upper > upper + TOLERANCE:
                found.append(
                    f"joint {joint.name}: trained within [{joint.lower:.4g}, {joint.upper:.4g}] rad, "
                    f"{spec.name} moves within [{lower:.4g}, {upper:.4g}] rad"
                )
        if spec.torque_limit is not None and joint.torque_limit > spec.torque_limit[place] * (1 + TOLERANCE):
            found.append(
                f"joint {joint.name}: trained with up to {joint.torque_limit:.4g} N m, "
                f"{spec.name} gives {spec.torque_limit[place]:.4g} N m"
            )
    return found


def _rate_mismatches(bundle: Bundle, spec: RobotSpec) -> list[str]:
    found = []
    if spec.state_hz is not None and bundle.policy_hz > spec.state_hz:
        found.append(f"rate: the policy runs at {bundle.policy_hz:g} Hz, {spec.name} reports at {spec.state_hz:g} Hz")
    if spec.command_hz is not None and bundle.policy_hz > spec.command_hz:
        found.append(f"rate: the policy runs at {bundle.policy_hz:g} Hz, {spec.name} takes {spec.command_hz:g} Hz")
    return found
