"""The same environment code on both simulators."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from locorl import LeggedEnv, PhysicsConfig, SimulatorConfig, make_task, no_randomisation

pytest.importorskip("mujoco_warp")
pytestmark = pytest.mark.slow

CONVERGED = PhysicsConfig(timestep=0.005, substeps=4, solver_iterations=20, linesearch_iterations=40)


@pytest.mark.parametrize("name", ["locomotion-flat", "parkour-highjump"])
def test_observations_and_rewards_agree(factory, designs, name):
    task = replace(make_task(name, "paper"), physics=CONVERGED, randomisation=no_randomisation())
    cpu, warp = (LeggedEnv(factory, designs, task, simulator=SimulatorConfig(backend)) for backend in ("cpu", "warp"))
    for env in (cpu, warp):
        env.reset(seed=0)
        env.sim.qpos[:, 2] += 0.01  # whether feet at a distance of exactly 0 touch is a matter of rounding
    generator = torch.Generator().manual_seed(0)
    for _ in range(12):
        action = 0.3 * torch.randn(8, 12, generator=generator)
        ours, reward, terminated, _, info = cpu.step(action)
        theirs, expected, fallen, _, other = warp.step(action)
        assert torch.equal(terminated, fallen)
        assert {name: round(value.item(), 5) for name, value in info.reward_terms.items()} == {
            name: pytest.approx(value.item(), abs=2e-5) for name, value in other.reward_terms.items()
        }
    for group, values in ours.items():
        np.testing.assert_allclose(values, theirs[group], atol=1e-3, err_msg=group)
    np.testing.assert_allclose(reward, expected, atol=1e-4)
    np.testing.assert_allclose(info.position, other.position, atol=1e-3)
    np.testing.assert_allclose(info.positive_work, other.positive_work, rtol=1e-3, atol=1e-4)


def test_bodies_change_in_place_and_robots_restart(factory, designs):
    task = replace(make_task("locomotion-flat"), randomisation=no_randomisation(), episode_seconds=0.1)
    env = LeggedEnv(factory, designs, task, simulator=SimulatorConfig("warp"))
    env.reset(seed=0)
    for t in range(1, 6):
        _, _, _, truncated, _ = env.step(torch.zeros(8, 12))
        assert truncated.all() == (t == 5)
    np.testing.assert_allclose(env.sim.qpos[:, 2], env.stance_qpos[:, 2], atol=1e-5)
    others = designs[::-1].copy()
    obs = env.set_designs(others)
    new = LeggedEnv(factory, others, task)
    np.testing.assert_allclose(obs["implicit"], new.reset(seed=0)["implicit"], atol=1e-4)
    for _ in range(3):
        obs, *_ = env.step(torch.zeros(8, 12))
    assert all(values.isfinite().all() for values in obs.values())


def test_a_failed_world_is_restarted_and_counted(factory, designs):
    task = replace(make_task("locomotion-flat"), randomisation=no_randomisation())
    env = LeggedEnv(factory, designs, task, simulator=SimulatorConfig("warp"))
    env.reset(seed=0)
    env.sim.qvel[3] = float("nan")
    obs, reward, terminated, _, info = env.step(torch.zeros(8, 12))
    assert info.diverged.tolist() == terminated.tolist() == [False] * 3 + [True] + [False] * 4
    assert all(values.isfinite().all() for values in obs.values())
    assert reward.isfinite().all()
    (failure,) = env.failures.by_body()
    np.testing.assert_array_equal(failure.design, designs[3])
