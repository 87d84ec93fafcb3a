"""Names and order of the parts of a robot that controllers and simulators address."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from morphgen.skeleton import Skeleton
from morphgen.urdf.legs import LegMap
from morphgen.urdf.tree import Tree

IMU = {"gyro": "imu_gyro", "acc": "imu_acc", "quat": "imu_quat"}


@dataclass(frozen=True)
class Layout:
    """Names in the compiled model; joint vectors are ordered by leg (FL, FR, RL, RR), then hip, thigh, knee.

    Attributes:
        robot: name of the robot.
        base: body that carries the free joint.
        joints: the 12 actuated joints, in the order of qpos[7:], qvel[6:] and ctrl.
        actuators: the 12 position servos, named as their joints.
        feet: sites at the centres of the foot spheres.
        foot_contact: sensors of each foot, size 4: count of contacts, then the net force that it exerts, world axes, N.
        links: bodies other than feet: the base, then hip, thigh and shank of each leg.
        link_contact: sensors that count the contacts of each of the links.
        link_leg: leg index of each of the links, -1 for the base.
        imu: names of the sensors gyro, acc and quat.
        mirror_joint: left-right mirror: q_mirrored[j] = mirror_sign[j] * q[mirror_joint[j]].
        mirror_sign: see mirror_joint.
    """

    robot: str
    base: str
    joints: tuple[str, ...]
    actuators: tuple[str, ...]
    feet: tuple[str, ...]
    foot_contact: tuple[str, ...]
    links: tuple[str, ...]
    link_contact: tuple[str, ...]
    link_leg: tuple[int, ...]
    mirror_joint: tuple[int, ...]
    mirror_sign: tuple[float, ...]
    imu: Mapping[str, str] = field(default_factory=lambda: dict(IMU), hash=False)

    def body(self, leg: int, part: int) -> str:
        """Name of the body of a part: 0 to 3 for hip, thigh, shank and foot of a leg; leg -1 for the base."""
        if leg < 0:
            return self.base
        return self.feet[leg] if part == 3 else self.links[1 + 3 * leg + part]


def make_layout(robot: str, tree: Tree, leg_map: LegMap, nominal: Skeleton) -> Layout:
    """The layout of a robot; a part of several links is named by its root."""
    legs = leg_map.legs
    joints = tuple(tree.joints[j].name for leg in legs for j in leg.joints)
    feet = tuple(tree.links[leg.foot].name for leg in legs)
    base = tree.links[leg_map.base].name
    links = (base, *(tree.links[part.root].name for leg in legs for part in leg.parts))
    other_side = np.array([1, 0, 3, 2])
    # a rotation axis is a pseudovector: mirroring y keeps its y and flips the rest
    mirrored_axis = nominal.axis[other_side] * (-1, 1, -1)
    sign = np.sign((mirrored_axis * nominal.axis).sum(axis=-1))
    return Layout(
        robot=robot,
        base=base,
        joints=joints,
        actuators=joints,
        feet=feet,
        foot_contact=tuple(f"{name}_contact" for name in feet),
        links=links,
        link_contact=tuple(f"{name}_contact" for name in links),
        link_leg=(-1, *(i for i in range(4) for _ in range(3))),
        mirror_joint=tuple(int(3 * leg + k) for leg in other_side for k in range(3)),
        mirror_sign=tuple(float(s) for s in sign.ravel()),
    )
