"""Which joints belong to the front legs, from the geometry of the robot."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from deploy.interfaces import Array


def fore_joints(urdf: str, joint_names: tuple[str, ...]) -> NDArray[np.bool_] | None:
    """True for the joints of legs that start in front of the base's origin (x forward), at zero joint angles.

    A leg starts where its first moving joint is.

    Args:
        urdf: Text of the robot description.
        joint_names: Of the actuated joints.

    Returns:
        Shape (n,), or None where the description lacks one of the joints or a leg starts at the origin.
    """
    try:
        root = ElementTree.fromstring(urdf)
    except ElementTree.ParseError:
        return None
    joints = {joint.get("name", ""): joint for joint in root.iter("joint") if joint.find("child") is not None}
    above = {_link(joint, "child"): joint for joint in joints.values()}
    starts = []
    for name in joint_names:
        if name not in joints:
            return None
        chain = [joints[name]]
        while (parent := above.get(_link(chain[-1], "parent"))) is not None:
            chain.append(parent)
        moving = max(
            i for i, joint in enumerate(chain) if joint.get("type") != "fixed" and joint.get("type") != "floating"
        )
        pose = np.eye(4)
        for joint in reversed(chain[moving:]):
            pose = pose @ _origin(joint)
        starts.append(pose[0, 3])
    return None if np.isclose(starts, 0.0).any() else np.array(starts) > 0


def _link(joint: ElementTree.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _origin(joint: ElementTree.Element) -> Array:
    """Pose of a joint in its parent link, (4, 4); rpy turns about the fixed axes x, y, z in this order."""
    element = joint.find("origin")
    pose = np.eye(4)
    if element is None:
        return pose
    pose[:3, 3] = [float(value) for value in element.get("xyz", "0 0 0").split()]
    roll, pitch, yaw = (float(value) for value in element.get("rpy", "0 0 0").split())
    (sr, sp, sy), (cr, cp, cy) = np.sin([roll, pitch, yaw]), np.cos([roll, pitch, yaw])
    pose[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return pose
