"""The depth camera of a simulated robot: rays against the ground, as in training."""

# pyright: reportAttributeAccessIssue=false
# mujoco ships no type stubs for its compiled modules.
from __future__ import annotations

import mujoco
import numpy as np

from deploy.bundles.manifest import Depth
from deploy.interfaces import Array, Image

GROUND, ROBOT = 0, 1
"""Geometry groups of the model, told apart by the camera: what stands still, and what moves."""


class MujocoCamera:
    """Depth along the optical axis of every pixel that the network reads, without noise.

    It sees what does not move, and no robot: neither does the camera of the training. Its mount has the middle of the
    trained range of pitches.
    """

    def __init__(self, model: mujoco.MjModel, depth: Depth) -> None:
        """Group the geometry of `model`, which changes how viewers show it and nothing else."""
        self._model = model
        static = model.body_weldid[model.geom_bodyid] == 0
        model.geom_group[:] = np.where(static, GROUND, ROBOT)
        self._groups = np.array([group == GROUND for group in range(mujoco.mjNGROUP)], dtype=np.uint8)
        self._position = np.array(depth.camera_position)
        rays = depth.optics.rays()
        self._shape = rays.shape[:2]
        pitch = float(np.mean(depth.camera_pitch))
        turn = np.array([[np.cos(pitch), 0.0, np.sin(pitch)], [0.0, 1.0, 0.0], [-np.sin(pitch), 0.0, np.cos(pitch)]])
        rays = rays.reshape(-1, 3)
        self._length = np.linalg.norm(rays, axis=1)
        self._rays = rays @ turn.T / self._length[:, None]
        self._far = depth.optics.far

    def render(self, data: mujoco.MjData, position: Array, quat_wxyz: Array) -> Image:
        """One image.

        Args:
            data: Where the ground stands, after `mj_forward`.
            position: Base origin in the world, shape (3,), m.
            quat_wxyz: Orientation of the base in the world, shape (4,).

        Returns:
            Shape (rows, columns), m; inf where nothing is nearer than the far end.
        """
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, quat_wxyz)
        rotation = matrix.reshape(3, 3)
        count = len(self._rays)
        geom, distance = np.zeros(count, dtype=np.int32), np.zeros(count)
        mujoco.mj_multiRay(
            self._model,
            data,
            position + rotation @ self._position,
            (self._rays @ rotation.T).reshape(-1),
            self._groups,
            True,
            -1,
            geom,
            distance,
            None,
            count,
            self._far * float(self._length.max()),
        )
        depth = np.where(geom >= 0, distance / self._length, np.inf)
        return depth.reshape(self._shape).astype(np.float32)
