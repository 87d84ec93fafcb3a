"""What a student's training and evaluation ask of the robots: groups, even spread, pictures, entry points."""

from __future__ import annotations

import tomllib
from collections import Counter
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import torch
from locorl import LeggedEnv, PolicyCard, Trainer, make_task, providers
from locorl.adapters.student import StudentEnv
from locorl.adapters.vision import VisionEnv, with_camera
from locorl.env.depth_camera import DepthConfig

HILLY = make_task("locomotion-hills")
HILLY = replace(HILLY, terrain=replace(HILLY.terrain, kinds=("hills", "flat"), columns=2, levels=3))
NOMINAL = np.ones((12, 4))


def make(factory, designs=NOMINAL, task=HILLY, spread=False) -> StudentEnv:
    return StudentEnv(LeggedEnv(factory, designs, task, seed=1, threads=1), spread)


def test_robots_are_grouped_by_the_ground_they_stand_on(factory):
    env = make(factory, spread=True)
    env.reset(seed=3)
    groups = env.groups()
    columns = env.env.curriculum.column.tolist()
    assert groups["terrain"] == [("hills", "flat")[column] for column in columns]
    tiles = Counter(zip(env.env.curriculum.level.tolist(), columns, strict=True))
    assert tiles == {(level, column): 2 for level in range(3) for column in range(2)}
    assert len(set(groups["body"])) == 1


def test_bodies_are_listed_if_they_are_few_and_binned_by_leg_length_if_many(factory):
    designs = np.repeat([[1.0, 1.2, 1.0, 1.2], [1.0, 1.0, 1.0, 1.0]], 3, axis=0)
    names = make(factory, designs).groups()["body"]
    assert names[0] == names[2] != names[3]
    assert "1.2" in names[0]
    rising = np.ones((9, 4)) * np.linspace(0.9, 1.1, 9)[::-1, None]
    names = make(factory, rising).groups()["body"]
    assert names == ["3: longer legs"] * 3 + ["2: middling legs"] * 3 + ["1: shorter legs"] * 3


def test_equal_seeds_give_equal_episodes_spread_or_not(factory):
    for spread in (False, True):
        env = make(factory, spread=spread)
        first = {group: values.clone() for group, values in env.reset(seed=5).items()}
        env.step(torch.ones(12, 12))
        assert all(torch.equal(values, first[group]) for group, values in env.reset(seed=5).items())
        assert any(not torch.equal(values, first[group]) for group, values in env.reset(seed=6).items())


def test_success_is_told_where_there_is_a_course(factory):
    course = make_task("parkour-highjump")
    course = replace(course, terrain=replace(course.terrain, levels=1))
    for task, told in ((HILLY, False), (course, True)):
        env = make(factory, task=task)
        env.reset(seed=1)
        measures = env.step(torch.zeros(12, 12))[-1]
        assert measures.tracking_error.shape == (12,)
        assert (measures.success is not None) is told


@pytest.mark.slow
def test_a_picture_shows_the_chosen_robot(factory):
    pytest.importorskip("imageio_ffmpeg")
    env = make(factory)
    env.reset(seed=1)
    from locorl.play.errors import PlayError

    try:
        picture = env.picture(0, 160, 120)
    except PlayError as error:
        pytest.skip(str(error))
    assert picture.shape == (120, 160, 3)
    assert picture.std() > 5.0
    assert not np.array_equal(picture, env.picture(1, 160, 120))
    assert np.array_equal(picture.shape, env.picture(0, 160, 120).shape)


# ---------------------------------------------------------------- entry points


def test_every_declared_entry_point_exists_and_makes_what_its_name_says(factory, monkeypatch):
    project = tomllib.loads((Path(__file__).parents[2] / "packages/locorl/pyproject.toml").read_text())
    points = project["project"]["entry-points"]["legged.envs"]
    assert set(points) == {"locomotion", "parkour", "parkour-depth"}
    asked = []
    monkeypatch.setattr(providers, "find_factory", lambda robot: asked.append(robot) or factory)
    found = {}
    for name, target in points.items():
        module, attribute = target.split(":")
        function = getattr(import_module(module), attribute)
        found[name] = function(num_envs=2, **({"rows": 4, "columns": 6} if name == "parkour-depth" else {}))
    assert asked == ["go2", "lite3", "lite3"]
    assert found["locomotion"].env.task.name == "locomotion-flat"
    assert found["parkour"].env.task.name == "parkour-mixed"
    assert isinstance(found["parkour-depth"], VisionEnv)
    assert found["parkour-depth"].depth_shape == (4, 6)


def test_options_choose_task_ground_body_and_history(factory, tiny, monkeypatch, tmp_path):
    monkeypatch.setattr(providers, "find_factory", lambda robot: factory)
    env = providers.locomotion(
        task="locomotion-rough", terrain=["flat"], num_envs=3, design=[1.0, 1.1, 1.0, 1.1], history=2
    )
    assert env.env.task.name == "locomotion-rough"
    assert env.env.terrain.kinds == ("flat",)
    fresh = providers.locomotion(task="locomotion-rough", terrain=["flat"], num_envs=2, terrain_seed=5)
    assert fresh.env.task.terrain == replace(env.env.task.terrain, seed=5)
    assert np.array_equal(env.env.bodies.designs, np.tile([1.0, 1.1, 1.0, 1.1], (3, 1)))
    assert env.group_dims["history"] == 2 * env.group_dims["proprio"]
    # the task of a policy is that which it was trained on, whatever the catalogue says today
    task = replace(tiny.task, action_scale=0.3)
    trainer = Trainer(factory, replace(tiny, task=task), threads=1)
    trainer.policy().save(tmp_path / "policy.pt")
    assert isinstance(trainer.policy().card, PolicyCard)
    env = providers.locomotion(policy=str(tmp_path / "policy.pt"), num_envs=2)
    assert env.env.task == task
    with pytest.raises(ValueError, match="parameters"):
        providers.locomotion(design=[1.0], num_envs=2)
    with pytest.raises(ValueError, match="no task 'moon'"):
        providers.locomotion(task="moon")


def test_students_are_judged_by_the_walking_protocol_where_speeds_are_given(factory, monkeypatch):
    monkeypatch.setattr(providers, "find_factory", lambda robot: factory)
    env = providers.locomotion(num_envs=40, vx=[0.4, 0.6], seed=3).env
    assert env.task.randomisation.push == 0.0
    assert env.task.randomisation.reset_joint == 0.1
    env.reset()
    commands = env.command
    assert (commands[:, 0] >= 0.4).all()
    assert (commands[:, 0] <= 0.6).all()
    assert (commands[:, 1:] == 0.0).all()


def test_a_camera_needs_a_way_to_go(factory):
    task = with_camera(HILLY, DepthConfig(rows=4, columns=6))
    with pytest.raises(ValueError, match="needs heading_error"):
        VisionEnv(LeggedEnv(factory, NOMINAL, task, seed=1, threads=1))
