"""What every simulator must do, on each of them; Warp runs on its CPU device."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import torch
from locorl import PhysicsConfig, flat_scene
from locorl.simulation.make import SimulatorConfig, find_device, make_simulator
from locorl.simulation.simulator import Simulator
from locorl_box import Bodies

PHYSICS = PhysicsConfig()
SHOWN = ("qpos", "qvel", "torque", "sensors", "foot_position", "positive_work")
DERIVED = ("body_subtreemass", "body_invweight0", "dof_invweight0", "geom_rbound", "geom_aabb", "actuator_acc0")


@pytest.fixture(params=["cpu", pytest.param("warp", marks=pytest.mark.slow)])
def config(request) -> SimulatorConfig:
    if request.param == "warp":
        pytest.importorskip("mujoco_warp")
    return SimulatorConfig(request.param)


@pytest.fixture(scope="module")
def batch(factory):
    """Bodies on the floor, compiled once for each set of designs."""
    known = {}

    def bodies(designs: np.ndarray) -> Bodies:
        key = designs.tobytes()
        if key not in known:
            known[key] = factory.batch(designs, flat_scene(PHYSICS))
        return known[key]

    return bodies


@pytest.fixture
def make(factory, batch, designs, config) -> Callable[..., Simulator]:
    """Simulators of the eight designs in their stance, 2 mm deep in the floor."""

    def build(designs=designs, substeps=PHYSICS.substeps, extra_fields=None, config=config) -> Simulator:
        bodies = batch(designs)
        sim = make_simulator(config, bodies, substeps, factory.layout.feet, extra_fields)
        sim.set_state(torch.arange(sim.num_envs), stance(bodies), torch.zeros(sim.num_envs, 18))
        sim.ctrl[:] = torch.from_numpy(bodies.stance_ctrl)
        return sim

    return build


def stance(bodies) -> torch.Tensor:
    qpos = torch.from_numpy(bodies.stance_qpos.copy())
    qpos[:, 2] -= 0.002
    return qpos


def run(sim: Simulator, steps: int, seed: int = 0) -> None:
    """Follow wild targets around the present ones."""
    generator, centre = torch.Generator().manual_seed(seed), sim.ctrl.clone()
    for _ in range(steps):
        sim.ctrl[:] = centre + 0.2 * torch.randn(sim.ctrl.shape, generator=generator)
        sim.step()


def same(one: Simulator, other: Simulator) -> None:
    for name in SHOWN:
        assert torch.equal(getattr(one, name), getattr(other, name)), name


ARM = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast" jacobian="dense"/>
  <worldbody>
    <body gravcomp="1">
      <freejoint/>
      <geom size="1" mass="1e5" contype="0"/>
      <body>
        <joint name="joint" type="{joint}" axis="0 0 1"/>
        <inertial mass="2" pos="0 0 0" diaginertia="0.3 0.3 0.3"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="joint"/></actuator>
</mujoco>
"""


def work_of(config: SimulatorConfig, joint: str, force: float, speed: float, steps: int) -> float:
    """Positive work of a motor of constant force on a heavy base that does not fall."""
    model = mujoco.MjModel.from_xml_string(ARM.format(joint=joint))
    sim = make_simulator(config, SimpleNamespace(designs=np.zeros((1, 0)), model=model, fields={}), substeps=5)
    qvel = torch.zeros(1, 7)
    qvel[0, 6] = speed
    sim.set_state(torch.arange(1), torch.from_numpy(model.qpos0)[None], qvel)
    sim.ctrl[:] = force
    total = 0.0
    for _ in range(steps // 5):
        sim.step()
        total += float(sim.positive_work[0])
    return total


def test_lifting_a_load_at_constant_speed_takes_its_potential_energy(config):
    weight, speed, steps = 2 * 9.81, 0.5, 100
    assert work_of(config, "slide", weight, speed, steps) == pytest.approx(weight * speed * steps * 0.002, rel=1e-3)


def test_lowering_a_load_counts_no_work(config):
    assert work_of(config, "slide", 2 * 9.81, -0.5, 100) == 0.0


def test_spinning_up_a_flywheel_takes_its_kinetic_energy(config):
    torque, inertia, steps = 1.5, 0.3, 400
    rate = torque / inertia * steps * 0.002
    # the rates at the start of the steps lag by half a step: 1/steps of the energy
    assert work_of(config, "hinge", torque, 0.0, steps) == pytest.approx(inertia * rate**2 / 2, rel=1.5 / steps)


def test_equal_inputs_give_equal_bits(make):
    one, other = make(), make()
    for sim in (one, other):
        run(sim, 10)
    same(one, other)


@pytest.mark.parametrize("poison", [float("nan"), 1e20])
def test_a_diverged_world_disturbs_no_other_and_recovers(make, poison, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo logs the failure into the working folder
    sim, healthy = make(), make()
    start, ctrl = sim.qpos.clone(), sim.ctrl.clone()
    run(sim, 3)
    run(healthy, 3)
    sim.qvel[3] = poison
    sim.ctrl[:] = healthy.ctrl[:] = ctrl
    for each in (sim, healthy):
        each.step()
    assert sim.diverged.tolist() == [i == 3 for i in range(8)]
    assert not healthy.diverged.any()
    assert sim.positive_work[3] == 0.0
    others = torch.tensor([0, 1, 2, 4, 5, 6, 7])
    for name in SHOWN:
        assert torch.equal(getattr(sim, name)[others], getattr(healthy, name)[others]), name
        assert getattr(sim, name).isfinite().all(), name
    ids = torch.tensor([3])
    for each in (sim, healthy):
        each.set_state(ids, start[ids], torch.zeros(1, 18))
        each.ctrl[:] = ctrl
        run(each, 3)
    assert not sim.diverged.any()
    same(sim, healthy)


def test_new_fields_in_place_equal_a_fresh_simulator(make, batch, designs):
    other = designs[::-1].copy()
    sim = make()
    run(sim, 5)
    before = sim.state_dict()
    sim.set_fields(batch(other).fields)
    friction = np.repeat(sim.model.geom_friction[None], 8, axis=0) * np.linspace(0.4, 1.6, 8)[:, None, None]
    run(sim, 1)  # a simulator that runs already takes a field that did not differ so far
    sim.load_state_dict(before)
    sim.set_fields({"geom_friction": friction})
    after = sim.state_dict()
    assert all(torch.equal(after[name], before[name]) for name in before)

    fresh = make(other, extra_fields={"geom_friction": friction})
    fresh.load_state_dict(before)
    for each in (sim, fresh):
        run(each, 10, seed=1)
    same(sim, fresh)
    assert torch.equal(sim.centre_of_mass(), fresh.centre_of_mass())


def test_bad_fields_are_refused_and_change_nothing(make):
    sim, untouched = make(), make()
    with pytest.raises(ValueError, match="geom_colour"):
        sim.set_fields({"body_mass": np.ones((8, sim.model.nbody)), "geom_colour": np.ones((8, 3))})
    with pytest.raises(ValueError, match=r"body_mass.*must have shape \(8, 14\), got \(7, 14\)"):
        sim.set_fields({"body_mass": np.ones((7, sim.model.nbody))})
    for each in (sim, untouched):
        run(each, 2)
    same(sim, untouched)


def test_a_saved_state_shows_and_continues_the_same(make):
    sim, other = make(), make()
    run(sim, 5)
    other.load_state_dict(sim.state_dict())
    for name in SHOWN[:-1]:
        assert torch.equal(getattr(sim, name), getattr(other, name)), name
    for each in (sim, other):
        run(each, 5)  # the targets so far are part of the state
    same(sim, other)


def test_a_state_of_other_robots_is_refused(make, designs):
    with pytest.raises(ValueError, match="another number of robots"):
        make(designs[:3]).load_state_dict(make().state_dict())


def test_set_state_forgets_the_past_of_its_robots_alone(make):
    sim, fresh = make(), make()
    start, ctrl = sim.qpos.clone(), sim.ctrl.clone()
    run(sim, 10)
    others = torch.tensor([0, 2, 3, 4, 5, 6])
    before = sim.qpos[others].clone()
    ids = torch.tensor([7, 1])
    sim.set_state(ids, start[ids], torch.zeros(2, 18))
    assert torch.equal(sim.qpos[ids], start[ids])
    assert torch.equal(sim.qpos[others], before)
    for each in (sim, fresh):
        each.ctrl[:] = ctrl
        each.step()
    for name in SHOWN:
        assert torch.equal(getattr(sim, name)[ids], getattr(fresh, name)[ids]), name


def test_model_of_is_the_compiled_body(make, factory, batch, designs):
    sim = make()
    for i in (0, 5):
        ours, compiled = sim.model_of(i), factory.compiled(designs[i], flat_scene(PHYSICS))
        for name in (*batch(designs).fields, *DERIVED):
            np.testing.assert_allclose(getattr(ours, name), getattr(compiled, name), atol=1e-10, err_msg=name)


def test_feet_are_where_the_sites_were_before_the_last_physics_step(make, factory):
    sim = make(substeps=1)
    run(sim, 5)
    data = [sim.data_of(i) for i in range(8)]
    for i, one in enumerate(data):
        np.testing.assert_array_equal(sim.qpos[i].numpy(), one.qpos.astype(sim.qpos.numpy().dtype))
    sim.step()
    expected = [[one.site(foot).xpos for foot in factory.layout.feet] for one in data]
    np.testing.assert_allclose(sim.foot_position.numpy(), expected, atol=1e-6)


def test_stepping_a_copy_leaves_the_simulation_alone(make):
    sim, untouched = make(), make()
    model, data = sim.model_of(2), sim.data_of(2)
    mujoco.mj_step(model, data, nstep=20)
    for each in (sim, untouched):
        run(each, 2)
    same(sim, untouched)


def test_an_unknown_foot_is_named(batch, designs, config):
    with pytest.raises(KeyError, match=r"no site 'toe'.*FL_foot"):
        make_simulator(config, batch(designs), 2, ("toe",))


def test_nothing_overflows_when_robots_lie_on_the_floor(make):
    sim = make()
    qpos = sim.qpos.clone()
    qpos[:, 2] = 0.05
    sim.set_state(torch.arange(8), qpos, torch.zeros(8, 18))
    run(sim, 10)
    assert set(sim.overflows.values()) == {0}


def test_bad_configurations_are_refused():
    with pytest.raises(ValueError, match="'cpu' or 'warp'"):
        SimulatorConfig("mjx")
    with pytest.raises(ValueError, match="take backend 'warp'"):
        SimulatorConfig(device="cuda")
    with pytest.raises(ValueError, match="at least 1"):
        SimulatorConfig(threads=0)


@pytest.mark.parametrize("device", ["cuda", "quantum"])
def test_a_device_that_is_not_there_is_named(device):
    if device == "cuda" and torch.cuda.is_available():
        pytest.skip("there is one")
    with pytest.raises(ValueError, match=f"no device '{device}' here"):
        find_device(SimulatorConfig("warp", device))


def test_missing_warp_is_explained(batch, designs, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco_warp", None)
    monkeypatch.delitem(sys.modules, "locorl.simulation.warp", raising=False)
    with pytest.raises(ModuleNotFoundError, match=r"pip install legged-locorl\[gpu\]"):
        make_simulator(SimulatorConfig("warp"), batch(designs), 2)
