"""Training runs: a function of the seed, and of nothing else, however often they are killed."""

from __future__ import annotations

import itertools
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from locorl import (
    CheckpointError,
    CurriculumConfig,
    TrainConfig,
    Trainer,
    checkpoint,
    make_task,
    sample_designs,
)
from locorl.bodies.samplers import MorphologyConfig
from locorl.config import config_hash, to_dict
from locorl.learning.config import PPGConfig
from locorl.training.metrics import read_metrics
from locorl.training.resume import identity
from locorl_box import BoxQuadruped


def equal(a: object, b: object) -> bool:
    """Bit-equality of nested checkpoint content."""
    if isinstance(a, torch.Tensor):
        return isinstance(b, torch.Tensor) and torch.equal(a, b)
    if isinstance(a, dict):
        return isinstance(b, dict) and a.keys() == b.keys() and all(equal(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(equal(x, y) for x, y in zip(a, b, strict=True))
    return a == b


def train(factory, config, folder=None, **options) -> Trainer:
    trainer = Trainer(factory, config, folder, threads=1, **options)
    trainer.run(quiet=True)
    return trainer


@pytest.fixture(scope="module")
def whole(factory, tiny, tmp_path_factory) -> Path:
    """A folder with an uninterrupted run of four iterations."""
    folder = tmp_path_factory.mktemp("whole")
    train(factory, tiny, folder)
    return folder


def test_a_run_leaves_its_files(whole, tiny):
    assert sorted(path.name for path in whole.iterdir()) == [
        "checkpoint.previous.pt",
        "checkpoint.pt",
        "config.json",
        "metrics.jsonl",
        "policy.pt",
    ]
    rows = read_metrics(whole / "metrics.jsonl")
    assert [row["iteration"] for row in rows] == [1, 2, 3, 4]
    assert [row["samples"] for row in rows] == [48, 96, 144, 192]
    assert all(np.isfinite(value) for row in rows for value in row.values())
    config = json.loads((whole / "config.json").read_text())
    assert config["robot"] == "box"
    assert config["num_envs"] == 8
    assert checkpoint.load(whole / "policy.pt")["card"]["samples"] == 192


def test_the_seed_decides_the_weights(factory, tiny, whole):
    same = train(factory, tiny).model.state_dict()
    other = train(factory, replace(tiny, seed=1)).model.state_dict()
    saved = checkpoint.load(whole / "checkpoint.pt")["model"]
    assert equal(dict(same), dict(saved))
    assert not equal(dict(other), dict(saved))
    fresh = Trainer(factory, tiny, threads=1).model.state_dict()
    assert not equal(dict(fresh), dict(saved))  # training did change them


def test_every_robot_has_a_body_of_its_own(whole, factory):
    designs = checkpoint.load(whole / "checkpoint.pt")["designs"].numpy()
    # the stream of bodies, so that trainings of before repeat themselves
    stream = int(np.random.SeedSequence(0).spawn(4)[0].generate_state(1)[0])
    np.testing.assert_array_equal(designs, sample_designs(factory, 8, np.random.default_rng(stream)))
    assert len(np.unique(designs.round(6), axis=0)) == 8
    assert ((designs >= 0.6) & (designs <= 1.4)).all()


def test_a_resumed_run_is_bit_identical(factory, tiny, whole, tmp_path):
    train(factory, replace(tiny, iterations=2), tmp_path)
    torch.manual_seed(123)  # the second half must not lean on the global stream
    resumed = Trainer(factory, tiny, tmp_path, threads=1)
    assert resumed.iteration == 2
    assert len(resumed.run(quiet=True)) == 2
    assert equal(checkpoint.load(tmp_path / "checkpoint.pt"), checkpoint.load(whole / "checkpoint.pt"))

    timing = {"seconds", "collect_seconds", "samples_per_second"}
    ours, theirs = (
        [{k: v for k, v in row.items() if k not in timing} for row in read_metrics(folder / "metrics.jsonl")]
        for folder in (tmp_path, whole)
    )
    assert ours == theirs


class Killed(BaseException):
    """The process ends here."""


def killed_in(factory, config, folder, iteration: int) -> None:
    """Train until `iteration`, counted from 0, is being learned from."""
    trainer = Trainer(factory, config, folder, threads=1)
    update = trainer.ppo.update

    def die() -> dict[str, float]:
        if trainer.iteration == iteration:
            raise Killed
        return update()

    trainer.ppo.update = die
    with pytest.raises(Killed):
        trainer.run(quiet=True)


SWITCHING = {
    "temporal": MorphologyConfig(kind="temporal", bodies=3),  # switches in front of iterations 2 and 4 of 5
    "adaptive": MorphologyConfig(kind="adaptive", every=2),
}


@pytest.fixture(scope="module", params=SWITCHING)
def switching(request, factory, tiny, tmp_path_factory) -> tuple[TrainConfig, Path]:
    """A configuration whose bodies switch, and a folder with an uninterrupted run of it."""
    folder = tmp_path_factory.mktemp("switching")
    config = replace(tiny, iterations=5, save_every=1, morphology=SWITCHING[request.param])
    train(factory, config, folder)
    return config, folder


# a checkpoint of just before a switch, of just after one, and of the iteration between two
@pytest.mark.parametrize("iteration", [2, 3, 4])
def test_a_run_resumed_across_a_switch_is_bit_identical(factory, switching, tmp_path, iteration):
    config, folder = switching
    killed_in(factory, config, tmp_path, iteration)
    torch.manual_seed(123)
    resumed = Trainer(factory, config, tmp_path, threads=1)
    assert resumed.iteration == iteration
    resumed.run(quiet=True)
    assert equal(checkpoint.load(tmp_path / "checkpoint.pt"), checkpoint.load(folder / "checkpoint.pt"))


def test_the_bodies_switch_on_time_and_in_place(factory, switching):
    config, folder = switching
    trainer = Trainer(factory, config, threads=1)
    simulator, bodies, collect = trainer.env.sim, [], trainer.ppo.collect

    def watched(env, obs):
        bodies.append(np.asarray(env.bodies.designs).copy())
        # what the policy sees is the body that it has: its design comes first in the implicit group, over [-1, 1]
        seen = 1.0 + 0.4 * obs["implicit"][:, :4].numpy()
        np.testing.assert_allclose(seen, bodies[-1], atol=1e-6)
        return collect(env, obs)

    trainer.ppo.collect = watched
    trainer.run(quiet=True)
    assert trainer.env.sim is simulator
    assert [not np.array_equal(a, b) for a, b in itertools.pairwise(bodies)] == [False, True, False, True]
    assert equal(dict(trainer.model.state_dict()), dict(checkpoint.load(folder / "checkpoint.pt")["model"]))
    if config.morphology.kind == "temporal":
        assert [len(np.unique(designs, axis=0)) for designs in bodies] == [1] * 5


def test_the_sampler_hears_of_each_robots_tracking_error(factory, tiny):
    trainer = Trainer(factory, replace(tiny, iterations=3, morphology=SWITCHING["adaptive"]), threads=1)
    errors, heard, step, choose = [], [], trainer.env.step, trainer.sampler.next

    def watched(action):
        result = step(action)
        errors.append(result[4].tracking_error.clone())
        return result

    def listening(iteration, scores):
        heard.append(scores.clone())
        return choose(iteration, scores)

    trainer.env.step, trainer.sampler.next = watched, listening
    trainer.run(quiet=True)
    torch.testing.assert_close(heard[2], torch.stack(errors[:12]).mean(dim=0))  # two iterations of 6 steps


def test_a_longer_adaptive_run_goes_on(factory, tiny, tmp_path):
    config = replace(tiny, morphology=SWITCHING["adaptive"])
    train(factory, config, tmp_path / "whole")
    train(
        factory, replace(config, iterations=2, save_every=1), tmp_path / "longer"
    )  # ends where the bodies would have switched
    train(factory, config, tmp_path / "longer")
    ends = [checkpoint.load(tmp_path / name / "checkpoint.pt") for name in ("whole", "longer")]
    assert equal(*ends)


def test_bodies_that_take_turns_have_no_longer_run(factory, tiny, tmp_path):
    config = replace(tiny, iterations=3, morphology=SWITCHING["temporal"])
    train(factory, config, tmp_path)
    with pytest.raises(CheckpointError, match=r"another configuration(.|\n)*\n  iterations: 3 -> 9$"):
        Trainer(factory, replace(config, iterations=9), tmp_path, threads=1)


@pytest.mark.parametrize("kind", ["none", "grid", "sobol"])
def test_the_configuration_decides_the_bodies(factory, tiny, kind):
    designs = Trainer(factory, replace(tiny, morphology=MorphologyConfig(kind=kind)), threads=1).env.bodies.designs
    on_grid = np.isin(designs.round(9), (0.6, 1.0, 1.4)).all()
    assert on_grid == (kind != "sobol")
    assert len(np.unique(designs, axis=0)) == (1 if kind == "none" else 8)


def test_a_finished_run_is_not_repeated(factory, tiny, whole):
    before = (whole / "checkpoint.pt").read_bytes()
    assert Trainer(factory, tiny, whole, threads=1).run(quiet=True) == []
    assert (whole / "checkpoint.pt").read_bytes() == before
    assert len(read_metrics(whole / "metrics.jsonl")) == 4


def test_what_came_after_the_last_checkpoint_is_done_again_and_logged_once(factory, tiny, whole, tmp_path):
    config = replace(tiny, iterations=3, save_every=2)
    trainer = Trainer(factory, config, tmp_path, threads=1)
    trainer.save = lambda: Trainer.save(trainer) if trainer.iteration == 2 else None  # killed right after iteration 3
    trainer.run(quiet=True)
    assert [row["iteration"] for row in read_metrics(tmp_path / "metrics.jsonl")] == [1, 2, 3]
    train(factory, tiny, tmp_path)
    assert [row["iteration"] for row in read_metrics(tmp_path / "metrics.jsonl")] == [1, 2, 3, 4]
    assert equal(checkpoint.load(tmp_path / "checkpoint.pt"), checkpoint.load(whole / "checkpoint.pt"))


def test_a_truncated_checkpoint_is_named(factory, tiny, whole, tmp_path):
    content = (whole / "checkpoint.pt").read_bytes()
    path = tmp_path / "checkpoint.pt"
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(CheckpointError, match=r"checkpoint\.pt is not a readable checkpoint.*truncated"):
        Trainer(factory, tiny, tmp_path, threads=1)


def test_another_configuration_is_refused_with_the_difference(factory, tiny, whole):
    changed = replace(tiny, ppo=replace(tiny.ppo, gamma_reg=0.99))
    with pytest.raises(CheckpointError, match=r"another configuration(.|\n)*\n  ppo\.gamma_reg: 0\.98 -> 0\.99$"):
        Trainer(factory, changed, whole, threads=1)


def test_another_robot_is_refused(tiny, whole):
    with pytest.raises(CheckpointError, match=r"another robot(.|\n)*robot: box -> crate"):
        Trainer(BoxQuadruped("crate"), tiny, whole, threads=1)


def test_other_bodies_are_refused(factory, tiny, whole):
    with pytest.raises(CheckpointError, match="other bodies"):
        Trainer(factory, tiny, whole, designs=np.ones((8, 4)), threads=1)


def test_a_policy_is_no_training(factory, tiny, whole, tmp_path):
    (tmp_path / "checkpoint.pt").write_bytes((whole / "policy.pt").read_bytes())
    with pytest.raises(CheckpointError, match="holds a policy but no training to resume"):
        Trainer(factory, tiny, tmp_path, threads=1)


def test_a_folder_that_cannot_be_written_to_is_named(factory, tiny, tmp_path):
    (tmp_path / "file").write_text("I am no folder")
    with pytest.raises(CheckpointError, match=r"cannot write to .*file"):
        train(factory, tiny, tmp_path / "file")


def test_too_few_designs_are_refused(factory, tiny):
    with pytest.raises(ValueError, match="3 designs for 8 robots"):
        Trainer(factory, tiny, designs=np.ones((3, 4)), threads=1)


def damaged(folder: Path, how: str) -> None:
    """Do to the newest checkpoint in `folder` what a crash or a bad disk may do."""
    path = folder / "checkpoint.pt"
    content = bytearray(path.read_bytes())
    if how == "lost":
        path.unlink()
    elif how == "one byte":
        content[len(content) // 2] ^= 0xFF
        path.write_bytes(content)
    else:
        path.write_bytes(content[: {"empty": 0, "half": len(content) // 2, "last byte": len(content) - 1}[how]])


@pytest.mark.parametrize("how", ["empty", "half", "last byte", "one byte", "lost"])
def test_the_checkpoint_before_takes_over(factory, tiny, whole, tmp_path, capsys, how):
    folder = tmp_path / "run"
    shutil.copytree(whole, folder)
    damaged(folder, how)
    trainer = Trainer(factory, tiny, folder, threads=1)
    assert trainer.iteration == 2
    out = " ".join(capsys.readouterr().out.split())
    assert ("missing" if how == "lost" else "not readable") in out
    assert "going on from the checkpoint before it, checkpoint.previous.pt, of iteration 2" in out
    trainer.run(quiet=True)
    assert equal(checkpoint.load(folder / "checkpoint.pt"), checkpoint.load(whole / "checkpoint.pt"))
    assert [row["iteration"] for row in read_metrics(folder / "metrics.jsonl")] == [1, 2, 3, 4]
    # a damaged file takes no good one's place
    assert checkpoint.load(folder / "checkpoint.previous.pt")["iteration"] == 2


def test_a_write_that_was_killed_leaves_nothing_for_ever(factory, tiny, tmp_path):
    script = """
import os, signal, sys, torch
from pathlib import Path
from locorl import checkpoint
torch.save = lambda content, file: (file.write(b"half"), os.kill(os.getpid(), signal.SIGKILL))
checkpoint.save(Path(sys.argv[1]) / "checkpoint.pt", {})
"""
    killed = subprocess.run([sys.executable, "-c", script, str(tmp_path)])
    assert killed.returncode == -signal.SIGKILL
    assert len(list(tmp_path.iterdir())) == 1
    train(factory, replace(tiny, iterations=1), tmp_path)
    assert all(not path.name.startswith(".") for path in tmp_path.iterdir())


def test_two_damaged_checkpoints_are_named(factory, tiny, whole, tmp_path):
    for name in ("checkpoint.pt", "checkpoint.previous.pt"):
        (tmp_path / name).write_bytes((whole / "checkpoint.pt").read_bytes()[:1000])
    with pytest.raises(CheckpointError, match=r"checkpoint\.previous\.pt is not a readable checkpoint"):
        Trainer(factory, tiny, tmp_path, threads=1)


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), MemoryError()])
def test_a_failing_checkpoint_loses_nothing(factory, tiny, whole, tmp_path, monkeypatch, error):
    trainer = Trainer(factory, tiny, tmp_path, threads=1)
    written = torch.save

    def fail(content, file) -> None:
        if trainer.iteration == 4 and "ppo" in content:
            file.write(b"half a check")
            raise error
        written(content, file)

    monkeypatch.setattr(torch, "save", fail)
    with pytest.raises(CheckpointError, match="previous file is untouched"):
        trainer.run(quiet=True)
    monkeypatch.undo()
    assert checkpoint.load(tmp_path / "checkpoint.pt")["iteration"] == 2
    assert [row["iteration"] for row in read_metrics(tmp_path / "metrics.jsonl")] == [1, 2, 3, 4]
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "checkpoint.pt",
        "config.json",
        "metrics.jsonl",
        "policy.pt",
    ]
    train(factory, tiny, tmp_path)
    assert equal(checkpoint.load(tmp_path / "checkpoint.pt"), checkpoint.load(whole / "checkpoint.pt"))


def test_a_full_disk_while_writing_metrics_is_named(factory, tiny, tmp_path, monkeypatch):
    trainer = Trainer(factory, tiny, tmp_path, threads=1)
    opened = Path.open

    def fail(path, mode="r", *args, **kwargs):
        if mode == "a" and trainer.iteration == 3:
            raise OSError(28, "No space left on device")
        return opened(path, mode, *args, **kwargs)

    monkeypatch.setattr(Path, "open", fail)
    with pytest.raises(CheckpointError, match=r"metrics\.jsonl.*No space left"):
        trainer.run(quiet=True)
    monkeypatch.undo()
    assert [row["iteration"] for row in read_metrics(tmp_path / "metrics.jsonl")] == [1, 2]


def test_a_checkpoint_knows_the_hash_of_its_configuration(tiny, whole):
    assert checkpoint.load(whole / "checkpoint.pt")["config_hash"] == config_hash(identity(to_dict(tiny)))


@pytest.mark.parametrize(
    "changes",
    [
        {"regulariser": "activation", "v_max": 0.1},
        {"regulariser": "ppg", "ppg": PPGConfig(policy_iterations=3, minibatches=2)},  # stopped within a phase
        {"mirror": True},
    ],
    ids=lambda changes: next(iter(changes.values())),
)
def test_every_way_to_learn_resumes_bit_identically(factory, tiny, tmp_path, changes):
    config = replace(tiny, ppo=replace(tiny.ppo, **changes))
    train(factory, config, tmp_path / "whole")
    train(factory, replace(config, iterations=2), tmp_path / "halves")
    train(factory, config, tmp_path / "halves")
    ends = [checkpoint.load(tmp_path / name / "checkpoint.pt") for name in ("whole", "halves")]
    assert equal(*ends)
    plain = train(factory, tiny).model.state_dict()
    assert not equal(dict(plain), dict(ends[0]["model"]))


class NoisyBias:
    """A hook that learns a number and draws from torch's default stream."""

    name = "bias"

    def __init__(self) -> None:
        self.bias = torch.nn.Parameter(torch.zeros(1))
        self.seen = 0

    def begin(self, iteration: int) -> None:
        self.seen += 1

    def observe(self, obs):
        return {**obs, "explicit": obs["explicit"] + 0.1 * torch.randn(obs["explicit"].shape)}

    def end(self, rollout) -> dict[str, float]:
        return {"seen": float(self.seen)}

    def loss(self, batch) -> torch.Tensor:
        return (batch.obs["explicit"] - self.bias).square().mean()

    def parameters(self) -> list[torch.nn.Parameter]:
        return [self.bias]

    def state_dict(self) -> dict[str, object]:
        return {"bias": self.bias.detach().clone(), "seen": self.seen}

    def load_state_dict(self, state) -> None:
        with torch.no_grad():
            self.bias.copy_(state["bias"])
        self.seen = state["seen"]


def test_hooks_are_resumed_too(factory, tiny, tmp_path):
    train(factory, tiny, tmp_path / "whole", hooks=[NoisyBias()])
    train(factory, replace(tiny, iterations=2), tmp_path / "halves", hooks=[NoisyBias()])
    torch.manual_seed(123)
    hook = NoisyBias()
    train(factory, tiny, tmp_path / "halves", hooks=[hook])
    assert hook.seen == 4
    assert float(hook.bias.detach()) != 0.0
    ends = [checkpoint.load(tmp_path / name / "checkpoint.pt") for name in ("whole", "halves")]
    assert equal(*ends)
    assert [row["bias/seen"] for row in read_metrics(tmp_path / "halves" / "metrics.jsonl")] == [1, 2, 3, 4]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"num_envs": 0}, "num_envs must be at least 1, got 0"),
        ({"iterations": -1}, "iterations must be at least 0, got -1"),
        ({"save_every": 0}, "save_every must be at least 1, got 0"),
        ({"seed": -3}, "seed must be at least 0, got -3"),
        ({"num_envs": 1, "ppo": {"steps": 3, "minibatches": 4}}, "1 robots x 3 steps are too few.*4 minibatches"),
        ({"num_envs": 1, "ppo": {"steps": 1, "minibatches": 1}}, "too few samples.*at least 2"),
    ],
)
def test_impossible_configurations_are_refused(tiny, changes, message):
    if "ppo" in changes:
        changes = {**changes, "ppo": replace(tiny.ppo, **changes["ppo"])}
    with pytest.raises(ValueError, match=message):
        replace(tiny, **changes)


SCRIPT = """
import json, sys
from pathlib import Path
from locorl import TrainConfig, Trainer
from locorl.config import from_dict
from locorl.learning.distributed import Processes
from locorl_box import BoxQuadruped
import torch

torch.set_num_threads(1)
config = from_dict(TrainConfig, json.loads(sys.argv[2]))
group = Processes.from_environment()
Trainer(BoxQuadruped(), config, Path(sys.argv[1]), threads=1, group=group).run(quiet=True)
if group:
    group.close()
"""
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(__file__).parent), "OMP_NUM_THREADS": "1"}


def climbing(config: TrainConfig) -> TrainConfig:
    """Stairs with a curriculum that moves, and bodies that adapt."""
    # robots that come forward at all go up
    curriculum = CurriculumConfig(promote=0.01, demote=0.0, least=0.0)
    task = replace(make_task("locomotion-steps"), episode_seconds=0.2, curriculum=curriculum)
    return replace(config, task=task, morphology=MorphologyConfig(kind="adaptive", every=7))


@pytest.mark.slow
@pytest.mark.parametrize("change", [lambda config: config, climbing], ids=["flat", "climbing"])
def test_a_process_killed_at_any_moment_resumes_to_the_same_weights(factory, tiny, tmp_path, change):
    config = change(replace(tiny, iterations=40, save_every=3))
    whole = train(factory, config, tmp_path / "whole")
    if change is climbing:
        levels = checkpoint.load(tmp_path / "whole" / "checkpoint.previous.pt")["env"]["curriculum.level"]
        assert not torch.equal(levels, whole.env.curriculum.level)  # it does move
    killed, moment = tmp_path / "killed", random.Random()
    command = [sys.executable, "-c", SCRIPT, str(killed), json.dumps(to_dict(config))]
    for least in (5, 20):
        process = subprocess.Popen(command, env=ENVIRONMENT)
        try:
            deadline = time.monotonic() + 120
            while len(read_metrics(killed / "metrics.jsonl")) < least:
                assert process.poll() is None, "the run ended before it could be killed"
                assert time.monotonic() < deadline
                time.sleep(0.005)
            time.sleep(moment.uniform(0.0, 0.1))
        finally:
            process.send_signal(signal.SIGKILL)
            process.wait()
        assert checkpoint.load(killed / "checkpoint.pt")["iteration"] < 40
    subprocess.run(command, env=ENVIRONMENT, check=True)
    assert equal(*(checkpoint.load(folder / "checkpoint.pt") for folder in (killed, tmp_path / "whole")))
    rows = read_metrics(killed / "metrics.jsonl")
    assert [row["iteration"] for row in rows] == list(range(1, 41))


@pytest.mark.slow
def test_two_processes_train_together_and_resume(factory, tiny, tmp_path):
    config = replace(tiny, morphology=MorphologyConfig(kind="adaptive", every=3))
    start = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)

    def together(folder: Path, iterations: int) -> None:
        settings = json.dumps(to_dict(replace(config, iterations=iterations)))
        subprocess.run([*start, str(script), str(folder), settings], env=ENVIRONMENT, check=True)

    together(tmp_path / "whole", 4)
    together(tmp_path / "halves", 2)
    together(tmp_path / "halves", 4)
    ends = [checkpoint.load(tmp_path / name / "checkpoint.pt") for name in ("whole", "halves")]
    assert equal(*ends)
    first, other = ends[0], ends[0]["others"][0]
    assert equal(first["model"], other["model"])
    assert not equal(first["env"], other["env"])
    # each has its own part of the bodies that the sampler dealt
    designs = torch.cat((first["designs"], other["designs"]))
    assert torch.equal(designs, first["sampler"]["designs"])
    assert [row["samples"] for row in read_metrics(tmp_path / "whole" / "metrics.jsonl")] == [48, 96, 144, 192]
    with pytest.raises(CheckpointError, match="one of 2 processes, here are 1"):
        Trainer(factory, config, tmp_path / "whole", threads=1)
