"""Real robots with the most extreme bodies survive a million random actions without a number that is none."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch
from locorl import LeggedEnv, make_task
from locorl.providers import find_factory

ROBOTS = 512


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "task", "steps"),
    [("go2", "locomotion-flat", 800), ("lite3", "parkour-highjump", 700), ("go2", "locomotion-steps", 500)],
)
def test_no_nan_in_a_million_random_actions(robot, task, steps):
    factory = find_factory(robot)
    corners = np.array(list(itertools.product((0.6, 1.4), repeat=4)))
    corners = corners[factory.batch(corners).feasible]
    assert len(corners) >= 14
    env = LeggedEnv(factory, np.resize(corners, (ROBOTS, 4)), make_task(task), seed=0)
    obs = env.reset(seed=0)
    generator = torch.Generator().manual_seed(0)
    for _ in range(steps):
        obs, reward, *_, info = env.step(torch.randn(ROBOTS, 12, generator=generator))
        assert all(values.isfinite().all() for values in obs.values())
        assert reward.isfinite().all()
        assert info.positive_work.isfinite().all()
    assert env.failures.report(factory.space.names) == ""
    assert not any(env.sim.overflows.values())
