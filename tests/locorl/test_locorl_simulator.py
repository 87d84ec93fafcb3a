"""CpuSimulator against one freshly compiled MjModel and MjData per robot."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from locorl import PhysicsConfig, flat_scene
from locorl.simulation.cpu import CpuSimulator
from locorl_box import BoxQuadruped

PHYSICS = PhysicsConfig()


@pytest.fixture
def sim(factory, designs) -> CpuSimulator:
    bodies = factory.batch(designs, flat_scene(PHYSICS))
    sim = CpuSimulator(bodies, PHYSICS.substeps, threads=1)
    sim.set_state(torch.arange(8), torch.from_numpy(bodies.stance_qpos), torch.zeros(8, 18))
    return sim


def targets(sim: CpuSimulator, steps: int) -> np.ndarray:
    """Wild servo targets around the stance, (steps, N, 12)."""
    noise = np.random.default_rng(3).normal(0.0, 0.5, (steps, *sim.ctrl.shape))
    return sim.qpos[:, 7:].numpy() + noise


def compiled(factory: BoxQuadruped, designs: np.ndarray, sim: CpuSimulator) -> list[mujoco.MjData]:
    models = [factory.compiled(design, flat_scene(PHYSICS)) for design in designs]
    data = [mujoco.MjData(model) for model in models]
    for i, one in enumerate(data):
        one.qpos[:] = sim.qpos[i].numpy()
    return data


def test_every_body_moves_as_its_own_compiled_model(factory, designs, sim):
    data = compiled(factory, designs, sim)
    contacts = np.zeros(8, dtype=int)
    for ctrl in targets(sim, 50):
        sim.ctrl[:] = torch.from_numpy(ctrl)
        sim.step()
        for i, one in enumerate(data):
            one.ctrl[:] = ctrl[i]
            mujoco.mj_step(one.model, one, nstep=PHYSICS.substeps)
            contacts[i] += one.ncon
    assert (contacts > 50).all()  # they did touch the ground
    np.testing.assert_allclose(sim.qpos.numpy(), [one.qpos for one in data], atol=1e-9)
    np.testing.assert_allclose(sim.qvel.numpy(), [one.qvel for one in data], atol=1e-8)
    np.testing.assert_allclose(sim.torque.numpy(), [one.actuator_force for one in data], atol=1e-7)
    np.testing.assert_allclose(sim.sensors.numpy(), [one.sensordata for one in data], atol=1e-7)
    # and the bodies do differ from each other
    assert np.ptp(sim.qpos[:, 2].numpy()) > 0.01


def test_the_batch_steps_each_model_to_the_bit(sim):
    single = [(sim.model_of(i), sim.data_of(i)) for i in range(8)]
    for ctrl in targets(sim, 20):
        sim.ctrl[:] = torch.from_numpy(ctrl)
        sim.step()
        for i, (model, data) in enumerate(single):
            data.ctrl[:] = ctrl[i]
            mujoco.mj_step(model, data, nstep=PHYSICS.substeps)
    np.testing.assert_array_equal(sim.qpos.numpy(), [data.qpos for _, data in single])
    np.testing.assert_array_equal(sim.qvel.numpy(), [data.qvel for _, data in single])
    np.testing.assert_array_equal(sim.sensors.numpy(), [data.sensordata for _, data in single])


def test_positive_work_is_summed_at_every_physics_step(factory, designs, sim):
    data = compiled(factory, designs, sim)
    for ctrl in targets(sim, 20):
        expected = np.zeros(8)
        for i, one in enumerate(data):
            one.ctrl[:] = ctrl[i]
            for _ in range(PHYSICS.substeps):
                mujoco.mj_forward(one.model, one)
                # generalised actuator force: another route to the joint torque than `actuator_force`
                power = one.qfrc_actuator[6:] * one.qvel[6:]
                expected[i] += power[power > 0].sum() * one.model.opt.timestep
                mujoco.mj_step(one.model, one)
        sim.ctrl[:] = torch.from_numpy(ctrl)
        sim.step()
        np.testing.assert_allclose(sim.positive_work.numpy(), expected, rtol=1e-6)
        assert (expected > 0).all()


def test_sensor_slice(sim):
    data = mujoco.MjData(sim.model)
    mujoco.mj_forward(sim.model, data)
    gyro = sim.sensor_slice("imu_gyro")
    assert gyro.stop - gyro.start == 3
    data.sensordata[gyro] = (1.0, 2.0, 3.0)
    assert data.sensor("imu_gyro").data.tolist() == [1.0, 2.0, 3.0]
    with pytest.raises(KeyError, match=r"no sensor 'nose'.*FL_foot_contact"):
        sim.sensor_slice("nose")


def test_set_state_touches_only_its_robots_and_forgets_warm_starts(factory, designs, sim):
    ctrl = torch.from_numpy(targets(sim, 1)[0])
    start = sim.qpos.clone()
    for _ in range(10):
        sim.ctrl[:] = ctrl
        sim.step()
    others = sim.qpos[[0, 2, 3, 4, 5, 6]].clone()
    ids = torch.tensor([7, 1])
    sim.set_state(ids, start[ids], torch.zeros(2, 18))
    assert torch.equal(sim.qpos[ids], start[ids])
    assert torch.equal(sim.qpos[[0, 2, 3, 4, 5, 6]], others)
    sim.ctrl[:] = ctrl
    sim.step()
    for i in ids.tolist():  # as if it had never moved before
        model = factory.compiled(designs[i], flat_scene(PHYSICS))
        one = mujoco.MjData(model)
        one.qpos[:], one.ctrl[:] = start[i].numpy(), ctrl[i].numpy()
        mujoco.mj_step(model, one, nstep=PHYSICS.substeps)
        np.testing.assert_allclose(sim.qpos[i].numpy(), one.qpos, atol=1e-12)


@pytest.mark.parametrize("poison", [1e20, float("nan")])
def test_a_failing_simulation_is_flagged_each_time_and_harms_no_other(sim, poison, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo logs the failure into the working folder
    start = sim.qpos.clone()
    for _ in range(3):
        sim.qvel[3] = poison
        sim.step()
        assert sim.diverged.tolist() == [False, False, False, True, False, False, False, False]
        assert sim.positive_work.isfinite().all()
        sim.set_state(torch.tensor([3]), start[3:4], torch.zeros(1, 18))
    sim.step()
    assert not sim.diverged.any()


def test_centre_of_mass_is_the_mass_weighted_mean_of_the_links(factory, designs, sim):
    for i, centre in enumerate(sim.centre_of_mass().numpy()):
        model = factory.compiled(designs[i], flat_scene(PHYSICS))
        data = mujoco.MjData(model)
        data.qpos[:] = sim.qpos[i].numpy()
        mujoco.mj_forward(model, data)
        mean = (model.body_mass[1:, None] * data.xipos[1:]).sum(axis=0) / model.body_mass[1:].sum()
        np.testing.assert_allclose(centre, mean - data.body("base").xpos, atol=1e-12)


@pytest.mark.parametrize(("memory", "full"), [(30_000, ("contacts", "constraints")), (60_000, ("constraints",))])
def test_a_full_arena_is_counted_by_robot_and_control_period(factory, designs, memory, full, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo logs the warning into the working folder
    scene = flat_scene(PHYSICS)
    scene.memory = memory
    bodies = factory.batch(designs[:3], scene)
    sim = CpuSimulator(bodies, PHYSICS.substeps, threads=1)
    qpos = torch.from_numpy(bodies.stance_qpos.copy())
    qpos[:2, 2] = 0.02  # two robots lie in the floor, one hangs in the air
    qpos[2, 2] = 1.0
    sim.set_state(torch.arange(3), qpos, torch.zeros(3, 18))
    for periods in (1, 2):
        sim.step()
        assert sim.overflows["constraints"] == 2 * periods
        assert (sim.overflows["contacts"] > 0) == ("contacts" in full)
    assert sim.diverged.tolist() == [False] * 3
    sim.set_state(torch.arange(3), qpos + torch.tensor([0, 0, 1.0, *[0] * 16]), torch.zeros(3, 18))
    sim.step()
    assert sim.overflows["constraints"] == 4  # in the air nothing new


def test_threads_do_not_change_the_bits(factory, designs, sim):
    bodies = factory.batch(designs, flat_scene(PHYSICS))
    one, other = (CpuSimulator(bodies, PHYSICS.substeps, threads=threads) for threads in (1, 3))
    plan = targets(sim, 10)
    for each in (one, other):
        each.set_state(torch.arange(8), torch.from_numpy(bodies.stance_qpos), torch.zeros(8, 18))
        for ctrl in plan:
            each.ctrl[:] = torch.from_numpy(ctrl)
            each.step()
    assert torch.equal(one.qvel, other.qvel)
