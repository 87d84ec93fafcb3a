"""Imitation: what is learned, how a run goes on, and how it stops."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from distill import (
    CheckpointError,
    InterfaceError,
    StudentConfig,
    StudentPolicy,
    TrainConfig,
    TrainingDiverged,
    build_student,
    load_student,
    train,
)
from distill.evaluate import evaluate

SMALL = TrainConfig(iterations=6, rollout_steps=8, segment=2, beta_iterations=2, ring_rollouts=3, updates=3, batch=32)
LEARN = TrainConfig(
    iterations=40, rollout_steps=16, segment=20, updates=24, batch=256, ring_rollouts=16, learning_rate=3e-3
)
TINY = StudentConfig(history=6, frame_features=8, channels=(8, 8), encoder_features=16, actor_hidden=(16,))


def run(env, teacher, folder: Path, config: TrainConfig = SMALL, student: StudentConfig = TINY, **options):
    return train(env, teacher, folder, config, student, progress=False, **options)


def metrics(folder: Path) -> list[dict[str, float]]:
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


def test_the_student_reads_the_hidden_load_from_its_history(make_env, teacher, tmp_path):
    """The load has variance 0.25 per joint: ours must infer it, one without a past cannot."""
    architecture = StudentConfig(history=8, frame_features=48, channels=(32, 32))
    scores, losses = {}, {}
    for name, config in (("history", architecture), ("present", replace(architecture, history=1))):
        env = make_env()
        student = run(env, teacher, tmp_path / name, LEARN, config)
        losses[name] = metrics(tmp_path / name)[-1]["action_loss"]
        policy = StudentPolicy(student, env.num_envs)
        scores[name] = evaluate(env, policy, steps=40, seed=99).returns.mean().item()
    best = evaluate(make_env(), teacher, steps=40, seed=99).returns.mean().item()
    assert losses["history"] < 0.25 * losses["present"]
    assert best - scores["history"] < 0.4 * (best - scores["present"])


def test_a_teacher_without_encoder_is_imitated_too(make_env, plain_teacher, tmp_path):
    config = StudentConfig(history=8, actor_hidden=(128,))
    run(make_env(), plain_teacher, tmp_path, LEARN, config)
    rows = metrics(tmp_path)
    assert rows[-1]["action_loss"] < 0.2 * rows[0]["action_loss"]
    assert all(row["latent_loss"] == 0.0 for row in rows)


def test_the_backbone_starts_as_a_copy_that_leaves_the_teacher_alone(make_env, teacher, tmp_path):
    before = teacher.actor.weight.clone()
    teacher.actor.requires_grad_(False)
    student = run(make_env(), teacher, tmp_path)
    assert torch.equal(teacher.actor.weight, before)
    assert not torch.equal(student.actor.weight, before)
    assert (student.actor.weight - before).abs().max() < 0.1


def test_an_interrupted_run_goes_on_bit_by_bit(make_env, teacher, tmp_path):
    whole = run(make_env(), teacher, tmp_path / "whole")

    class Interrupted(type(make_env())):
        def step(self, action):
            if self.steps == 3 * SMALL.rollout_steps + 5:  # in the middle of the second segment
                raise KeyboardInterrupt
            return super().step(action)

    with pytest.raises(KeyboardInterrupt):
        run(Interrupted(), teacher, tmp_path / "cut")
    assert not (tmp_path / "cut" / "student.pt").exists()
    torch.manual_seed(12345)  # the caller's random state is no part of the run
    resumed = run(make_env(), teacher, tmp_path / "cut")
    for name, weight in whole.state_dict().items():
        assert torch.equal(weight, resumed.state_dict()[name]), name
    rows = [metrics(tmp_path / name) for name in ("whole", "cut")]
    for mine, theirs in zip(*rows, strict=True):
        assert {**mine, "seconds": 0} == {**theirs, "seconds": 0}
    assert [row["iteration"] for row in rows[1]] == list(range(SMALL.iterations))


def test_a_finished_run_is_not_repeated(make_env, teacher, tmp_path):
    first = run(make_env(), teacher, tmp_path)
    env = make_env()
    again = run(env, teacher, tmp_path)
    assert env.steps == 0
    assert all(torch.equal(a, b) for a, b in zip(first.parameters(), again.parameters(), strict=True))


def test_training_leaves_the_callers_random_state_alone(make_env, teacher, tmp_path):
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    run(make_env(), teacher, tmp_path)
    assert torch.equal(torch.rand(3), expected)


def test_the_teacher_drives_less_and_less(make_env, teacher, tmp_path):
    run(make_env(), teacher, tmp_path)
    assert [row["beta"] for row in metrics(tmp_path)] == [1.0, 0.5, 0.0, 0.0, 0.0, 0.0]
    # Driven by its teacher, the toy reaches every reference exactly.
    assert metrics(tmp_path)[0]["reward_per_step"] == pytest.approx(0.0, abs=1e-9)
    assert metrics(tmp_path)[3]["reward_per_step"] < -1e-3


@pytest.mark.parametrize("where", ["proprio", "label"])
def test_a_value_that_is_not_finite_stops_and_keeps_the_checkpoint(make_env, teacher, tmp_path, where):
    class Failing(type(make_env())):
        def observe(self):
            obs = super().observe()
            if where == "proprio" and self.steps > 3 * SMALL.rollout_steps:
                obs["proprio"][1, 2] = float("nan")
            return obs

    act = teacher.act
    env = Failing()
    if where == "label":
        teacher.act = lambda obs: act(obs) * (float("inf") if env.steps > 3 * SMALL.rollout_steps else 1.0)
    with pytest.raises(TrainingDiverged, match="proprio" if where == "proprio" else "teacher's 'action'"):
        run(env, teacher, tmp_path)
    assert torch.load(tmp_path / "checkpoint.pt", weights_only=True)["iteration"] == 2


def test_a_loss_that_overflows_stops_and_keeps_the_checkpoint(make_env, teacher, tmp_path):
    act, env = teacher.act, make_env()
    teacher.act = lambda obs: act(obs) + (1e30 if env.steps > 3 * SMALL.rollout_steps else 0.0)
    with pytest.raises(TrainingDiverged, match=r"iteration 3: the loss is not finite \(total inf, action inf"):
        run(env, teacher, tmp_path)
    assert torch.load(tmp_path / "checkpoint.pt", weights_only=True)["iteration"] == 2


@pytest.mark.parametrize("keep", [0, 100, 0.5])
def test_a_truncated_checkpoint_is_named(make_env, teacher, tmp_path, keep):
    run(make_env(), teacher, tmp_path)
    path = tmp_path / "checkpoint.pt"
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data)) if isinstance(keep, float) else keep])
    with pytest.raises(CheckpointError, match=r"checkpoint\.pt: not a readable checkpoint"):
        run(make_env(), teacher, tmp_path)


def test_a_checkpoint_that_carries_code_is_refused(make_env, teacher, tmp_path):
    class Harmful:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "ran",))

    torch.save({"format": 1, "student": Harmful()}, tmp_path / "checkpoint.pt")
    with pytest.raises(CheckpointError):
        run(make_env(), teacher, tmp_path)
    assert not (tmp_path / "ran").exists()


def test_a_checkpoint_of_other_settings_is_refused_and_can_be_overruled(make_env, teacher, tmp_path):
    run(make_env(), teacher, tmp_path)
    other = replace(SMALL, batch=16)
    with pytest.raises(CheckpointError, match="another config"):
        run(make_env(), teacher, tmp_path, other)
    with pytest.raises(CheckpointError, match="another num_envs"):
        run(make_env(num_envs=32), teacher, tmp_path)
    with pytest.raises(CheckpointError, match="another architecture"):
        run(make_env(), teacher, tmp_path, student=replace(TINY, history=7))
    run(make_env(), teacher, tmp_path, other, resume=False)
    assert [row["iteration"] for row in metrics(tmp_path)] == list(range(SMALL.iterations))


def test_a_full_disk_keeps_the_checkpoint(make_env, teacher, tmp_path, monkeypatch):
    save, calls = torch.save, []

    def full(payload, file):
        calls.append(payload)
        if len(calls) == 2:
            file.write(b"half")
            raise OSError(28, "No space left on device")
        save(payload, file)

    monkeypatch.setattr(torch, "save", full)
    with pytest.raises(CheckpointError, match=r"checkpoint\.pt: cannot be written .*No space left"):
        run(make_env(), teacher, tmp_path)
    assert torch.load(tmp_path / "checkpoint.pt", weights_only=True)["iteration"] == 2
    assert {path.name for path in tmp_path.iterdir()} == {"checkpoint.pt", "metrics.jsonl"}


def test_a_student_is_read_back_and_belongs_to_its_teacher(make_env, teacher, plain_teacher, tmp_path):
    trained = run(make_env(), teacher, tmp_path)
    loaded = load_student(tmp_path / "student.pt", teacher)
    history = torch.randn(3, 6, trained.proprio)
    for mine, theirs in zip(loaded.infer(history), trained.infer(history), strict=True):
        assert torch.equal(mine, theirs)
    with pytest.raises(CheckpointError, match="another teacher"):
        load_student(tmp_path / "student.pt", plain_teacher)


def test_environments_and_teachers_that_break_the_contract_are_named(make_env, teacher, tmp_path):
    env = make_env()
    env.group_dims = {"proprio": 36}
    with pytest.raises(InterfaceError, match="no observation group 'explicit'"):
        run(env, teacher, tmp_path)
    env.group_dims = {"proprio": 36, "explicit": 9}
    with pytest.raises(InterfaceError, match="'explicit' is 9 wide"):
        run(env, teacher, tmp_path)
    env = make_env()
    env.group_dims["proprio"] = 35
    with pytest.raises(InterfaceError, match="does not accept"):
        run(env, teacher, tmp_path)
    act = teacher.act
    teacher.act = lambda obs: act(obs)[:1]
    with pytest.raises(InterfaceError, match=r"'action' has shape \(1, 12\), expected \(64, 12\)"):
        run(make_env(), teacher, tmp_path)


class TerrainTeacher:
    """Knows the load as two latents: the first joints' as one of the terrain, the others' as one of the body.

    Its linear actor reads [proprio, terrain, explicit, body], each with a weight of its own.
    """

    scan_latent_dim, latent_dim = 4, 8

    def __init__(self) -> None:
        eye, zero = torch.eye(12), torch.zeros(12, 12)
        self.actor = torch.nn.Linear(36 + 4 + 3 + 8, 12)
        with torch.no_grad():
            weight = torch.cat((-0.8 * eye, eye, zero, -eye[:, :4], torch.zeros(12, 3), -eye[:, 4:]), dim=1)
            self.actor.weight.copy_(weight)
            self.actor.bias.zero_()

    def act(self, obs):
        parts = (obs["proprio"], self.scan_latent(obs), obs["explicit"], self.latent(obs))
        return self.actor(torch.cat(parts, dim=1)).detach()

    def scan_latent(self, obs):
        return obs["implicit"][:, :4]

    def latent(self, obs):
        return obs["implicit"][:, 4:]


def test_a_blind_student_of_a_teacher_that_sees_the_terrain_infers_that_too(make_env, plain_teacher, tmp_path):
    env, teacher = make_env(), TerrainTeacher()
    obs = env.reset(seed=1)
    torch.testing.assert_close(teacher.act(obs), plain_teacher.act(obs))
    student = train(env, teacher, tmp_path, replace(SMALL, iterations=2), TINY, progress=False)
    assert (student.config.scan_dim, student.config.latent_dim) == (4, 8)
    # its backbone begins as the teacher's: told what the teacher knows, an untrained student acts as the teacher
    fresh = build_student(36, teacher, StudentConfig())
    fresh.encoder.forward = lambda history: torch.zeros(len(history), fresh.config.encoder_features)
    with torch.no_grad():
        fresh.latent.weight.zero_()
        fresh.latent.bias.copy_(obs["implicit"][0])
        action = fresh.infer(obs["proprio"][:1].unsqueeze(1).expand(-1, fresh.config.history, -1)).action
    torch.testing.assert_close(action, teacher.act({name: value[:1] for name, value in obs.items()}))
    again = load_student(tmp_path / "student.pt", teacher)
    history = torch.randn(3, student.config.history, 36)
    for mine, theirs in zip(again.infer(history), student.infer(history), strict=True):
        assert torch.equal(mine, theirs)
    assert again.infer(history).latent.shape == (3, 12)


def test_a_teacher_of_other_robots_is_refused(make_env, teacher, tmp_path):
    class SignedEnv(make_env):
        signature = property(lambda self: {"robot": "toy", "control period, s": 0.02, "colour": "red"})

    class SignedTeacher(type(teacher)):
        period = 0.01
        signature = property(lambda self: {"robot": "toy", "control period, s": self.period})

    with pytest.raises(InterfaceError, match=r"control period, s: 0\.01 in its training, 0\.02 here$"):
        run(SignedEnv(), SignedTeacher(), tmp_path)
    assert not list(tmp_path.iterdir())
    SignedTeacher.period = 0.02
    run(SignedEnv(num_envs=4), SignedTeacher(), tmp_path / "right", replace(SMALL, iterations=1))
    run(make_env(num_envs=4), SignedTeacher(), tmp_path / "silent", replace(SMALL, iterations=1))
