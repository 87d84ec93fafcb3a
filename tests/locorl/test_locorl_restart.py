"""What a new episode starts from, and what it must not remember of the one before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from locorl import (
    CommandConfig,
    CurriculumConfig,
    EvalConfig,
    GoalConfig,
    LeggedEnv,
    RandomisationConfig,
    TaskConfig,
    evaluate,
    make_task,
    no_randomisation,
)
from locorl.env.commands import VelocityCommands
from locorl.env.goals import Waypoints
from locorl.play.actors import Stand

STILL = CommandConfig(standing=1.0)


def shaken(n: int, steps: int) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(3)
    return [0.5 * torch.randn(n, 12, generator=generator) for _ in range(steps)]


def test_robots_start_around_their_tile_on_the_highest_ground_below_them(factory, designs):
    task = make_task("locomotion-steps")
    wide = replace(no_randomisation(), reset_position=3.0)
    env = LeggedEnv(factory, designs, replace(task, randomisation=wide), threads=1)
    offsets = []
    for _ in range(10):
        env.reset()
        start = env.terrain.origins[env.curriculum.level, env.curriculum.column]
        offsets.append((env.sim.qpos[:, :2] - start[:, :2]).numpy())
        for robot in range(8):
            x, y, z = env.sim.qpos[robot, :3].numpy()
            around = [(x + i, y + j) for i in (-0.3, 0.0, 0.3) for j in (-0.3, 0.0, 0.3)]
            heights = env.terrain.heights.at(torch.tensor(around, dtype=torch.float32))
            assert z == pytest.approx(env.stance_qpos[robot, 2].item() + heights.max().item(), abs=1e-5)
    reached = np.abs(np.concatenate(offsets))
    assert 2.5 < reached.max() <= 3.0 + 1e-6
    assert (reached.max(axis=0) > 2.0).all()


@pytest.mark.parametrize("name", ["locomotion-slope", "parkour-stones"])
def test_equal_seeds_give_equal_rollouts_whatever_happened_before(factory, designs, name):
    task = make_task(name)
    task = replace(task, episode_seconds=0.2, curriculum=CurriculumConfig(least=0.0, start_level=9))
    env = LeggedEnv(factory, designs, task, threads=1)

    def rollout() -> list[torch.Tensor]:
        rows = list(env.reset(seed=5).values())
        for action in shaken(8, 25):
            obs, reward, *_ = env.step(action)
            rows += [*obs.values(), reward, env.curriculum.level.clone(), env.sim.qpos.clone()]
        return rows

    first = rollout()
    for action in shaken(8, 7):  # somewhere within an episode and between two looks at the ground
        env.step(action)
    assert all(torch.equal(a, b) for a, b in zip(first, rollout(), strict=True))


def test_the_first_reward_after_a_time_out_is_that_of_a_new_robot(factory, designs):
    task = replace(TaskConfig(), randomisation=no_randomisation(), command=STILL)
    used = LeggedEnv(factory, designs, replace(task, episode_seconds=0.1), threads=1)
    new = LeggedEnv(factory, designs, task, threads=1)
    used.reset(seed=0)
    new.reset(seed=0)
    for action in shaken(8, 5):
        *_, truncated, _ = used.step(action)
    assert truncated.all()
    for action in shaken(8, 3):
        (_, ours, _, _, info), (_, theirs, _, _, other) = used.step(action), new.step(action)
        assert torch.equal(ours, theirs)
        assert {k: v.item() for k, v in info.reward_terms.items()} == {
            k: v.item() for k, v in other.reward_terms.items()
        }


def test_time_near_a_waypoint_does_not_count_on_the_next_course():
    goals = Waypoints(GoalConfig(hold=0.1), count=1, dt=0.02, num_envs=1, device=torch.device("cpu"))
    everyone, course = torch.tensor([0]), torch.zeros(1, 1, 3)
    goals.assign(everyone, course)
    for _ in range(4):
        goals.advance(torch.zeros(1, 3))
    goals.assign(everyone, course)
    for _ in range(4):
        goals.advance(torch.zeros(1, 3))
        assert not goals.finished().any()
    goals.advance(torch.zeros(1, 3))
    assert goals.finished().all()


def test_a_robot_told_to_stand_is_not_turned():
    commands = VelocityCommands(CommandConfig(yaw_rate=(-1.0, 1.0)), 0.02, 2, torch.Generator())
    commands.command[:] = torch.tensor([[0.0, 0.0, 0.3], [0.5, 0.0, 0.3]])
    commands.steer(torch.tensor([0.4, 0.4]))
    np.testing.assert_allclose(commands.command, [[0.0, 0.0, 0.0], [0.5, 0.0, 0.2]])


def test_levels_closed_to_short_legs_open_with_longer_ones(factory, designs):
    task = make_task("parkour-highjump")
    task = replace(task, curriculum=CurriculumConfig(start_level=9, hip_limit=0.8))
    short, long = np.full((8, 4), 0.65), np.full((8, 4), 1.35)
    env = LeggedEnv(factory, short, task, threads=1)
    limit = env.terrain.obstacle[:, env.curriculum.column].T
    for bodies in (short, long, short):
        env.set_designs(bodies)
        hip = torch.from_numpy(factory.batch(bodies).stance_qpos[:, 2]).float()
        fits = (limit <= 0.8 * hip[:, None]).long().cumprod(dim=1).sum(dim=1).clamp(min=1)
        assert env.curriculum.ceiling.tolist() == fits.tolist()
    assert (env.curriculum.level < env.curriculum.ceiling).all()


def test_a_saved_robot_with_nominal_motors_gets_them_back(factory, designs):
    random = replace(no_randomisation(), motor_strength=(0.5, 0.8), payload=(1.0, 2.0))
    env = LeggedEnv(factory, designs, replace(TaskConfig(), randomisation=random), threads=1)
    env.reset(seed=0)
    state = env.state_dict()
    state["drawn.motor_strength"] = torch.ones(8, 12)
    state["drawn.payload"] = torch.zeros(8)
    assert (env.sim.model_of(2).actuator_gainprm[:, 0] < 33.0).all()
    env.load_state_dict(state)
    body = factory.compiled(designs[2])
    np.testing.assert_allclose(env.sim.model_of(2).actuator_gainprm[:, 0], body.actuator_gainprm[:, 0])
    np.testing.assert_allclose(env.sim.model_of(2).body_mass, body.body_mass)


def test_every_body_is_judged_on_the_same_tiles(factory, designs, monkeypatch):
    seen = []
    start = LeggedEnv.reset_on

    def record(env: LeggedEnv, level: torch.Tensor, column: torch.Tensor):
        obs = start(env, level, column)
        seen.append((env.curriculum.level.reshape(4, 5).clone(), env.curriculum.column.reshape(4, 5).clone()))
        np.testing.assert_allclose(env.sim.qpos[:, :2], env.terrain.origins[level, column][:, :2], atol=1e-5)
        return obs

    monkeypatch.setattr(LeggedEnv, "reset_on", record)
    task = make_task("parkour-longjump")  # its curriculum spares short legs the wide gaps
    protocol = EvalConfig(seconds=0.2, settle=0.0, robots_per_body=5)
    evaluate(Stand(), factory, designs[:4], task, protocol)
    level, column = seen[0]
    assert level.tolist() == [[1, 3, 5, 7, 9]] * 4
    assert (column == column[0]).all()
    evaluate(Stand(), factory, designs[:4], task, replace(protocol, level=2))
    assert (seen[1][0] == 2).all()
    with pytest.raises(ValueError, match="levels 0 to 9, not 10"):
        evaluate(Stand(), factory, designs[:4], task, replace(protocol, level=10))


def test_a_heading_to_keep_is_straight_on_in_an_evaluation(factory, designs, monkeypatch):
    envs = []
    make = LeggedEnv.__init__
    monkeypatch.setattr(LeggedEnv, "__init__", lambda env, *a, **k: (envs.append(env), make(env, *a, **k))[1])
    task = make_task("locomotion-flat", "paper")
    evaluate(Stand(), factory, designs, task, EvalConfig(seconds=0.2, settle=0.0, reset_joint=0.05))
    error = envs[-1].observe()["proprio"][:, envs[-1].layout.column("proprio", "heading_error")]
    assert error.abs().max() < 0.05


@pytest.mark.parametrize(
    "make",
    [
        lambda: CommandConfig(vx=(1.0, -1.0)),
        lambda: CommandConfig(heading=(1.0, -1.0)),
        lambda: RandomisationConfig(friction=(1.0, 0.5)),
        lambda: RandomisationConfig(payload=(1.0, 0.0)),
    ],
)
def test_ranges_that_run_backwards_are_refused(make):
    with pytest.raises(ValueError, match=r"must be \(low, high\)"):
        make()


def test_what_the_presets_take_from_the_facts():
    for name in ("locomotion-hills", "parkour-stones"):
        paper = make_task(name, "paper")
        assert paper.action_clip * paper.action_scale == pytest.approx(1.2)  # rad
        assert paper.randomisation.friction == (0.6, 2.0)
        assert paper.randomisation.payload == (0.0, 3.0)
        assert paper.randomisation.action_delay == (1, 1)
    parkour = make_task("parkour-stones", "paper")
    assert parkour.randomisation.reset_yaw == 0.0
    assert parkour.command.vx == (0.3, 0.8)
    assert parkour.command.hold == 6.0
    assert not parkour.end_on_base_contact
    assert parkour.min_altitude == -0.25
    assert make_task("parkour-stones").curriculum.hip_limit == 1.5
