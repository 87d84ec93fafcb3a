"""The load at which stances buckle against MuJoCo's energy, and against falling in simulation."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from morphgen import Drive, go2
from morphgen.stance.kinematics import forward_kinematics
from morphgen.stance.stability import LEAST_BUCKLING_FACTOR, buckling_factor
from morphgen.stance.stance import solve_stance
from numpy.testing import assert_allclose
from random_skeletons import LEGS, posed, random_skeleton

KP = 60.0


def factor(body, stance, kp=KP):
    return buckling_factor(body, forward_kinematics(body, stance.joints), np.full((body.n, 4, 3), kp))


class PinnedFeet:
    """Potential energy of one body in MuJoCo as its base moves and its feet stay at their points on the floor."""

    def __init__(self, body, stance):
        self.model, self.data = posed(body, stance.joints[0], stance.base_height[0])
        self.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
        self.start = self.data.qpos.copy()
        self.pins = self.feet()
        self.joints, self.torque = stance.joints[0].ravel(), stance.torque[0].ravel()

    def feet(self):
        return np.array([self.data.body(f"{leg}_foot").xpos for leg in LEGS])

    def energy(self, x, load):
        """For a translation and rotation vector x (6,) of the base, at `load` times the weight."""
        data, model = self.data, self.model
        data.qpos[:] = self.start
        data.qpos[:3] += x[:3]
        mujoco.mju_quatIntegrate(data.qpos[3:7], x[3:], 1.0)
        for _ in range(8):  # Newton
            mujoco.mj_forward(model, data)
            for i, leg in enumerate(LEGS):
                jacobian = np.zeros((3, model.nv))
                mujoco.mj_jacBody(model, data, jacobian, None, data.body(f"{leg}_foot").id)
                joints = slice(6 + 3 * i, 9 + 3 * i)
                step = np.linalg.solve(jacobian[:, joints], self.pins[i] - data.body(f"{leg}_foot").xpos)
                data.qpos[7 + 3 * i : 10 + 3 * i] += step
        mujoco.mj_forward(model, data)
        stretch = data.qpos[7:] - self.joints - load * self.torque / KP
        return load * data.energy[0] + KP * (stretch**2).sum() / 2

    def stiffness(self, load, step=2e-3):
        def at(i, j, a, b):
            x = np.zeros(6)
            x[i] += a * step
            x[j] += b * step
            return self.energy(x, load)

        corners = ((1, 1), (1, -1), (-1, 1), (-1, -1))
        second = [[sum(a * b * at(i, j, a, b) for a, b in corners) for j in range(6)] for i in range(6)]
        return np.array(second) / (4 * step**2)


@pytest.mark.parametrize("seed", [3, 10, 11])
def test_the_energy_stops_to_have_a_minimum_at_the_factor(seed):
    """Point feet; the least eigenvalue of the second derivatives of MuJoCo's energy changes sign there."""
    body = random_skeleton(np.random.default_rng(seed))
    body = replace(body, foot_radius=np.full((1, 4), 1e-9))
    stance = solve_stance(body)
    assert stance.feasible.all()
    critical = factor(body, stance)[0]
    pinned = PinnedFeet(body, stance)
    assert np.linalg.eigvalsh(pinned.stiffness(0.97 * critical))[0] > 0
    assert np.linalg.eigvalsh(pinned.stiffness(1.03 * critical))[0] < 0


def test_the_factor_grows_with_stiffness_and_falls_with_weight():
    body = random_skeleton(np.random.default_rng(4), 5)
    stance = solve_stance(body)
    heavy = replace(body, link_mass=body.link_mass * 3, base_mass=body.base_mass * 3)
    assert_allclose(factor(body, stance, 2 * KP), 2 * factor(body, stance))
    assert_allclose(factor(heavy, stance), factor(body, stance) / 3)


def tilt_after_five_seconds(factory, design):
    batch = factory.batch(design)
    model = factory.spec(design).compile()
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = batch.stance_qpos[0], batch.stance_ctrl[0]
    for _ in range(1000):
        mujoco.mj_step(model, data)
    return np.degrees(np.arccos(data.body(factory.layout.base).xmat.reshape(3, 3)[2, 2]))


def test_long_legs_on_soft_servos_fall_and_on_stiffer_ones_stand():
    """Go2 on its longest legs: 20 % under the critical stiffness, and 20 % above it."""
    longest = np.full((1, 4), 1.4)
    robot = go2()
    critical = 40.0 / factor(robot.skeleton(longest), robot.stance(longest), 40.0)[0]
    for share, stands in ((0.8, False), (1.2, True)):
        robot.drive = Drive(kp=share * critical)
        assert (tilt_after_five_seconds(robot, longest) < 5) == stands


def test_every_go2_of_the_papers_space_stands_on_the_papers_gains(factory):
    designs = np.vstack([np.full((1, 4), 1.4), np.random.default_rng(1).uniform(0.6, 1.4, (2000, 4))])
    assert factor(factory.skeleton(designs), factory.stance(designs), 40.0).min() > LEAST_BUCKLING_FACTOR
