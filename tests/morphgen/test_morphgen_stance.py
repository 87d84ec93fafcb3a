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


def test_bodies_stand_level_with_feet_under_their_hips_or_where_the_stance_says(factory, designs):
    batch, stance = factory.batch(designs), factory.stance(designs)
    assert batch.feasible.all()
    moved = np.abs(stance.foot_offset).max(axis=1) > 1e-9
    assert 0 < moved.sum() < 6
    for i in range(batch.n):
        model, data = compiled(factory, designs[i], batch.stance_qpos[i])
        front, hind = designs[i, :2].sum(), designs[i, 2:].sum()
        for leg, name in enumerate(("FL", "FR", "RL", "RR")):
            foot, thigh = data.site(f"{name}_foot").xpos, data.body(f"{name}_thigh").xpos
            assert foot[2] == pytest.approx(0.022, abs=1e-9)
            assert_allclose(foot[:2] - thigh[:2], (stance.foot_offset[i, leg], 0), atol=1e-9)
            assert data.body(f"{name}_calf").xpos[2] >= 0.03 - 1e-12
            assert thigh[2] == pytest.approx(batch.hip_height[i])
        assert np.all(data.qpos[7:] >= batch.joint_lower[i])
        assert np.all(data.qpos[7:] <= batch.joint_upper[i])
        if not moved[i]:
            assert batch.hip_height[i] - 0.022 == pytest.approx(0.75 * 0.213 * min(front, hind))


def knee_is_low_by_default(designs):
    """Whether the law of cosines puts a knee under 3 cm with the feet under the hips, (n,)."""
    thigh, shank = 0.213 * designs[:, [0, 2]], 0.213 * designs[:, [1, 3]]
    reach = 0.75 * (thigh + shank).min(axis=1, keepdims=True)
    below_hip = (thigh**2 + reach**2 - shank**2) / (2 * reach)
    return (reach + 0.022 - below_hip < 0.03).any(axis=1)


def test_shares_are_the_ones_that_the_readme_states(factory):
    """No body without a stance; those that do not stand by default are the ones whose knees would be low."""
    n = 20_000
    designs = np.random.default_rng(0).uniform(0.6, 1.4, (n, 4))
    stance = factory.stance(designs)
    assert stance.feasible.all()
    height = (stance.hip_height - 0.022) / (0.213 * np.minimum(designs[:, :2].sum(axis=1), designs[:, 2:].sum(axis=1)))
    offset = np.abs(stance.foot_offset).max(axis=1) > 1e-6
    other = offset | (np.abs(height - 0.75) > 1e-6)
    assert np.array_equal(other, knee_is_low_by_default(designs))
    readme = Path(__file__).parents[2].joinpath("packages/morphgen/README.md").read_text()
    found = re.search(r"([\d.]+) % of U\(0\.6, 1\.4\)\^4 .*? ([\d.]+) % with feet off", readme, re.DOTALL)
    for share, stated in zip((other.mean(), offset.mean()), found.groups(), strict=True):
        stated = float(stated) / 100
        assert share == pytest.approx(stated, abs=3 * np.sqrt(stated / n))


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


def assert_held(factory, designs):
    """3 s at `stance_ctrl`: tilt under 5 degrees, sag under 10 %, only and all feet touch."""
    batch = factory.batch(designs)
    assert batch.feasible.all()
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
        tilt = np.degrees(np.arccos(1 - 2 * (x**2 + y**2)))
        sag = (batch.stance_qpos[:, 2] - qpos[:, 2]) / batch.hip_height
        assert tilt.max() < 5
        assert sag.max() < 0.10
        assert sensors[:, address].max() == 0
    assert sensors[:, feet].min() == 1


def test_stance_is_held_for_three_seconds_on_feet_alone(factory):
    """Sampled bodies, the corners of the space, and bodies that do not stand by default."""
    corners = np.array(np.meshgrid(*[(0.6, 1.4)] * 4)).reshape(4, -1).T
    designs = np.random.default_rng(5).uniform(0.6, 1.4, (5000, 4))
    assert_held(factory, np.vstack([corners, designs[:60], designs[knee_is_low_by_default(designs)]]))


@pytest.mark.slow
def test_a_thousand_stances_and_all_unusual_ones_are_held(factory):
    designs = np.random.default_rng(6).uniform(0.6, 1.4, (60_000, 4))
    assert_held(factory, np.vstack([designs[:1000], designs[knee_is_low_by_default(designs)]]))


def test_joints_that_turn_the_other_way_get_the_same_stance(factory, go2_tree, as_text, designs):
    """The axis convention of Lite3: -x, -y, -y, with limits negated."""
    for joint in go2_tree.findall("joint[@type='revolute']"):
        axis = joint.find("axis")
        axis.set("xyz", " ".join(str(-float(v)) for v in axis.get("xyz").split()))
        limit = joint.find("limit")
        lower, upper = float(limit.get("lower")), float(limit.get("upper"))
        limit.set("lower", str(-upper)), limit.set("upper", str(-lower))
    flipped = BodyFactory("flipped", as_text(go2_tree), drive=factory.drive)
    one, other = factory.batch(designs), flipped.batch(designs)
    assert_allclose(other.stance_qpos[:, 7:], -one.stance_qpos[:, 7:], atol=1e-12)
    assert_allclose(other.stance_ctrl, -one.stance_ctrl, atol=1e-12)
    assert np.array_equal(one.feasible, other.feasible)
    assert one.feasible[0]
    assert flipped.layout.mirror_sign == factory.layout.mirror_sign
