"""Rotations against MuJoCo's own quaternion functions."""

from __future__ import annotations

import mujoco
import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from locorl.env.kinematics import projected_gravity, to_base_frame, yaw_quat

number = st.floats(-10, 10).map(lambda x: round(x, 6))
vectors = arrays(float, 3, elements=number)
quats = arrays(float, 4, elements=number).filter(lambda q: np.linalg.norm(q) > 0.1).map(lambda q: q / np.linalg.norm(q))


def rotate_inverse(quat: np.ndarray, vector: np.ndarray) -> np.ndarray:
    inverse, result = np.zeros(4), np.zeros(3)
    mujoco.mju_negQuat(inverse, quat)
    mujoco.mju_rotVecQuat(result, vector, inverse)
    return result


@given(quats, vectors)
def test_to_base_frame(quat, vector):
    ours = to_base_frame(torch.from_numpy(quat)[None], torch.from_numpy(vector)[None])[0]
    np.testing.assert_allclose(ours.numpy(), rotate_inverse(quat, vector), atol=1e-9)


@given(quats)
def test_projected_gravity(quat):
    ours = projected_gravity(torch.from_numpy(quat)[None])[0]
    np.testing.assert_allclose(ours.numpy(), rotate_inverse(quat, np.array([0.0, 0.0, -1.0])), atol=1e-9)


@given(st.floats(-7, 7))
def test_yaw_quat(yaw):
    truth = np.zeros(4)
    mujoco.mju_axisAngle2Quat(truth, np.array([0.0, 0.0, 1.0]), yaw)
    np.testing.assert_allclose(yaw_quat(torch.tensor([yaw], dtype=torch.float64))[0].numpy(), truth, atol=1e-9)
