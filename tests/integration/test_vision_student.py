"""A seeing student of the shipped parkour teacher: locorl's cameras, robots and trainer meet distill's networks."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import deploy
import distill
import numpy as np
import pytest
import torch
from deploy.logs.messages import Sample
from distill.vision import Convolution
from locorl import (
    DepthConfig,
    LeggedEnv,
    Policy,
    PPOConfig,
    RolloutHook,
    TaskConfig,
    TrainConfig,
    Trainer,
    find_factory,
    load_policy,
)
from locorl.adapters.vision import VisionEnv, with_camera

from legged_codesign.bundle import bundle_spec
from legged_codesign.pretrained import shipped_policy

ROBOTS, PAST, PROPRIO = 8, 4, 49
SIZES = distill.AdaptationConfig(history=PAST + 1, frame_features=8, channels=(8,), features=16, estimator=(16,))


@pytest.fixture(scope="module")
def teacher() -> Policy:
    return load_policy(shipped_policy("lite3", "parkour"))


@pytest.fixture(scope="module")
def task(teacher: Policy) -> TaskConfig:
    """The teacher's, on one short row of hurdles, with a coarse camera."""
    own = teacher.card.task
    terrain = replace(own.terrain, kinds=("hurdles",), levels=2, columns=1, difficulty=(-0.8, -0.6), border=4.0)
    curriculum = replace(own.curriculum, start_level=1)
    return with_camera(
        replace(own, terrain=terrain, curriculum=curriculum), DepthConfig(rows=10, columns=15), history=PAST
    )


def make(task: TaskConfig) -> VisionEnv:
    return VisionEnv(LeggedEnv(find_factory("lite3"), np.ones((ROBOTS, 4)), task, seed=1))


def prepare(env: VisionEnv, teacher: Policy) -> distill.AdaptationModule:
    columns = range(env.heading.start, env.heading.stop)
    torch.manual_seed(2)
    return distill.build_adaptation(env.group_dims["proprio"], teacher, SIZES, columns)


def test_images_are_of_the_instant_and_the_history_is_the_students(task: TaskConfig, teacher: Policy) -> None:
    env = make(task)
    adaptation = prepare(env, teacher)
    obs, history = env.reset(seed=3), torch.zeros(ROBOTS, PAST + 1, env.group_dims["proprio"])
    names = [term.name for term in env.env.layout.proprio]
    assert (env.depth_shape, env.depth_period) == ((10, 15), 5)
    assert names[2:4] == ["heading_error", "next_heading_error"]
    assert env.heading == slice(6, 8)
    images, restarted = [env.depth.clone()], [False]
    for _ in range(40):
        torch.testing.assert_close(obs["proprio"][:, 6], env.env.observer.heading_errors[:, 0])
        history = adaptation.push(history, obs["proprio"])
        torch.testing.assert_close(history, adaptation.window(obs), rtol=0, atol=0)
        obs, _, terminated, truncated, _ = env.step(teacher.act(obs))
        done = terminated | truncated
        history = history.masked_fill(done[:, None, None], 0.0)
        images.append(env.depth.clone())
        restarted.append(bool(done.any()))
    fresh = [not torch.equal(now, before) for before, now in pairwise(images)]
    due = [tick % 5 == 0 for tick in range(1, 41)]
    assert all(new == is_due or again for new, is_due, again in zip(fresh, due, restarted[1:], strict=True))
    assert sum(fresh) >= 8
    again = env.reset(seed=3)
    assert torch.equal(env.depth, images[0])
    assert all(torch.equal(again[group], values) for group, values in make(task).reset(seed=3).items())


def test_a_late_camera_and_a_task_without_a_way_are_refused(task: TaskConfig) -> None:
    with pytest.raises(ValueError, match=r"0\.1 s late; make the task with `with_camera`"):
        make(replace(task, camera=DepthConfig(rows=10, columns=15)))
    with pytest.raises(ValueError, match="no camera"):
        make(replace(task, camera=None))
    proprio = tuple(name for name in task.observation.proprio if "heading" not in name)
    with pytest.raises(ValueError, match="needs heading_error"):
        make(replace(task, observation=replace(task.observation, proprio=proprio)))


def test_estimator_and_roa_run_while_the_teacher_is_fine_tuned(task: TaskConfig, teacher: Policy, tmp_path) -> None:
    """And a run that was cut goes on as if it had not been."""
    factory, designs = find_factory("lite3"), np.ones((ROBOTS, 4))
    config = TrainConfig(
        num_envs=ROBOTS, iterations=5, save_every=2, seed=4, task=task, ppo=PPOConfig(steps=8, minibatches=2, epochs=1)
    )

    def trainer(folder: Path) -> tuple[Trainer, distill.AdaptationModule, list[torch.Tensor]]:
        torch.manual_seed(6)
        adaptation = distill.build_adaptation(PROPRIO, teacher, SIZES, range(6, 8))
        roa = distill.RegularisedAdaptation(adaptation, distill.RoaSchedule(warmup=1, every=2))
        hooks: list[RolloutHook] = [distill.VelocityEstimation(adaptation, use_after=2), roa]
        made = Trainer(factory, config, folder, designs=designs, start=teacher, hooks=hooks)
        seen: list[torch.Tensor] = []

        def latent(obs):
            seen.append(made.model.latent(obs))
            return seen[-1]

        roa.attach(latent)
        return made, adaptation, seen

    whole, adaptation, seen = trainer(tmp_path / "whole")
    rows = whole.run(quiet=True)
    assert [row["roa/acts"] for row in rows] == [0.0, 1.0, 0.0, 1.0, 0.0]
    assert [row["roa/weight"] for row in rows] == pytest.approx([0.0, 0.1, 0.1, 0.1, 0.1])
    assert [row["estimator/used"] for row in rows] == [0.0, 0.0, 1.0, 1.0, 1.0]
    assert any(latent.requires_grad for latent in seen)
    torch.manual_seed(6)
    untrained = distill.build_adaptation(PROPRIO, teacher, SIZES, range(6, 8))
    obs = whole.ppo.rollout.obs
    error, before = (
        (each.velocity(each.window(obs)) - obs["explicit"]).square().mean().item() for each in (adaptation, untrained)
    )
    assert error < 0.9 * before

    first, _, _ = trainer(tmp_path / "cut")
    for _ in range(2):
        first.step()
    first.save()
    second, resumed, _ = trainer(tmp_path / "cut")
    second.run(quiet=True)
    for mine, theirs in zip(adaptation.parameters(), resumed.parameters(), strict=True):
        assert torch.equal(mine, theirs)
    for mine, theirs in zip(whole.model.parameters(), second.model.parameters(), strict=True):
        assert torch.equal(mine, theirs)


def test_the_policy_acts_on_the_history_latent_where_it_is_shown(task: TaskConfig, teacher: Policy) -> None:
    env = make(task)
    adaptation, obs = prepare(env, teacher), env.reset(seed=1)
    shown = {**obs, "latent": adaptation.latent(adaptation.window(obs)).detach()}
    shown["explicit"] = adaptation.velocity(adaptation.window(obs)).detach()
    expected = distill.AdaptedTeacher(teacher, adaptation).act(obs)
    torch.testing.assert_close(teacher.act(shown), expected, atol=1e-5, rtol=1e-5)
    assert not torch.allclose(teacher.act(obs), expected, atol=1e-3)


def test_a_seeing_student_of_the_shipped_teacher_learns(task: TaskConfig, teacher: Policy, tmp_path: Path) -> None:
    env = make(task)
    depth = distill.DepthEncoderConfig(
        (Convolution(8, 3, stride=2),), image_hidden=24, image_features=16, fusion=(24,), memory=24
    )
    config = distill.VisionTrainConfig(
        iterations=8, rollout_steps=40, segment=8, updates=12, batch=ROBOTS, learning_rate=2e-3, memory=2
    )
    student = distill.train_vision(
        env, teacher, tmp_path, config, distill.VisionStudentConfig(depth=depth), prepare(env, teacher), progress=False
    )
    rows = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    last = np.mean([row["action_loss"] for row in rows[-3:]])
    assert last < 0.75 * rows[0]["action_loss"]
    assert all(0.0 < row["predicted_use"] < 1.0 for row in rows)
    assert student.config.terrain_dim == teacher.scan_latent_dim == 32
    loaded = distill.load_vision_student(tmp_path / "student.pt", teacher)
    policy = distill.VisionPolicy(loaded, env)
    obs = env.reset(seed=9)
    assert policy.act(obs).shape == (ROBOTS, 12)


@pytest.mark.slow
def test_its_bundle_is_complete_and_runs(task: TaskConfig, teacher: Policy, tmp_path: Path) -> None:
    """An untrained student: both verifiers agree on its golden trace, and deploy runs it with its camera."""
    env, factory = make(task), find_factory("lite3")
    torch.manual_seed(1)
    student = distill.build_vision_student(env, teacher, distill.VisionStudentConfig(), prepare(env, teacher))
    spec = bundle_spec(factory, teacher, np.ones(4), {}, task.camera)  # pyright: ignore[reportArgumentType]
    folder = distill.export_vision_bundle(tmp_path / "bundle", student, spec)
    found = distill.verify_bundle(folder)
    assert max(found.errors.values()) < 1e-5
    depth = json.loads((folder / "manifest.json").read_text())["depth"]
    assert depth["inputs"] == {"depth": [1, 10, 15], "obs": [1, PROPRIO]}
    # the middle of the sensor is 30 rows down; of 58 rows left, 10 remain
    assert depth["camera"]["cy"] == pytest.approx(30 * 10 / 58)
    diagnosis = deploy.examine(folder)
    assert diagnosis.problems == ()
    assert {name: result.ticks for name, result in diagnosis.golden.items()} == {"onnx": 256, "torchscript": 256}
    pictures, seen = [], []
    log = tmp_path / "look.mcap"

    def look(sample: Sample) -> None:
        if (step := sample.tick.step) is not None:
            assert step.seen is not None
            seen.append(step.seen.tick)
            pictures.extend([] if step.picture is None else [step.picture])

    deploy.run(folder, (0.5, 0.0, 0.0), 0.4, log, on_tick=look)
    assert [picture.tick for picture in pictures[:3]] == [0, 5, 10]
    latency = depth["latency_ticks"]
    assert seen == [(tick - latency) // 5 * 5 if tick >= latency else -1 for tick in range(len(seen))]
    bundle = deploy.load_bundle(folder)
    replayed = deploy.replay(log, bundle, deploy.OnnxRuntime(bundle))
    assert (replayed.identical, replayed.first) == (len(seen), None)


@pytest.mark.slow
def test_the_simulated_camera_of_deploy_is_that_of_the_training(
    task: TaskConfig, teacher: Policy, tmp_path: Path
) -> None:
    """Flat ground from above, the two ray casters of the project on one pose."""
    from deploy.robots.mujoco_robot import MujocoRobot
    from locorl.env.depth_camera import DepthCamera, mounted
    from locorl.terrain.heights import HeightGrid

    env, factory = make(task), find_factory("lite3")
    camera = replace(task.camera, pitch=(10.0, 10.0))  # pyright: ignore[reportArgumentType]
    student = distill.build_vision_student(env, teacher, distill.VisionStudentConfig(), prepare(env, teacher))
    spec = bundle_spec(factory, teacher, np.ones(4), {}, camera)  # pyright: ignore[reportArgumentType]
    bundle = deploy.load_bundle(distill.export_vision_bundle(tmp_path / "bundle", student, spec))
    robot = MujocoRobot(bundle, joint_noise=0.0)
    frame = robot.read_depth()
    assert frame is not None
    truth = robot.truth()
    ground = HeightGrid(np.zeros((200, 200)), (-10.0, -10.0), cell=0.1)
    pose = torch.tensor(truth.position)[None], torch.tensor(truth.quat_wxyz)[None]
    expected = DepthCamera(camera, ground).render(*mounted(camera, *pose, torch.tensor([np.radians(10.0)])))[0]
    found = np.minimum(frame.image_m, camera.far)
    np.testing.assert_allclose(found, expected.numpy(), atol=2e-3)
    assert (found < camera.far).mean() > 0.3
