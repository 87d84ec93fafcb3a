"""Kinematics and statics of random quadrupeds against MuJoCo and against loads worked out by hand."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from morphgen.stance.kinematics import forward_kinematics
from morphgen.stance.statics import GRAVITY, foot_load, static_torque
from numpy.testing import assert_allclose
from random_skeletons import LEGS, PARTS, posed, random_skeleton, straight_skeleton


def test_forward_kinematics_agrees_with_mujoco():
    rng = np.random.default_rng(0)
    body = random_skeleton(rng, 6)
    angles = rng.uniform(-2, 2, (6, 4, 3))
    poses = forward_kinematics(body, angles)
    for row in range(6):
        _, data = posed(body, angles[row], row=row)
        for leg, name in enumerate(LEGS):
            for k, part in enumerate(PARTS):
                found = data.body(f"{name}_{part}")
                assert_allclose(poses.joint[row, leg, k], found.xpos, atol=1e-12)
                assert_allclose(poses.com[row, leg, k], found.xipos, atol=1e-12)
                if part != "foot":
                    assert_allclose(poses.rotation[row, leg, k], found.xmat.reshape(3, 3), atol=1e-12)
                    assert_allclose(poses.axis[row, leg, k], data.joint(f"{name}_{part}").xaxis, atol=1e-12)


def test_loads_and_torques_leave_nothing_of_mujocos_inverse_dynamics():
    """mj_inverse at rest gives what gravity asks for; loads push it into base and joints, torques cancel the joints."""
    rng = np.random.default_rng(1)
    body = random_skeleton(rng, 6)
    angles = rng.uniform(-1, 1, (6, 4, 3))
    poses = forward_kinematics(body, angles)
    load, torque = foot_load(body, poses), static_torque(body, poses)
    for row in range(6):
        model, data = posed(body, angles[row], height=5, row=row)
        data.qacc[:] = 0
        mujoco.mj_inverse(model, data)
        columns = []
        for name in LEGS:
            jacobian = np.zeros((3, model.nv))
            mujoco.mj_jacBody(model, data, jacobian, None, data.body(f"{name}_foot").id)
            columns.append(jacobian[2])
        lifted = np.stack(columns, axis=1)
        # of all loads that carry the base, MuJoCo's Jacobian and LAPACK's least-norm solution name the same
        expected, *_ = np.linalg.lstsq(lifted[2:5], (data.qfrc_inverse)[2:5], rcond=None)
        assert_allclose(load[row], expected, atol=1e-8)
        needed = data.qfrc_inverse - lifted @ load[row]
        assert_allclose(needed[:6], 0, atol=1e-9)
        assert_allclose(torque[row].ravel(), needed[6:], atol=1e-9)


def test_loads_of_a_rectangle_of_feet_by_hand():
    """Feet at x = +-0.2, y = +-0.15: moments about the middle give each load."""
    body = replace(straight_skeleton(), base_com=np.array([[0.1, 0.03, 0.5]]))
    load = foot_load(body, forward_kinematics(body, np.zeros((1, 4, 3))))
    front, left = 0.1 / 0.4, 0.03 / 0.3  # shares that move forward and to the left
    shares = [0.25 + front / 2 + left / 2, 0.25 + front / 2 - left / 2, 0.25 - front / 2 + left / 2]
    assert_allclose(load[0, :3], np.array(shares) * 10 * GRAVITY)
    assert load.sum() == pytest.approx(10 * GRAVITY)


def test_torque_of_a_bent_leg_by_hand():
    """The foot under the thigh joint and the knee 0.15 m behind both: only knee and hip carry."""
    body = straight_skeleton()
    bend = np.arcsin(0.6)
    angles = np.tile([0.0, bend, -2 * bend], (1, 4, 1))
    torque = static_torque(body, forward_kinematics(body, angles))[0]
    load = 2.5 * GRAVITY
    assert_allclose(torque[:, 1], 0, atol=1e-12)
    # an upward force in front of the knee turns the shank about -y, the motor holds against it
    assert_allclose(torque[:, 2], 0.15 * load)
    # the foot is 0.1 m outside of the hip joint
    assert_allclose(torque[:, 0], -0.1 * load * np.array([1, -1, 1, -1]), atol=1e-12)
