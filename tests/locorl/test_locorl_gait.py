"""Gait: lifts, slides and standing of the feet, from sequences by hand and from a robot on ice."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from locorl import LeggedEnv, TaskConfig, no_randomisation
from locorl.evaluation.gait import Gait, GaitMeter, sole_height
from locorl.evaluation.legs import Legs

SOLE = 0.02


def measure(height, touching, way=0.05, x=None, ground=None, counted=None, rate=0.0) -> Gait:
    """Gait of one robot whose first foot does as told, (T,) each, while the other three stand still."""
    steps = len(height)
    feet, down = np.zeros((steps, 1, 4, 3)), np.ones((steps, 1, 4), dtype=bool)
    feet[..., 2] = SOLE
    feet[:, 0, 0, 2], down[:, 0, 0] = height, np.array(touching, dtype=bool)
    if x is not None:
        feet[:, 0, 0, 0] = x
    floor = np.zeros((steps, 1, 4))
    floor[:, 0, 0] = 0.0 if ground is None else ground
    counted = np.ones(steps, dtype=bool) if counted is None else np.array(counted, dtype=bool)
    meter = GaitMeter(torch.full((1, 4), SOLE), dt=0.02)
    turning = torch.zeros(1, 4, 3)
    turning[0, 0, 1] = rate
    for t in range(steps):
        place, *rest = (torch.from_numpy(values[t]) for values in (feet, floor, down))
        meter.add(place, turning, *rest, torch.tensor([way]), torch.from_numpy(counted[t : t + 1]))
    return meter.gait()


def test_swings_slides_and_stance_by_hand():
    gait = measure(
        #        stands, swings to 0.08,  stands, flickers, stands, swings over a bump of 0.03, stands
        height=[0.02, 0.05, 0.08, 0.06, 0.02, 0.50, 0.02, 0.10, 0.09, 0.02],
        ground=[0.00, 0.00, 0.00, 0.00, 0.00, 0.00, 0.00, 0.03, 0.03, 0.00],
        touching=[1, 0, 0, 0, 1, 0, 1, 0, 0, 1],
        # slides only count from one standing step to the next, of which there are none
        x=np.arange(10) * 0.1,
    )
    assert gait.clearance == pytest.approx([(0.06 + 0.05) / 2])
    assert gait.duty_factor == pytest.approx([(0.4 + 3) / 4])
    assert gait.slip == [0.0]


def test_slip_is_the_slide_of_standing_feet_over_the_way():
    gait = measure(height=[SOLE] * 6, touching=[1, 1, 1, 0, 1, 1], x=[0.0, 0.01, 0.03, 0.5, 0.6, 0.604])
    # 10 + 20 + 4 mm of one foot of four, on five steps of 50 mm
    assert gait.slip == pytest.approx([0.034 / 4 / 0.25])


@pytest.mark.parametrize(
    ("touching", "counted"),
    [
        ([0, 0, 0, 1, 1, 1], [1] * 6),  # no lift-off seen
        ([1, 1, 0, 0, 0, 0], [1] * 6),  # no touch-down seen
        ([1, 0, 0, 0, 0, 1], [1, 1, 0, 1, 1, 1]),  # not counted throughout
        ([1, 0, 0, 1, 1, 1], [1, 1, 1, 0, 1, 1]),  # touch-down does not count
    ],
)
def test_half_seen_swings_do_not_count(touching, counted):
    assert measure(height=[0.3] * 6, touching=touching, counted=counted).clearance == [0.0]


def test_what_is_left_out_counts_for_nothing():
    # between the third and the fifth step the robot is put elsewhere
    gait = measure(height=[SOLE] * 6, touching=[1] * 6, x=[0, 0.1, 0.2, 9, 5, 5.1], counted=[1, 1, 1, 0, 1, 1])
    assert gait.slip == pytest.approx([0.3 / 4 / 0.15])
    assert gait.duty_factor == [1.0]


def test_who_gets_nowhere_has_no_slip_per_metre():
    gait = measure(height=[SOLE] * 4, touching=[1] * 4, x=[0, 0.1, 0.2, 0.3], way=0.0)
    assert gait.slip == [np.inf]


@given(speed=st.floats(0.05, 5.0), heading=st.floats(-np.pi, np.pi), dt=st.floats(0.005, 0.05))
def test_a_robot_dragged_on_all_feet_slips_one_metre_per_metre(speed, heading, dt):
    meter, still = GaitMeter(torch.full((3, 4), SOLE), dt), torch.zeros(3, 4, 3)
    way = torch.tensor([np.cos(heading), np.sin(heading), 0.0], dtype=torch.float64)
    for t in range(40):
        feet = torch.tensor([0.0, 0.0, SOLE]) + t * dt * speed * way + torch.zeros(3, 4, 3)
        everyone = torch.ones(3, dtype=torch.bool)
        meter.add(feet, still, torch.zeros(3, 4), torch.ones(3, 4, dtype=torch.bool), everyone * speed * dt, everyone)
    gait = meter.gait()
    expected = 1.0 if 39 * dt * speed > 0.05 else np.inf
    np.testing.assert_allclose(gait.slip, expected, rtol=1e-6)
    np.testing.assert_array_equal(gait.duty_factor, 1.0)
    np.testing.assert_array_equal(gait.clearance, 0.0)


def test_a_robot_that_slides_over_ice(factory, designs):
    ice = replace(no_randomisation(), friction=(1e-4, 1e-4))
    env = LeggedEnv(factory, designs, replace(TaskConfig(), randomisation=ice), threads=1)
    sole = sole_height(env)
    np.testing.assert_allclose(sole, 0.02, atol=1e-9)  # the radius of the box quadruped's feet
    env.reset()
    env.sim.qvel[:, 0] = 0.5
    meter, everyone = GaitMeter(sole, env.dt), torch.ones(8, dtype=torch.bool)
    legs = Legs(env.sim.model, factory.layout.joints)
    standing = True
    for t in range(25):
        *_, terminated, _, info = env.step(torch.zeros(8, 12))
        assert not terminated.any()
        feet = env.sim.foot_position
        if t >= 10:  # the feet have settled
            standing &= bool(env.contacts.touching.all())
            # the way is what the robot was set in motion with
            rate = legs.foot_rate(env.sim.qpos, env.sim.qvel)
            meter.add(feet, rate, torch.zeros(8, 4), env.contacts.touching, torch.full((8,), 0.5 * env.dt), everyone)
    assert standing
    gait = meter.gait()
    np.testing.assert_allclose(gait.slip, 1.0, atol=0.02)
    np.testing.assert_array_equal(gait.duty_factor, 1.0)
    np.testing.assert_array_equal(gait.clearance, 0.0)


def test_a_foot_that_rolls_does_not_slide():
    # 1.5 rad/s on a radius of 20 mm is 30 mm/s, 0.6 mm in a step
    rolling = 0.0006 * np.arange(10)
    gait = measure(height=[SOLE] * 10, touching=[1] * 10, x=rolling, rate=1.5)
    assert gait.slip == pytest.approx([0.0], abs=1e-9)
    # braked: the sole goes back as fast as the centre would have rolled
    gait = measure(height=[SOLE] * 10, touching=[1] * 10, x=0 * rolling, rate=1.5)
    assert gait.slip == pytest.approx([0.0006 / 4 / 0.05])


def test_feet_turn_as_mujoco_says(factory, designs):
    env = LeggedEnv(factory, designs, TaskConfig(), threads=1)
    rng = np.random.default_rng(0)
    quat = rng.normal(size=(8, 4))
    qpos = np.concatenate(
        (rng.normal(size=(8, 3)), quat / np.linalg.norm(quat, axis=1, keepdims=True), rng.uniform(-2, 2, (8, 12))),
        axis=1,
    )
    qvel = rng.normal(size=(8, 18))
    rate = Legs(env.sim.model, factory.layout.joints).foot_rate(torch.from_numpy(qpos), torch.from_numpy(qvel))
    for i, design in enumerate(designs):
        model = factory.compiled(design)
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = qpos[i], qvel[i]
        mujoco.mj_forward(model, data)
        for foot, name in enumerate(factory.layout.feet):
            theirs = np.zeros(6)
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, model.site(name).id, theirs, 0)
            np.testing.assert_allclose(rate[i, foot], theirs[:3], atol=1e-9)


def test_links_may_be_mounted_at_an_angle():
    xml = """<mujoco><worldbody><body pos="0 0 1"><freejoint/><geom size="0.1"/>
      <body euler="10 20 30"><joint name="a" axis="1 1 0" ref="20"/><geom size="0.1"/>
        <body euler="-40 5 0"><joint name="b" axis="0 1 1"/><geom size="0.1"/><site name="foot" euler="1 2 3"/></body>
      </body></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    data.qpos[3:7] = (0.5, 0.5, 0.5, 0.5)
    data.qpos[7:], data.qvel[:] = rng.normal(size=2), rng.normal(size=8)
    mujoco.mj_forward(model, data)
    theirs = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, model.site("foot").id, theirs, 0)
    state = (torch.from_numpy(values.copy())[None] for values in (data.qpos, data.qvel))
    np.testing.assert_allclose(Legs(model, ("a", "b"), legs=1).foot_rate(*state)[0, 0], theirs[:3], atol=1e-9)
