"""Stances and static torques against MuJoCo's kinematics, statics and 3 s of simulation."""

import re
from pathlib import Path

import mujoco
import mujoco.batch
import numpy as np
import pytest
from morphgen import BodyFactory
from morphgen.stance.kinematics import forward_kinematics
from morphgen.stance.statics import static_torque
from numpy.testing import assert_allclose


def compiled(factory, design, qpos):
    model = factory.spec(design).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    return model, data


def test_nominal_stance_is_the_triangle_worked_out_by_hand(factory):
    stance = factory.stance(np.ones((1, 4)))
    # reach 0.75 * 0.426 with equal sides: thigh at acos(0.75), knee at twice that
    assert_allclose(stance.joints[0], np.tile([0, np.arccos(0.75), -2 * np.arccos(0.75)], (4, 1)), atol=1e-12)
    assert_allclose(stance.hip_height[0], 0.3195 + 0.022)
    assert_allclose(stance.base_height[0], 0.3195 + 0.022)


def test_feasible_bodies_stand_level_with_feet_under_their_hips(factory, designs):
    batch = factory.batch(designs)
    assert batch.feasible[0]
    for i in np.flatnonzero(batch.feasible):
        model, data = compiled(factory, designs[i], batch.stance_qpos[i])
        for leg in ("FL", "FR", "RL", "RR"):
            foot, thigh = data.site(f"{leg}_foot").xpos, data.body(f"{leg}_thigh").xpos
            assert foot[2] == pytest.approx(0.022, abs=1e-9)
            assert_allclose(foot[:2], thigh[:2], atol=1e-9)
            assert data.body(f"{leg}_calf").xpos[2] >= 0.03
            assert thigh[2] == pytest.approx(batch.hip_height[i])
        assert np.all(data.qpos[7:] >= batch.joint_lower[i])
        assert np.all(data.qpos[7:] <= batch.joint_upper[i])
        front, hind = designs[i, :2].sum(), designs[i, 2:].sum()
        assert batch.hip_height[i] - 0.022 == pytest.approx(0.75 * 0.213 * min(front, hind))


def test_bodies_whose_knee_would_be_under_the_floor_are_infeasible(factory):
    assert not factory.feasible([(1.4, 0.6, 0.6, 0.6), (0.6, 0.6, 1.4, 0.6)]).any()


def test_infeasible_share_is_the_one_that_the_readme_states(factory):
    n = 20_000
    designs = np.random.default_rng(0).uniform(0.6, 1.4, (n, 4))
    stance = factory.stance(designs)
    readme = Path(__file__).parents[2].joinpath("packages/morphgen/README.md").read_text()
    stated = float(re.search(r"([\d.]+) % of U\(0\.6, 1\.4\)", readme).group(1)) / 100
    assert 1 - stance.feasible.mean() == pytest.approx(stated, abs=3 * np.sqrt(stated / n))
    knees = forward_kinematics(factory.skeleton(designs), stance.joints).joint[:, :, 2, 2]
    low = (knees + stance.base_height[:, None] < 0.03).any(axis=1)
    assert np.array_equal(low, ~stance.feasible)


def test_forward_kinematics_agrees_with_mujoco_at_random_angles(factory, designs):
    rng = np.random.default_rng(3)
    for design in designs[:6]:
        angles = rng.uniform(-1, 1, (1, 4, 3))
        qpos = np.concatenate([[0, 0, 0, 1, 0, 0, 0], angles.ravel()])
        model, data = compiled(factory, design, qpos)
        poses = forward_kinematics(factory.skeleton(design), angles)
        for leg, name in enumerate(("FL", "FR", "RL", "RR")):
            for k, part in enumerate(("hip", "thigh", "calf", "foot")):
                body = data.body(f"{name}_{part}")
                assert_allclose(poses.joint[0, leg, k], body.xpos, atol=1e-12)
                assert_allclose(poses.com[0, leg, k], body.xipos, atol=1e-12)
                if k < 3:
                    assert_allclose(poses.rotation[0, leg, k], body.xmat.reshape(3, 3), atol=1e-12)


def test_static_torque_balances_mujocos_gravity_with_vertical_foot_forces(factory, designs):
    """M qacc = 0 has a solution with our joint torques and some upward foot forces, and only then."""
    for design in designs[:8]:
        batch = factory.batch(design)
        model, data = compiled(factory, design, batch.stance_qpos[0])
        body, stance = factory.skeleton(design), factory.stance(design)
        torque = static_torque(body, forward_kinematics(body, stance.joints))[0].ravel()
        residual = data.qfrc_bias - np.concatenate([np.zeros(6), torque])
        columns = []
        for foot in factory.layout.feet:
            jacobian = np.zeros((3, model.nv))
            mujoco.mj_jacSite(model, data, jacobian, None, data.site(foot).id)
            columns.append(jacobian[2])
        force, *_ = np.linalg.lstsq(np.stack(columns, axis=1), residual, rcond=None)
        assert_allclose(np.stack(columns, axis=1) @ force, residual, atol=1e-9)
        assert force.sum() == pytest.approx(batch.total_mass[0] * 9.81)
        assert force.min() > 0


def test_stance_is_held_for_three_seconds_on_feet_alone(factory):
    """Within 5 degrees of pitch and 10 % of sag; sampled bodies and the corners of the space."""
    corners = np.array(np.meshgrid(*[(0.6, 1.4)] * 4)).reshape(4, -1).T
    designs = np.vstack([corners, np.random.default_rng(5).uniform(0.6, 1.4, (80, 4))])
    batch = factory.batch(designs)
    batch = batch.take(np.flatnonzero(batch.feasible))
    sims = mujoco.batch.Batch(batch.model, batch.n, 1)
    for name, values in batch.fields.items():
        sims.expand(name)[:] = values
    sims.set_const()
    sims.bind("qpos")[:] = batch.stance_qpos
    sims.bind("ctrl")[:] = batch.stance_ctrl
    address = [batch.model.sensor(name).adr[0] for name in factory.layout.link_contact]
    feet = [batch.model.sensor(name).adr[0] for name in factory.layout.foot_contact]
    sensors, qpos = sims.bind("sensordata"), sims.bind("qpos")
    for _ in range(60):  # 3 s at 5 ms
        sims.step(nstep=10)
        w, x, y, z = qpos[:, 3:7].T
        pitch = np.degrees(np.arcsin(2 * (w * y - z * x)))
        sag = (batch.stance_qpos[:, 2] - qpos[:, 2]) / batch.hip_height
        assert np.abs(pitch).max() < 5
        assert sag.max() < 0.10
        assert sensors[:, address].max() == 0
    assert sensors[:, feet].min() == 1


def test_joints_that_turn_the_other_way_get_the_same_stance(factory, go2_tree, as_text, designs):
    """The axis convention of Lite3: -x, -y, -y, with limits negated."""
    for joint in go2_tree.findall("joint[@type='revolute']"):
        axis = joint.find("axis")
        axis.set("xyz", " ".join(str(-float(v)) for v in axis.get("xyz").split()))
        limit = joint.find("limit")
        lower, upper = float(limit.get("lower")), float(limit.get("upper"))
        limit.set("lower", str(-upper)), limit.set("upper", str(-lower))
    flipped = BodyFactory("flipped", as_text(go2_tree))
    one, other = factory.batch(designs), flipped.batch(designs)
    assert_allclose(other.stance_qpos[:, 7:], -one.stance_qpos[:, 7:], atol=1e-12)
    assert_allclose(other.stance_ctrl, -one.stance_ctrl, atol=1e-12)
    assert np.array_equal(one.feasible, other.feasible)
    assert one.feasible[0]
    assert flipped.layout.mirror_sign == factory.layout.mirror_sign
