"""The motion in a log, as arrays; read with rosbags, like any other tool would."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from locorl.interfaces import Array
from rosbags.highlevel import AnyReader


@dataclass(frozen=True)
class Motion:
    """States of a run; T rows.

    Attributes:
        time: since the first row, (T,), s.
        qpos: base position, base quaternion (w, x, y, z) and the joints in the order of `joint_names`, (T, 19).
        joint_names: names of the 12 joints.
        power: dq * tau of each joint, (T, 12), W.
    """

    time: Array
    qpos: Array
    joint_names: tuple[str, ...]
    power: Array


def read_motion(log: Path) -> Motion:
    """Read joint states and the simulator's ground truth from an MCAP log."""
    joints: list[tuple[int, Any]] = []
    bases: dict[int, Any] = {}
    with AnyReader([log]) as reader:
        for connection, _, raw in reader.messages():
            if connection.topic not in ("/joint_states", "/ground_truth"):
                continue
            message: Any = reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
            if connection.topic == "/joint_states":
                joints.append((stamp, message))
            else:
                bases[stamp] = message.pose.pose
    rows = [(stamp, message, bases[stamp]) for stamp, message in joints if stamp in bases]
    if not rows:
        raise ValueError(f"{log} has no joint states with a base pose at the same time")
    qpos = [
        [
            *(pose.position.x, pose.position.y, pose.position.z),
            *(pose.orientation.w, pose.orientation.x, pose.orientation.y, pose.orientation.z),
            *message.position,
        ]
        for _, message, pose in rows
    ]
    return Motion(
        time=np.array([(stamp - rows[0][0]) * 1e-9 for stamp, _, _ in rows]),
        qpos=np.array(qpos),
        joint_names=tuple(rows[0][1].name),
        power=np.array([message.velocity * message.effort for _, message, _ in rows]),
    )


def load_scene(path: Path) -> mujoco.MjModel:
    """The bundle's scene, with buffers large enough for a video."""
    spec = mujoco.MjSpec.from_file(str(path))
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1280, 720
    return spec.compile()


def set_pose(model: mujoco.MjModel, data: mujoco.MjData, motion: Motion, row: int) -> None:
    """Put `data` into the pose of one row; joints are bound by name."""
    data.qpos[:7] = motion.qpos[row, :7]
    for name, angle in zip(motion.joint_names, motion.qpos[row, 7:], strict=True):
        data.qpos[model.joint(name).qposadr[0]] = angle
