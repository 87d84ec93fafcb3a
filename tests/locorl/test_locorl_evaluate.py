"""Evaluation and fine-tuning: honest numbers, and a generalist that stays as it was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from locorl import (
    CheckpointError,
    CommandConfig,
    EvalConfig,
    FinetuneConfig,
    GoalConfig,
    LeggedEnv,
    Policy,
    PPOConfig,
    TaskConfig,
    Trainer,
    design_grid,
    evaluate,
    feasible,
    finetune,
    load_policy,
    make_task,
    no_randomisation,
    repeat_design,
    sample_designs,
)
from locorl_box import BoxQuadruped, Space

PROTOCOL = EvalConfig(seconds=1.0, settle=0.3, vx=(0.2, 0.6), robots_per_body=2, reset_joint=0.05, seed=7)
TINY = FinetuneConfig(num_envs=8, iterations=2, ppo=PPOConfig(steps=6, epochs=2, minibatches=2))


class Sprawler:
    """Sways; every fifth robot stretches its hind legs from half a second on and falls."""

    def reset(self, done: torch.Tensor | None = None) -> None:
        if done is None:
            self.t = 0

    def act(self, obs: dict[str, torch.Tensor]) -> torch.Tensor:
        self.t += 1
        n = len(obs["proprio"])
        action = 0.8 * torch.sin(torch.tensor(0.3 * self.t)) * torch.ones(n, 12)
        if self.t > 25:
            action[::5, 6:] = torch.tensor([0.0, -6.0, 6.0]).repeat(2)
            action[::5, :6] = torch.tensor([6.0, 6.0, -6.0]).repeat(2)
        return action


@pytest.fixture(scope="module")
def generalist(factory, tiny) -> Policy:
    trainer = Trainer(factory, replace(tiny, iterations=2), threads=1)
    trainer.run(quiet=True)
    return trainer.policy()


def test_every_number_against_a_recomputation(factory, designs):
    task = TaskConfig()
    result = evaluate(Sprawler(), factory, designs, task, PROTOCOL, threads=1)

    # the same protocol, stepped here, and everything worked out from the simulator's own state
    quiet = replace(
        task,
        command=CommandConfig(PROTOCOL.vx, (0, 0), (0, 0), hold=99, standing=0),
        randomisation=replace(no_randomisation(), reset_joint=0.05),
    )
    env = LeggedEnv(factory, np.repeat(designs, 2, axis=0), quiet, threads=1)
    actor, obs = Sprawler(), env.reset(seed=7)
    actor.reset()
    command = env.command[:, 0].double().numpy()
    fell_at = np.full(16, 50)
    velocity, work, rewards = np.zeros((3, 50, 16))
    for t in range(50):
        obs, reward, terminated, _, info = env.step(actor.act(obs))
        velocity[t], work[t], rewards[t] = info.velocity[:, 0], info.positive_work, reward
        fell_at = np.where(terminated.numpy() & (fell_at == 50), t, fell_at)
    upright = np.arange(50)[:, None] < fell_at
    settled = upright & (np.arange(50)[:, None] >= 15)
    error = np.where(upright, np.abs(velocity - command), np.abs(command))[15:].mean(axis=0)
    way, spent = (0.02 * velocity * settled).sum(axis=0), (work * settled).sum(axis=0)
    mass = np.array([factory.compiled(design).body_mass.sum() for design in np.repeat(designs, 2, axis=0)])
    transport = np.where(way > 0.05, spent / (mass * 9.81 * np.where(way > 0.05, way, 1.0)), np.inf)
    counted = np.arange(50)[:, None] <= fell_at  # the step of the fall still pays

    def check(name: str, expected: np.ndarray) -> None:
        np.testing.assert_allclose(getattr(result, name), expected.reshape(8, 2), rtol=1e-4, atol=1e-6, err_msg=name)

    assert 2 <= (fell_at < 50).sum() < 16  # some fall, and none at once
    assert fell_at.min() > 15
    check("survived", fell_at == 50)
    check("command", command)
    check("weight", mass * 9.81)
    check("tracking_error", error)
    check("distance", (0.02 * velocity * upright).sum(axis=0))
    check("energy", (work * upright).sum(axis=0))
    check("returns", (rewards * counted).sum(axis=0))
    check("cost_of_transport", transport)
    check("mean_power", spent / (0.02 * np.maximum(settled.sum(axis=0), 1)))

    summary = result.summary()
    assert summary["robots"] == 16
    assert summary["survived"] == (fell_at == 50).sum()
    assert summary["tracking_error"] == pytest.approx(error.mean(), rel=1e-4)
    assert summary["commanded_distance"] == pytest.approx(command.mean(), rel=1e-4)


def test_a_course_counts_until_its_last_waypoint(factory, designs):
    """Waypoints that are reached from anywhere end the course soon; what follows is another course."""
    task = make_task("parkour-highjump")
    task = replace(
        task,
        goals=GoalConfig(reach=100.0, hold=0.1),
        # backwards, so that forward is not towards the waypoint
        randomisation=replace(task.randomisation, reset_yaw=np.pi),
        reward=replace(task.reward, clip_at_zero=False),
    )
    protocol = replace(PROTOCOL, seconds=1.2)
    result = evaluate(Sprawler(), factory, designs, task, protocol, threads=1)

    quiet = replace(no_randomisation(), reset_joint=0.05, reset_yaw=np.pi)
    command = CommandConfig(PROTOCOL.vx, (0, 0), (-1, 1), hold=99, standing=0)
    twin = replace(task, command=command, randomisation=quiet, episode_seconds=9.0)
    env = LeggedEnv(factory, np.repeat(designs, 2, axis=0), twin, seed=7, threads=1)
    actor = Sprawler()
    env.reset(seed=7)
    # the robots of each body are spread over the 10 levels and the 2 columns
    obs = env.reset_on(torch.tensor([2, 7]).repeat(8), torch.tensor([0, 1]).repeat(8))
    actor.reset()
    asked, last = env.command[:, 0].clone(), 5 * env.terrain.waypoints.shape[2]
    assert 15 < last < 55
    upright, way, returns, error = torch.ones(16, dtype=torch.bool), *torch.zeros(3, 16, dtype=torch.float64)
    for t in range(1, last + 1):
        goal = env.goal[:, :2]
        obs, reward, terminated, _, info = env.step(actor.act(obs))
        returns += reward * upright
        upright &= ~terminated
        to = goal - info.position[:, :2]
        # at the end of the course the robots have been put elsewhere
        speed = info.speed if t == last else (env.sim.qvel[:, :2] * to).sum(dim=1) / to.norm(dim=1)
        way += env.dt * speed * upright
        if t > 15:
            error += torch.where(upright, (speed - asked).abs().double(), asked)
    assert 4 < upright.sum() < 16
    assert result.succeeded is not None
    np.testing.assert_array_equal(result.succeeded, upright.reshape(8, 2))
    np.testing.assert_array_equal(result.survived, result.succeeded)
    np.testing.assert_allclose(result.distance, way.reshape(8, 2), atol=2e-4)
    np.testing.assert_allclose(result.returns, returns.reshape(8, 2), rtol=1e-4, atol=1e-5)
    through = result.succeeded.ravel()
    np.testing.assert_allclose(result.tracking_error.ravel()[through], error[upright] / (last - 15), rtol=1e-3)
    assert result.summary()["succeeded"] == upright.sum()


def test_the_seed_decides_the_commands_and_bodies_share_them(factory, designs, generalist):
    first = evaluate(generalist, factory, designs, TaskConfig(), PROTOCOL, threads=1)
    again = evaluate(generalist, factory, designs, TaskConfig(), PROTOCOL, threads=1)
    other = evaluate(generalist, factory, designs, TaskConfig(), replace(PROTOCOL, seed=8), threads=1)
    for name in ("command", "survived", "returns", "tracking_error", "distance", "energy", "cost_of_transport"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert (first.command != other.command).any()
    flipped = evaluate(generalist, factory, designs[::-1].copy(), TaskConfig(), PROTOCOL, threads=1)
    np.testing.assert_array_equal(flipped.command, first.command)
    assert ((first.command >= 0.2) & (first.command <= 0.6)).all()


@pytest.mark.parametrize("wrong", [{"settle": 20.0}, {"robots_per_body": 0}])
def test_an_evaluation_without_anything_to_measure_is_refused(wrong):
    with pytest.raises(ValueError, match="EvalConfig"):
        EvalConfig(**wrong)


def test_fine_tuning_leaves_the_generalist_alone(factory, generalist):
    before = {name: values.clone() for name, values in generalist.model.state_dict().items()}
    design = np.array([1.0, 1.2, 0.9, 1.1])
    tuned = finetune(generalist, factory, design, TINY, seed=3, threads=1)
    after = generalist.model.state_dict()
    assert all(torch.equal(before[name], after[name]) for name in before)
    moved = tuned.policy.model.state_dict()
    assert not torch.equal(moved["actor.0.weight"], before["actor.0.weight"])
    assert torch.allclose(moved["actor.0.weight"], before["actor.0.weight"], atol=0.05)  # it started from there
    assert [row["iteration"] for row in tuned.curve] == [1, 2]
    assert tuned.policy.card.samples == generalist.card.samples + TINY.samples
    assert tuned.policy.card.network == generalist.card.network

    again = finetune(generalist, factory, design, TINY, seed=3, threads=1).policy.model.state_dict()
    assert all(torch.equal(moved[name], again[name]) for name in moved)


def test_fine_tuning_trains_on_the_task_that_was_asked_for(factory, generalist):
    config = replace(TINY, iterations=1, command_vx=(0.4, 0.4), specific_power=-2.0)
    card = finetune(generalist, factory, np.ones(4), config, seed=0, threads=1).policy.card
    assert card.task.command == CommandConfig((0.4, 0.4), (0.0, 0.0), (0.0, 0.0), hold=10.0, standing=0.0)
    assert card.task.reward == replace(generalist.card.task.reward, specific_power=-2.0)


def test_a_finished_fine_tune_is_read_from_its_folder(factory, generalist, tmp_path):
    first = finetune(generalist, factory, np.ones(4), TINY, seed=0, folder=tmp_path, threads=1)
    again = finetune(generalist, factory, np.ones(4), TINY, seed=0, folder=tmp_path, threads=1)
    assert [row["reward"] for row in again.curve] == [row["reward"] for row in first.curve]
    assert again.policy.card == first.policy.card
    for a, b in zip(first.policy.model.parameters(), again.policy.model.parameters(), strict=True):
        assert torch.equal(a, b)
    with pytest.raises(CheckpointError, match="another robot or another starting policy"):
        finetune(first.policy, factory, np.ones(4), TINY, seed=0, folder=tmp_path, threads=1)


@pytest.mark.parametrize(
    ("design", "message"),
    [
        ([1.0, 1.5, 1.0, 0.5], r"front_shank=1\.5 not in \[0\.6, 1\.4\], hind_shank=0\.5 not in"),
        ([1.4, 0.6, 0.6, 0.6], "has no stance"),
        ([1.0, 1.0], "has 4 parameters"),
    ],
)
def test_impossible_designs_are_refused(factory, generalist, design, message):
    with pytest.raises(ValueError, match=message):
        finetune(generalist, factory, np.array(design), TINY, seed=0, threads=1)


def test_a_policy_refuses_bodies_that_it_does_not_know(factory, generalist, tiny):
    generalist.check_space("box", factory.space)
    with pytest.raises(ValueError, match=r"trained on 'box'.*cannot control 'crate'"):
        generalist.check_space("crate", factory.space)
    with pytest.raises(ValueError, match=r"cannot control 'box' with \('length',\)"):
        generalist.check_space("box", replace(Space(), names=("length",)))
    with pytest.raises(ValueError, match="train one for it"):
        Trainer(BoxQuadruped("crate"), tiny, start=generalist, threads=1)


def test_a_policy_comes_back_from_its_file(factory, designs, generalist, tmp_path):
    generalist.save(tmp_path / "policy.pt")
    loaded = load_policy(tmp_path / "policy.pt")
    assert loaded.card == generalist.card
    env = LeggedEnv(factory, designs, TaskConfig(), threads=1)
    obs = env.reset()
    assert torch.equal(loaded.act(obs), generalist.act(obs))
    # what distillation asks of a teacher
    assert loaded.latent(obs).shape == (8, loaded.latent_dim)
    joined = torch.cat((obs["proprio"], obs["explicit"], loaded.latent(obs)), dim=1)
    assert torch.equal(loaded.actor(joined), loaded.act(obs))
    assert not loaded.act(obs).requires_grad


def test_sampled_designs_are_feasible_uniform_and_seeded(factory):
    drawn = sample_designs(factory, 80, np.random.default_rng(0))
    assert drawn.shape == (80, 4)
    assert feasible(factory, drawn).all()
    assert np.abs(drawn.mean(axis=0) - 1.0).max() < 0.1  # the mean of 80 draws has a standard error of 0.026
    assert drawn.min() < 0.62
    assert drawn.max() > 1.38
    few = [sample_designs(factory, 4, np.random.default_rng(seed)) for seed in (0, 0, 1)]
    np.testing.assert_array_equal(few[0], few[1])
    assert (few[0] != few[2]).all()


def test_a_space_without_feasible_bodies_is_named(factory):
    class Lame(BoxQuadruped):
        def batch(self, designs, scene=None):
            return replace(super().batch(designs, scene), feasible=np.zeros(len(designs), dtype=bool))

    with pytest.raises(ValueError, match="only 0 of 40 random designs of 'box' have a stance"):
        sample_designs(Lame(), 2, np.random.default_rng(0))


def test_grid_and_repetition(factory):
    grid = design_grid(factory, 3)
    assert grid.shape == (81, 4)
    assert {tuple(row) for row in grid.round(9)} == {
        (a, b, c, d) for a in (0.6, 1, 1.4) for b in (0.6, 1, 1.4) for c in (0.6, 1, 1.4) for d in (0.6, 1, 1.4)
    }
    np.testing.assert_array_equal(repeat_design(factory, np.ones(4), 3), np.ones((3, 4)))
