"""Evaluation: honest numbers, what they are printed and drawn as, and policies as files."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import replace

import locorl.commands.evaluate
import mujoco
import numpy as np
import pytest
import torch
from locorl import (
    CommandConfig,
    EvalConfig,
    Evaluation,
    GoalConfig,
    LeggedEnv,
    Policy,
    TaskConfig,
    Trainer,
    design_grid,
    evaluate,
    feasible,
    load_policy,
    make_task,
    no_randomisation,
    repeat_design,
    sample_designs,
)
from locorl.commands.evaluate import Evaluate, course_notes, obstacle_table, worst_table
from locorl.evaluation.evaluate import Course
from locorl.evaluation.plots import bodies_figure, planes, save
from locorl_box import BoxQuadruped, Space

PROTOCOL = EvalConfig(seconds=1.0, settle=0.3, vx=(0.2, 0.6), robots_per_body=2, reset_joint=0.05, seed=7)


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


def sole_velocity(env: LeggedEnv, robot: int) -> list[np.ndarray]:
    """Velocity of the point 2 cm below each foot's centre, relative to the centre, by MuJoCo, (4, 3)."""
    model, data, rate = env.sim.model_of(robot), env.sim.data_of(robot), np.zeros(6)
    mujoco.mj_fwdVelocity(model, data)
    result = []
    for name in env.factory.layout.feet:
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, model.site(name).id, rate, 0)
        result.append(np.cross(rate[:3], (0.0, 0.0, -0.02)))
    return result


def walk(feet: np.ndarray, sole: np.ndarray, touching: np.ndarray, way: float) -> tuple[float, float, float]:
    """Clearance, slip and duty factor of one robot on level ground, foot by foot: (T, 4, 3), (T, 4, 3), (T, 4)."""
    peaks, slid = [], 0.0
    for foot in range(4):
        last = None
        for t in np.flatnonzero(touching[:, foot]):
            if last is not None and t == last + 1:
                shift = feet[t, foot] - feet[last, foot] + 0.01 * (sole[t, foot] + sole[last, foot])
                slid += math.hypot(*shift[:2])
            elif last is not None and t > last + 2:
                peaks.append(feet[last + 1 : t, foot, 2].max() - 0.02)
            last = t
    return (np.mean(peaks) if peaks else 0.0), slid / 4 / way if way > 0.05 else np.inf, touching.mean()


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
    (feet, sole), touching = np.zeros((2, 50, 16, 4, 3)), np.zeros((50, 16, 4), dtype=bool)
    for t in range(50):
        obs, reward, terminated, _, info = env.step(actor.act(obs))
        velocity[t], work[t], rewards[t] = info.velocity[:, 0], info.positive_work, reward
        feet[t], touching[t] = env.sim.foot_position.numpy(), env.contacts.touching.numpy()
        sole[t] = [sole_velocity(env, robot) for robot in range(16)]
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
    later = (0.02 * velocity * settled)[16:].sum(axis=0)  # sliding has a first step to compare with
    walked = [
        walk(feet[15:fell, i], sole[15:fell, i], touching[15:fell, i], later[i]) for i, fell in enumerate(fell_at)
    ]
    for name, values in zip(("clearance", "slip", "duty_factor"), np.array(walked).T, strict=True):
        np.testing.assert_allclose(getattr(result.gait, name).ravel(), values, rtol=1e-4, atol=1e-6, err_msg=name)

    summary = result.summary()
    assert summary["robots"] == 16
    assert summary["survived"] == (fell_at == 50).sum()
    assert summary["tracking_error"] == pytest.approx(error.mean(), rel=1e-4)
    assert summary["commanded_distance"] == pytest.approx(command.mean(), rel=1e-4)
    moving = (fell_at == 50) & (way > 0.05)
    assert moving.any()
    assert summary["slip"] == pytest.approx(np.array(walked)[moving, 1].mean(), rel=1e-4)


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
    command = replace(task.command, vx=PROTOCOL.vx, hold=99, standing=0)
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
    assert result.course is not None
    tiles = torch.tensor([2, 7]), torch.tensor([0, 1])
    np.testing.assert_allclose(result.course.obstacle, np.tile(env.terrain.obstacle[tiles].numpy(), (8, 1)))
    np.testing.assert_allclose(result.course.hip_height.ravel(), env.stance_qpos[:, 2].numpy(), rtol=1e-6)
    points = np.concatenate((env.terrain.origins[tiles][:, None], env.terrain.waypoints[tiles]), axis=1)[..., :2]
    length = [sum(math.dist(a, b) for a, b in itertools.pairwise(way)) for way in points.tolist()]
    np.testing.assert_allclose(result.course.length, np.tile(length, (8, 1)), rtol=1e-5)


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
    torch.testing.assert_close(loaded.actor(joined), loaded.act(obs))
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


@pytest.fixture
def evaluate_command(factory, generalist, tmp_path, monkeypatch):
    """`locorl evaluate` on the box quadruped, 100 columns wide."""
    monkeypatch.setattr(locorl.commands.evaluate, "find_factory", lambda name: factory)
    monkeypatch.setenv("COLUMNS", "100")
    generalist.save(tmp_path / "policy.pt")

    def run(**options) -> Evaluate:
        options = {"evaluation": PROTOCOL, "bodies": 6} | options
        command = Evaluate(tmp_path / "policy.pt", **options)
        command.run()
        return command

    return run


def scored(**arrays: np.ndarray) -> Evaluation:
    """Four bodies of two robots each: the second falls with both, the fourth with one, the third tracks badly."""
    ones = np.ones((4, 2))
    plain = Evaluation(
        designs=np.array([[1.0, 1, 1, 1], [0.7, 1, 1, 1.3], [1.2, 1, 0.8, 1], [1, 1.1, 1, 0.9]]),
        config=EvalConfig(seconds=10.0, robots_per_body=2),
        command=0.5 * ones,
        weight=150 * ones,
        survived=np.array([[1, 1], [0, 0], [1, 1], [1, 0]], dtype=bool),
        returns=ones,
        tracking_error=np.array([[0.05, 0.05], [0.5, 0.5], [0.3, 0.2], [0.1, 0.4]]),
        distance=np.array([[5.0, 5.0], [0.5, 0.5], [3.0, 4.0], [4.0, 1.0]]),
        energy=500 * ones,
        cost_of_transport=0.4 * ones,
        mean_power=25 * ones,
    )
    return replace(plain, **arrays)


def cells(table) -> list[list[str]]:
    return list(map(list, zip(*(column.cells for column in table.columns), strict=True)))


def test_the_worst_bodies_are_listed_with_their_design():
    names = ("front_thigh", "front_shank", "hind_thigh", "hind_shank")
    table = worst_table(scored(), names, 3)
    assert str(table.title) == "worst bodies; on 2 of 4 a robot fell"
    assert cells(table) == [
        ["0.700", "1.000", "1.000", "1.300", "0 of 2", "0.500", "10%"],
        ["1.000", "1.100", "1.000", "0.900", "1 of 2", "0.250", "50%"],
        ["1.200", "1.000", "0.800", "1.000", "2 of 2", "0.250", "70%"],
    ]


def test_success_on_a_course_is_tabled_by_hip_heights():
    hips = np.array([[0.3, 0.3], [0.2, 0.2], [0.3, 0.3], [0.2, 0.2]])
    course = Course(np.full((4, 2), 0.3), hips, np.full((4, 2), 4.0), np.full((4, 2), "long_jump"))
    succeeded = np.array([[1, 1], [0, 0], [1, 0], [1, 0]], dtype=bool)
    result = scored(course=course, succeeded=succeeded)
    assert [row[:4] for row in cells(obstacle_table(result))] == [
        ["long jump", "1.00 to 1.25", "4", "75%"],
        ["long jump", "1.50 to 1.75", "4", "25%"],
    ]
    # by hand: the first is done with 4 of 4 m, the last with 5 of 8
    assert [row[5] for row in cells(worst_table(result, ("a", "b", "c", "d"), 4))][-1] == "2 of 2"
    assert str(worst_table(result, ("a", "b", "c", "d"), 4).title).endswith("on 3 of 4 a robot did not get through")


def test_notes_tell_what_success_owes_to_the_protocol():
    # 0.5 m/s for 10 s reach 5 m
    length = np.array([[4.0, 6.0], [4.9, 4.0], [4.0, 4.0], [12.0, 4.0]])
    course = Course(np.ones((4, 2)), np.ones((4, 2)), length, np.full((4, 2), "gaps"))
    succeeded = np.ones((4, 2), dtype=bool)
    (note,) = course_notes(scored(course=course, succeeded=succeeded))
    assert "2 of 8 robots had no time" in note
    assert "--evaluation.seconds 29" in note  # 12 m at 0.5 m/s, and a fifth more
    single = scored(
        course=Course(*np.ones((3, 4, 1)), kind=np.full((4, 1), "gaps")),
        command=np.full((4, 1), 0.5),
        succeeded=succeeded[:, :1],
        config=EvalConfig(),
    )
    (note,) = course_notes(single)
    assert "one course of the middle level" in note
    assert course_notes(replace(single, config=EvalConfig(level=3))) == []


@pytest.mark.parametrize(("grid", "names"), [(None, None), (3, None), (None, ("a", "b", "c", "d"))])
def test_bodies_are_drawn(factory, designs, grid, names, tmp_path):
    designs = designs if grid is None else design_grid(factory, grid)[:81]
    shape = (len(designs), 1)
    error = np.linspace(0, 1, len(designs))[:, None]
    ones = np.ones(shape)
    result = scored(
        designs=designs, command=ones, survived=error < 0.9, tracking_error=error, distance=ones, returns=ones
    )
    figure = bodies_figure(result, names or factory.space.names)
    save(figure, tmp_path / "bodies.png")
    assert (tmp_path / "bodies.png").read_bytes().startswith(b"\x89PNG")
    # length and proportion for the legs, six pairs for what has no meaning
    assert len([ax for ax in figure.axes if ax.get_xlabel()]) == (2 if names is None else 6)


def test_planes_hold_every_parameter(factory, designs):
    length, share = planes(designs, factory.space.names)
    front_thigh, front_shank, hind_thigh, hind_shank = designs.T
    np.testing.assert_allclose(length.x + share.x / 2, front_thigh)
    np.testing.assert_allclose(length.x - share.x / 2, front_shank)
    np.testing.assert_allclose(length.y + share.y / 2, hind_thigh)
    np.testing.assert_allclose(length.y - share.y / 2, hind_shank)


def test_evaluate_prints_tables_and_draws(evaluate_command, tmp_path, capsys):
    evaluate_command(plot=tmp_path / "bodies.png", worst=2)
    out = capsys.readouterr().out
    assert all(word in out for word in ("tracking error worst decile, m/s", "foot clearance, m", "duty factor"))
    assert "worst bodies" in out
    assert (tmp_path / "bodies.png").read_bytes().startswith(b"\x89PNG")


def test_evaluate_prints_gait_as_json(evaluate_command, generalist, capsys):
    evaluate_command(json=True)
    content = json.loads(capsys.readouterr().out)
    assert content["samples"] == generalist.card.samples
    assert len(content["robots"]) == 12
    duty = [row["duty_factor"] for row in content["robots"]]
    assert all(0.0 <= value <= 1.0 for value in duty)
    assert {"foot_clearance", "slip"} <= content["robots"][0].keys()


@pytest.mark.parametrize(("name", "message"), [("x.pdf", r"a picture is a \.png"), ("no/x.png", "does not exist")])
def test_a_picture_that_cannot_be_written_is_refused_at_once(evaluate_command, monkeypatch, tmp_path, name, message):
    monkeypatch.setattr(locorl.commands.evaluate, "evaluate", lambda *_: pytest.fail("simulated in vain"))
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        evaluate_command(plot=tmp_path / name)
