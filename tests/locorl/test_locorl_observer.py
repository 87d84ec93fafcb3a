"""What robots sense beyond the instant: history, noise, the pace of perception, late actions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from locorl import LeggedEnv, ObservationConfig, RandomisationConfig, TaskConfig, make_task, no_randomisation
from locorl.env.observation import PROPRIO
from locorl.env.observer import READERS


def shaken(n: int, steps: int) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(2)
    return [0.4 * torch.randn(n, 12, generator=generator) for _ in range(steps)]


def test_every_term_has_a_reader():
    assert set(READERS) == set(PROPRIO)


def test_unknown_terms_are_refused():
    with pytest.raises(ValueError, match=r"no proprioceptive term \['smell'\]"):
        ObservationConfig(proprio=("smell",))


def test_history_holds_the_past_frames_oldest_first(factory, designs):
    task = make_task("parkour-highjump", "paper")
    task = replace(task, randomisation=no_randomisation(), observation=replace(task.observation, history=3))
    env = LeggedEnv(factory, designs, task, threads=1)
    obs = env.reset(seed=0)
    width = env.group_dims["proprio"]
    oracle = [env.layout.column("proprio", name) for name in ("heading_error", "next_heading_error")]

    def onboard(proprio: torch.Tensor) -> torch.Tensor:
        known = proprio.clone()
        for columns in oracle:
            known[:, columns] = 0.0
        return known

    assert any(obs["proprio"][:, columns].abs().max() > 1e-3 for columns in oracle)
    frames = [onboard(obs["proprio"])] * 4
    for action in shaken(8, 6):
        np.testing.assert_allclose(obs["history"].reshape(8, 3, width), torch.stack(frames[-4:-1], dim=1), atol=1e-7)
        obs, *_ = env.step(action)
        frames.append(onboard(obs["proprio"]))
    assert env.layout.column("history", "proprio[-3]").start == 0


def test_history_starts_anew_with_the_episode(factory, designs):
    task = replace(TaskConfig(), episode_seconds=0.1, randomisation=no_randomisation())
    task = replace(task, observation=replace(task.observation, history=2))
    env = LeggedEnv(factory, designs, task, threads=1)
    env.reset(seed=0)
    for action in shaken(8, 5):
        obs, *_ = env.step(action)
    width = env.group_dims["proprio"]
    np.testing.assert_array_equal(obs["history"], torch.cat((obs["proprio"], obs["proprio"]), dim=1))
    assert obs["history"].shape == (8, 2 * width)


def test_perception_looks_at_its_own_pace(factory, designs):
    task = make_task("parkour-highjump")
    env = LeggedEnv(factory, designs, replace(task, randomisation=no_randomisation()), threads=1)
    obs = env.reset(seed=0)
    heading = env.layout.column("proprio", "heading_error")
    changed = []
    for action in shaken(8, 15):
        last, (obs, *_) = obs, env.step(action)
        moved = [(obs["scan"] != last["scan"]).any(), (obs["proprio"][:, heading] != last["proprio"][:, heading]).any()]
        assert moved[0] == moved[1]
        changed.append(bool(moved[0]))
    assert changed == ([False] * 4 + [True]) * 3


def test_noise_stays_within_the_widths_that_the_terms_state(factory, designs):
    quiet = make_task("locomotion-hills")
    still = replace(quiet.command, standing=1.0)  # commands of both stay the same
    quiet = replace(quiet, randomisation=no_randomisation(), command=still)
    noisy = replace(quiet, randomisation=replace(no_randomisation(), observation_noise=0.5))
    clean, disturbed = (LeggedEnv(factory, designs, task, threads=1) for task in (quiet, noisy))
    clean.reset(seed=0)
    disturbed.reset(seed=0)
    errors: dict[str, list[np.ndarray]] = {}
    for _ in range(40):
        (ours, *_), (theirs, *_) = clean.step(torch.zeros(8, 12)), disturbed.step(torch.zeros(8, 12))
        clean.sim.load_state_dict(disturbed.sim.state_dict())
        for group in ("proprio", "scan"):
            for term in clean.layout.groups[group]:
                error = (theirs[group] - ours[group])[:, clean.layout.column(group, term.name)].numpy()
                errors.setdefault(term.name, []).append(error / term.scale)
        assert torch.equal(ours["explicit"], theirs["explicit"])
    widths = {
        "base_angular_velocity": 0.2,
        "projected_gravity": 0.05,
        "joint_position_error": 0.01,
        "joint_velocity": 1.5,
        "heights": 0.1,
    }
    for name, rows in errors.items():
        error, width = np.concatenate(rows), 0.5 * widths.get(name, 0.0)
        assert np.abs(error).max() <= width * 1.001 + 1e-6
        if width:
            assert np.abs(error).max() > 0.95 * width
            assert abs(error.mean()) < 0.1 * width


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_actions_arrive_late_by_whole_control_steps(factory, designs, delay):
    random = replace(no_randomisation(), action_delay=(delay, delay))
    env = LeggedEnv(factory, designs, replace(TaskConfig(), randomisation=random), threads=1)
    env.reset(seed=0)
    actions = shaken(8, 8)
    for t, action in enumerate(actions):
        obs, *_ = env.step(action)
        arrived = actions[t - delay] if t >= delay else torch.zeros(8, 12)
        np.testing.assert_allclose(env.sim.ctrl, env.stance_ctrl + 0.25 * arrived, atol=1e-6)
        # the robot knows what it asked for, not what has arrived
        np.testing.assert_allclose(obs["proprio"][:, env.layout.column("proprio", "last_action")], action)


def test_delays_are_drawn_per_robot_and_episode(factory, designs):
    random = replace(no_randomisation(), action_delay=(0, 4))
    env = LeggedEnv(factory, designs, replace(TaskConfig(), randomisation=random), threads=1)
    drawn = []
    for _ in range(20):
        env.reset()
        drawn.append(env._delay.delay.clone())
    drawn = torch.stack(drawn)
    assert set(drawn.flatten().tolist()) == {0, 1, 2, 3, 4}
    assert (drawn != drawn[0]).any()


def test_impossible_pushes_and_histories_are_refused():
    with pytest.raises(ValueError, match="push_interval must be above 0 s"):
        RandomisationConfig(push=0.5, push_interval=0.0)
    with pytest.raises(ValueError, match="history must be 0 frames or more, got -1"):
        ObservationConfig(history=-1)


@pytest.mark.parametrize("delay", [(2, 1), (-1, 0)])
def test_impossible_delays_are_refused(delay):
    with pytest.raises(ValueError, match="action_delay needs 0 <= low <= high"):
        RandomisationConfig(action_delay=delay)
