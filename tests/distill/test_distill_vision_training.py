"""Training of a seeing student: what each part and each ablation is worth, how a run goes on, and how it stops."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from distill import (
    AdaptationConfig,
    CheckpointError,
    DepthEncoderConfig,
    InterfaceError,
    TrainingDiverged,
    VisionPolicy,
    VisionStudentConfig,
    VisionTrainConfig,
    build_adaptation,
    load_vision_student,
    train_vision,
)
from distill.evaluate import evaluate
from distill.vision import Convolution
from vision_toy import HEADING, PROPRIO, TERRAIN, WIDTH, BlindToyTeacher, VisionToy, VisionToyTeacher

BLANK = tuple(range(HEADING.start, HEADING.stop))
# the toy's images are of brightness, whose inverse means nothing
DEPTH = DepthEncoderConfig(
    (Convolution(8, 3, stride=2),), image_hidden=24, image_features=16, fusion=(32,), memory=32, contrast=False
)
STUDENT = VisionStudentConfig(
    depth=DEPTH,
    adaptation=AdaptationConfig(history=3, frame_features=48, channels=(48,), features=48, estimator=()),
    actor_hidden=(64,),
)
TINY = replace(
    STUDENT,
    depth=DepthEncoderConfig((Convolution(4, 3, 2),), image_hidden=8, image_features=4, fusion=(8,), memory=8),
    adaptation=AdaptationConfig(history=3, frame_features=8, channels=(8,), features=8, estimator=()),
)
SHORT = VisionTrainConfig(iterations=6, rollout_steps=10, segment=2, memory=2, updates=2, batch=8)
LEARN = VisionTrainConfig(
    iterations=60, rollout_steps=40, segment=30, memory=2, updates=8, batch=32, learning_rate=5e-3, roa=False
)


def prepared(config: AdaptationConfig = TINY.adaptation, seed: int = 3):
    torch.manual_seed(seed)
    return build_adaptation(PROPRIO, VisionToyTeacher(), config, BLANK)


def run(folder: Path, env=None, teacher=None, config=SHORT, student=TINY, adaptation=None, **options):
    env, teacher = env or VisionToy(8), teacher or VisionToyTeacher()
    if config.roa and adaptation is None:
        adaptation = prepared()
    return train_vision(env, teacher, folder, config, student, adaptation, progress=False, **options)


def metrics(folder: Path) -> list[dict[str, float]]:
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


# -------------------------------------------------------------------------------------------- what is learnt


@pytest.mark.slow
def test_it_learns_to_see_and_a_blind_one_cannot(tmp_path):
    """The second heading has no part in the motion: only an image tells it."""
    rows = {}
    for name, blind in (("seeing", False), ("blind", True)):
        config = replace(LEARN, iterations=12, segment=12)
        student = run(tmp_path / name, VisionToy(32), config=config, student=replace(STUDENT, blind=blind))
        rows[name] = metrics(tmp_path / name)[-1]
        env = VisionToy(32)
        assert evaluate(env, VisionPolicy(student, env), steps=40, seed=99).survived.all()
    assert rows["seeing"]["predicted_use"] > 0.97
    assert rows["seeing"]["within_half_threshold"] > 0.9
    assert rows["seeing"]["heading_error"] < 0.1
    # a guess of 0 is within 0.3 of 0.7 tanh(normal) in 35 of 100 cases
    assert rows["blind"]["within_half_threshold"] < 0.6


def test_losses_fall_and_the_gate_opens(tmp_path):
    run(
        tmp_path,
        VisionToy(32),
        config=replace(LEARN, iterations=16, rollout_steps=20, latent_supervision=True),
        student=STUDENT,
    )
    first, last = metrics(tmp_path)[0], metrics(tmp_path)[-1]
    for name in ("action_loss", "heading_loss", "terrain_loss", "velocity_loss", "heading_error"):
        assert last[name] < 0.8 * first[name], name
    assert last["predicted_use"] > first["predicted_use"] + 0.1


def test_without_mts_the_prediction_is_always_used(tmp_path):
    run(tmp_path / "mts")
    run(tmp_path / "none", config=replace(SHORT, mts=False))
    assert all(row["predicted_use"] == 1.0 for row in metrics(tmp_path / "none"))
    assert all(0.0 < row["predicted_use"] < 1.0 for row in metrics(tmp_path / "mts"))


def test_with_roa_the_prepared_networks_stay_as_they_are(tmp_path):
    adaptation = prepared()
    student = run(tmp_path, adaptation=adaptation)
    for mine, theirs in zip(student.adaptation.parameters(), adaptation.parameters(), strict=True):
        assert torch.equal(mine, theirs)
        assert mine is not theirs
    assert all(row["velocity_loss"] == 0.0 for row in metrics(tmp_path))


def test_without_roa_they_are_trained_from_scratch(tmp_path):
    adaptation = prepared()
    student = run(tmp_path, config=replace(SHORT, roa=False), adaptation=adaptation)
    for name in ("estimator", "encoder"):
        pairs = zip(getattr(student.adaptation, name).parameters(), getattr(adaptation, name).parameters(), strict=True)
        assert not any(torch.equal(mine, theirs) for mine, theirs in pairs)
    assert metrics(tmp_path)[0]["velocity_loss"] > 0.0


def test_terrain_is_supervised_only_if_asked(tmp_path):
    run(tmp_path / "plain")
    run(tmp_path / "supervised", config=replace(SHORT, latent_supervision=True))
    assert all(row["terrain_loss"] == 0.0 for row in metrics(tmp_path / "plain"))
    assert metrics(tmp_path / "supervised")[0]["terrain_loss"] > 0.0


def test_the_backbone_starts_as_a_copy_that_leaves_the_teacher_alone(tmp_path):
    teacher = VisionToyTeacher()
    teacher.actor.requires_grad_(False)
    before = teacher.actor.weight.clone()
    student = run(tmp_path, teacher=teacher)
    assert torch.equal(teacher.actor.weight, before)
    assert 0.0 < (student.actor.weight - before).abs().max() < 0.1


def test_a_teacher_that_opens_nothing_is_imitated_too(tmp_path):
    config = replace(LEARN, iterations=12, rollout_steps=20)
    student = run(tmp_path, VisionToy(32), BlindToyTeacher(), config, STUDENT)
    rows = metrics(tmp_path)
    assert rows[-1]["action_loss"] < 0.5 * rows[0]["action_loss"]
    assert student.config.latent_dim == STUDENT.latent_dim
    assert student.actor[0].in_features == PROPRIO + 32 + 3 + 20


# ----------------------------------------------------------------------------------------------- going on


def test_an_interrupted_run_goes_on_bit_by_bit(tmp_path):
    whole = run(tmp_path / "whole")

    class Interrupted(VisionToy):
        def step(self, action):
            if self.steps == 3 * SHORT.rollout_steps + 5:  # in the middle of the second segment
                raise KeyboardInterrupt
            return super().step(action)

    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "cut", Interrupted(8))
    assert not (tmp_path / "cut" / "student.pt").exists()
    torch.manual_seed(12345)  # the caller's random state is no part of the run
    resumed = run(tmp_path / "cut")
    for name, weight in whole.state_dict().items():
        assert torch.equal(weight, resumed.state_dict()[name]), name
    rows = [metrics(tmp_path / name) for name in ("whole", "cut")]
    for mine, theirs in zip(*rows, strict=True):
        assert {**mine, "seconds": 0} == {**theirs, "seconds": 0}
    assert [row["iteration"] for row in rows[1]] == list(range(SHORT.iterations))


def test_training_leaves_the_callers_random_state_alone(tmp_path):
    adaptation, teacher = prepared(), VisionToyTeacher()
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    run(tmp_path, teacher=teacher, adaptation=adaptation)
    assert torch.equal(torch.rand(3), expected)


def test_a_student_is_read_back_and_belongs_to_its_teacher(tmp_path):
    trained = run(tmp_path)
    loaded = load_vision_student(tmp_path / "student.pt", VisionToyTeacher())
    assert (loaded.config, loaded.heading, loaded.depth_shape) == (trained.config, HEADING, (8, 12))
    inputs = torch.randn(3, PROPRIO), torch.randn(3, TERRAIN), torch.randn(3, 2), torch.randn(3, 3, PROPRIO)
    for mine, theirs in zip(loaded(*inputs), trained(*inputs), strict=True):
        assert torch.equal(mine, theirs)
    with pytest.raises(CheckpointError, match="another teacher"):
        load_vision_student(tmp_path / "student.pt", BlindToyTeacher())
    torch.save({"format": 2, "student": {"kind": "blind"}}, tmp_path / "blind.pt")
    with pytest.raises(CheckpointError, match="a blind student, not a seeing one"):
        load_vision_student(tmp_path / "blind.pt", VisionToyTeacher())


def test_a_checkpoint_of_other_settings_is_refused_and_can_be_overruled(tmp_path):
    run(tmp_path)
    for message, change in {
        "another config": {"config": replace(SHORT, threshold=0.3)},
        "another architecture": {"student": replace(TINY, latency=0)},
        "another num_envs": {"env": VisionToy(4)},
    }.items():
        with pytest.raises(CheckpointError, match=message):
            run(tmp_path, **change)
    run(tmp_path, config=replace(SHORT, threshold=0.3), resume=False)
    assert [row["iteration"] for row in metrics(tmp_path)] == list(range(SHORT.iterations))


# ----------------------------------------------------------------------------------------------- bad input


class Failing(VisionToy):
    """Gives something that is not finite after the first segment."""

    def __init__(self, where: str) -> None:
        super().__init__(8)
        self.where = where

    def step(self, action):
        result = super().step(action)
        if self.steps > 3 * SHORT.rollout_steps:
            if self.where == "depth":
                self.depth[1, 2, 3] = float("nan")
            else:
                result[0][self.where][1, 2] = float("inf")
        return result


@pytest.mark.parametrize("where", ["depth", "proprio", "explicit"])
def test_a_value_that_is_not_finite_stops_and_keeps_the_checkpoint(tmp_path, where):
    with pytest.raises(TrainingDiverged, match=f"the environment's '{where}'"):
        run(tmp_path, Failing(where))
    assert torch.load(tmp_path / "checkpoint.pt", weights_only=True)["iteration"] == 2


def test_images_in_metres_are_refused(tmp_path):
    class Metres(VisionToy):
        def look(self):
            return 2.0 * super().look() + 1.0

    with pytest.raises(InterfaceError, match=r"'depth' reaches .*-0\.5 \(near\) to 0\.5 \(far\)"):
        run(tmp_path, Metres(8))


def test_what_does_not_fit_together_is_named(tmp_path):
    with pytest.raises(InterfaceError, match=r"pass `adaptation`.*roa=False"):
        train_vision(VisionToy(4), VisionToyTeacher(), tmp_path, SHORT, TINY)
    with pytest.raises(InterfaceError, match="multiple of the camera's period, 5 steps"):
        run(tmp_path, config=replace(SHORT, rollout_steps=12))
    with pytest.raises(InterfaceError, match="no scan latent to supervise"):
        run(tmp_path, teacher=BlindToyTeacher(), config=replace(SHORT, latent_supervision=True, roa=False))
    other = build_adaptation(PROPRIO, VisionToyTeacher(), TINY.adaptation)
    with pytest.raises(InterfaceError, match=r"of which \(\) are blank"):
        run(tmp_path, adaptation=other)
    env = VisionToy(4)
    env.heading = slice(PROPRIO, PROPRIO + 1)
    with pytest.raises(InterfaceError, match="heading columns"):
        run(tmp_path, env)
    env = VisionToy(4)
    env.depth_shape = (8, 13)
    with pytest.raises(InterfaceError, match=r"'depth' has shape \(4, 8, 12\), expected \(4, 8, 13\)"):
        run(tmp_path, env)
    teacher = VisionToyTeacher()
    teacher.scan_latent_dim = TERRAIN + 1
    with pytest.raises(InterfaceError, match=r"does not accept \[proprio 38, scan latent 5, velocity 3, latent 12\]"):
        run(tmp_path, teacher=teacher)
    teacher = VisionToyTeacher()
    teacher.act = lambda obs: torch.zeros(8, WIDTH + 1)
    with pytest.raises(InterfaceError, match=r"'action' has shape \(8, 13\), expected \(8, 12\)"):
        run(tmp_path, teacher=teacher)
