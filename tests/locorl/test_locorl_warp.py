"""WarpSimulator on Warp's CPU device against CpuSimulator: 16 very different bodies, plane and boxes."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
import torch
from locorl import PhysicsConfig, flat_scene, sample_designs
from locorl.simulation.cpu import CpuSimulator
from locorl.simulation.make import SimulatorConfig, make_simulator
from locorl.simulation.simulator import Simulator
from locorl_box import BoxQuadruped

pytest.importorskip("mujoco_warp")
pytestmark = pytest.mark.slow

N = 16
Pair = tuple[CpuSimulator, Simulator]


def add_boxes(scene: mujoco.MjSpec) -> None:
    """Thirty turned boxes around the origin, 1 to 8 cm high."""
    rng = np.random.default_rng(1)
    for _ in range(30):
        angle, height = rng.uniform(0, np.pi), rng.uniform(0.01, 0.08)
        scene.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[rng.uniform(-0.6, 0.6), rng.uniform(-0.5, 0.5), 0],
            size=[0.1, 0.15, height],
            quat=[np.cos(angle), 0, 0, np.sin(angle)],
            contype=0,
            conaffinity=1,
        )


@pytest.fixture(params=["plane", "boxes"])
def pair(request, factory: BoxQuadruped) -> Callable[..., Pair]:
    """The two simulators with a converged solver, robots in contact and moving."""

    def make(substeps: int = 1, elliptic: bool = True) -> Pair:
        scene = flat_scene(PhysicsConfig(solver_iterations=50, linesearch_iterations=50, elliptic_cone=elliptic))
        if request.param == "boxes":
            add_boxes(scene)
        bodies = factory.batch(sample_designs(factory, N, np.random.default_rng(5)), scene)
        qpos = torch.from_numpy(bodies.stance_qpos.copy())
        qpos[:, 2] += 0.03 if request.param == "boxes" else -0.003
        qvel = 0.2 * torch.randn(N, 18, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
        sims = []
        for backend in ("cpu", "warp"):
            sim = make_simulator(SimulatorConfig(backend, contacts=80), bodies, substeps, factory.layout.feet)
            sim.set_state(torch.arange(N), qpos, qvel)
            sim.ctrl[:] = torch.from_numpy(bodies.stance_ctrl)
            sims.append(sim)
        assert isinstance(sims[0], CpuSimulator)
        return sims[0], sims[1]

    return make


def difference(one: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
    """Norm of the difference of each row over the norm of the row, (N,)."""
    one, other = one.double().flatten(1), other.double().flatten(1)
    return (one - other).norm(dim=1) / one.norm(dim=1)


@pytest.mark.parametrize("elliptic", [True, False])
def test_one_step_agrees(pair, elliptic):
    cpu, warp = pair(elliptic=elliptic)
    centre = cpu.ctrl.clone()
    generator = torch.Generator().manual_seed(1)
    errors, contacts = [], 0
    for _ in range(20):  # from 20 states of a wild run
        warp.set_state(torch.arange(N), cpu.qpos, cpu.qvel)
        for sim in (cpu, warp):
            sim.ctrl[:] = centre + 0.2 * torch.randn(N, 12, generator=generator.manual_seed(len(errors)))
            sim.step()
        contacts += sum(cpu.data_of(i).ncon for i in range(N))
        errors.append(difference(cpu.qvel, warp.qvel))
        torch.testing.assert_close(warp.torque.double(), cpu.torque, rtol=1e-4, atol=1e-3)
        torch.testing.assert_close(warp.foot_position.double(), cpu.foot_position, rtol=0, atol=1e-5)
        torch.testing.assert_close(warp.positive_work.double(), cpu.positive_work, rtol=1e-4, atol=1e-4)
    assert contacts > 20 * N
    assert torch.stack(errors).max() < 1e-4


def test_fifty_contact_steps_agree(pair):
    cpu, warp = pair()
    centre, generator = cpu.ctrl.clone(), torch.Generator()
    for k in range(50):
        for sim in (cpu, warp):
            sim.ctrl[:] = centre + 0.2 * torch.randn(N, 12, generator=generator.manual_seed(k))
            sim.step()
    apart = (cpu.qpos[:, :3] - warp.qpos[:, :3]).norm(dim=1)
    assert apart.median() < 2e-3
    assert set(warp.overflows.values()) == {0}
    assert not warp.diverged.any()


def test_sensors_agree(pair, factory):
    cpu, warp = pair()
    for sim in (cpu, warp):
        for _ in range(3):
            sim.step()
    layout = factory.layout
    for name in (*layout.foot_contact, *layout.link_contact, "imu_gyro"):
        columns = cpu.sensor_slice(name)
        assert columns == warp.sensor_slice(name)
        # counts, forces of tens of newtons, rates
        torch.testing.assert_close(
            warp.sensors[:, columns].double(), cpu.sensors[:, columns], rtol=1e-3, atol=2e-2, msg=name
        )
    feet = [cpu.sensor_slice(name).start for name in layout.foot_contact]
    assert (cpu.sensors[:, feet] > 0).any()


def test_centre_of_mass_agrees(pair):
    cpu, warp = pair()
    torch.testing.assert_close(warp.centre_of_mass().double(), cpu.centre_of_mass(), rtol=0, atol=1e-6)


def test_state_of_one_simulator_continues_in_data_of_the_other(pair):
    cpu, warp = pair()
    for _ in range(5):
        warp.step()
    for i in (0, 9):
        model, data = warp.model_of(i), warp.data_of(i)
        mujoco.mj_step(model, data)
        before = warp.qvel[i].clone()
        cpu.set_state(torch.arange(N), warp.qpos, warp.qvel)
        cpu.ctrl[:] = warp.ctrl
        cpu.step()
        np.testing.assert_allclose(data.qvel, cpu.qvel[i].numpy(), atol=1e-3)
        assert torch.equal(warp.qvel[i], before)


def test_derived_constants_reach_warp(factory):
    """Against models that MuJoCo compiles for each body."""
    designs = sample_designs(factory, N, np.random.default_rng(5))
    scene = flat_scene(PhysicsConfig())
    sim = make_simulator(SimulatorConfig("warp"), factory.batch(designs, scene), 1)
    models = [factory.compiled(design, scene) for design in designs]
    names = ("body_mass", "body_inertia", "body_pos", "body_ipos", "geom_size", "geom_pos", "site_pos")
    derived = ("body_subtreemass", "body_invweight0", "dof_invweight0", "geom_rbound", "geom_aabb", "actuator_acc0")
    for name in (*names, *derived):
        expected = np.stack([getattr(model, name) for model in models])
        ours = getattr(sim._model, name).numpy().reshape(expected.shape)
        np.testing.assert_allclose(ours, expected, rtol=1e-6, atol=1e-7, err_msg=name)
        assert np.ptp(ours, axis=0).max() > 0, name


def test_lost_contacts_are_counted_and_explained(factory, designs):
    bodies = factory.batch(designs, flat_scene(PhysicsConfig()))
    sim = make_simulator(SimulatorConfig("warp", contacts=1), bodies, 2)
    qpos = torch.from_numpy(bodies.stance_qpos.copy())
    qpos[:, 2] -= 0.002
    sim.set_state(torch.arange(8), qpos, torch.zeros(8, 18))
    sim.ctrl[:] = torch.from_numpy(bodies.stance_ctrl)
    sim.step()
    with pytest.warns(RuntimeWarning, match=r"raise SimulatorConfig.contacts \(now 1 per robot\)"):
        # the contacts share one buffer, so that every robot may have lost some
        assert sim.overflows["contacts"] == 8
    sim.step()
    with pytest.warns(RuntimeWarning):
        assert sim.overflows["contacts"] == 16


def test_one_robot_with_many_contacts_is_counted_alone(factory, designs):
    bodies = factory.batch(designs, flat_scene(PhysicsConfig()))
    sim = make_simulator(SimulatorConfig("warp", contacts=10), bodies, 1)
    qpos = torch.from_numpy(bodies.stance_qpos.copy())
    qpos[:, 2] = 2.0
    qpos[5, 2] = 0.0  # its 13 boxes and 4 feet are in the floor, the others hang in the air
    sim.set_state(torch.arange(8), qpos, torch.zeros(8, 18))
    sim.step()
    with pytest.warns(RuntimeWarning, match="constraints"):
        assert sim.overflows == {"contacts": 0, "constraints": 1, "contact_sensors": 0}


def test_what_warp_cannot_vary_is_refused(factory, designs):
    bodies = factory.batch(designs, flat_scene(PhysicsConfig()))
    fields = {"geom_condim": np.full((8, bodies.model.ngeom), 3)}
    with pytest.raises(ValueError, match=r"geom_condim.*cannot differ"):
        make_simulator(SimulatorConfig("warp"), bodies, 1, extra_fields=fields)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_missing_gpu_is_explained(factory, designs):
    with pytest.raises(ValueError, match=r"'cuda'.*must both see a CUDA GPU"):
        make_simulator(SimulatorConfig("warp", device="cuda"), factory.batch(designs), 1)
