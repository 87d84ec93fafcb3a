"""The motion of feet that the low-swing term looks at."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from locorl import LeggedEnv, TaskConfig
from locorl.env.randomisation import no_randomisation
from locorl.env.swing import Swing
from locorl.rewards.config import RewardConfig


def follow(places: list[tuple[float, float]], heights: list[float], standing: list[int]) -> list[tuple[float, float]]:
    """Speed and rise of one robot's first foot, step by step; the others stay where they are."""
    sim = SimpleNamespace(num_envs=1, device=torch.device("cpu"), foot_position=torch.zeros(1, 4, 3))
    swing = Swing(sim, dt=0.02)  # pyright: ignore[reportArgumentType]
    seen = []
    for place, height, stands in zip(places, heights, standing, strict=True):
        sim.foot_position[0, 0] = torch.tensor((*place, height))
        swing.update(torch.tensor([[bool(stands), True, True, True]]))
        assert swing.speed[0, 1:].tolist() == [0.0] * 3
        seen.append((swing.speed[0, 0].item(), swing.rise[0, 0].item()))
    return seen


def test_a_step_by_hand():
    # stands, swings 3 and 4 mm a step up to 5 cm, comes down on a ledge of 3 cm
    places = [(0.0, 0.0), (0.003, 0.004), (0.006, 0.008), (0.006, 0.008)]
    seen = follow(places, [0.02, 0.04, 0.07, 0.05], [1, 0, 0, 1])
    assert [speed for speed, _ in seen] == pytest.approx([0.0, 0.25, 0.25, 0.0])
    assert [rise for _, rise in seen] == pytest.approx([0.0, 0.02, 0.05, 0.0], abs=1e-7)


def test_a_foot_does_not_rise_before_it_has_stood():
    seen = follow([(0.0, 0.0)] * 4, [0.1, 0.2, 0.05, 0.08], [0, 0, 1, 0])
    assert [rise for _, rise in seen] == pytest.approx([0.0, 0.0, 0.0, 0.03], abs=1e-7)


def test_a_new_episode_is_no_leap():
    sim = SimpleNamespace(num_envs=2, device=torch.device("cpu"), foot_position=torch.zeros(2, 4, 3))
    swing = Swing(sim, dt=0.02)  # pyright: ignore[reportArgumentType]
    standing = torch.ones(2, 4, dtype=torch.bool)
    swing.update(standing)
    sim.foot_position += 0.1
    swing.reset(torch.tensor([1]))
    swing.update(~standing)
    torch.testing.assert_close(swing.speed, torch.tensor([[0.1 * 2**0.5 / 0.02], [0.0]]).expand(2, 4))
    torch.testing.assert_close(swing.rise, torch.tensor([[0.1], [0.0]]).expand(2, 4))


def test_sliding_costs_its_whole_speed(factory, designs):
    ice = replace(no_randomisation(), friction=(1e-4, 1e-4))
    reward = RewardConfig(low_swing=-1.0)
    env = LeggedEnv(factory, designs, replace(TaskConfig(), randomisation=ice, reward=reward), threads=1)
    env.reset()
    env.sim.qvel[:, 0] = 0.5
    for _ in range(25):
        *_, info = env.step(torch.zeros(8, 12))
    assert env.contacts.touching.all()
    # four feet at 0.5 m/s for 0.02 s
    assert info.reward_terms["low_swing"].item() == pytest.approx(-4 * 0.5 * 0.02, rel=0.02)


def test_the_feet_are_part_of_the_state(factory, designs):
    task = replace(TaskConfig(), reward=RewardConfig(low_swing=-1.0))
    env, other = (LeggedEnv(factory, designs, task, seed=seed, threads=1) for seed in (0, 1))
    env.reset()
    actions = torch.randn(6, 8, 12, generator=torch.Generator().manual_seed(0))
    for action in actions[:3]:
        env.step(action)
    other.load_state_dict(env.state_dict())
    for action in actions[3:]:
        here, there = env.step(action), other.step(action)
        assert torch.equal(here[1], there[1])
        assert torch.equal(here[4].reward_terms["low_swing"], there[4].reward_terms["low_swing"])
        assert here[4].reward_terms["low_swing"] < 0.0
