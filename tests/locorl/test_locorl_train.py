"""Training runs: a function of the seed, and of nothing else, however often they are killed."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from locorl import CheckpointError, DivergedError, TrainConfig, Trainer, checkpoint, sample_designs
from locorl.bodies.samplers import MorphologyConfig
from locorl.config import to_dict
from locorl.training.metrics import read_metrics
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
    train(factory, replace(config, iterations=2), tmp_path / "longer")  # ends where the bodies would have switched
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


def test_divergence_leaves_the_last_checkpoint(factory, tiny, tmp_path):
    trainer = Trainer(factory, tiny, tmp_path, threads=1)
    update = trainer.ppo.update

    def poisoned() -> dict[str, float]:
        if trainer.iteration == 2:
            with torch.no_grad():
                next(trainer.model.critic.parameters()).fill_(float("nan"))
        return update()

    trainer.ppo.update = poisoned
    with pytest.raises(DivergedError):
        trainer.run(quiet=True)
    content = checkpoint.load(tmp_path / "checkpoint.pt")
    assert content["iteration"] == 2
    assert all(values.isfinite().all() for values in content["model"].values())


SCRIPT = """
import json, sys
from pathlib import Path
from locorl import TrainConfig, Trainer
from locorl.config import from_dict
from locorl_box import BoxQuadruped
import torch

torch.set_num_threads(1)
config = from_dict(TrainConfig, json.loads(sys.argv[2]))
Trainer(BoxQuadruped(), config, Path(sys.argv[1]), threads=1).run(quiet=True)
"""


@pytest.mark.slow
def test_a_killed_process_resumes_to_the_same_weights(factory, tiny, tmp_path):
    config = replace(tiny, iterations=40, save_every=5)
    train(factory, config, tmp_path / "whole")
    command = [sys.executable, "-c", SCRIPT, str(tmp_path / "killed"), json.dumps(to_dict(config))]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent), "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(command, env=environment)
    try:
        deadline = time.monotonic() + 120
        while len(read_metrics(tmp_path / "killed" / "metrics.jsonl")) < 12:
            assert process.poll() is None, "the run ended before it could be killed"
            assert time.monotonic() < deadline
            time.sleep(0.005)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert checkpoint.load(tmp_path / "killed" / "checkpoint.pt")["iteration"] < 40
    subprocess.run(command, env=environment, check=True)
    assert equal(
        checkpoint.load(tmp_path / "killed" / "checkpoint.pt"), checkpoint.load(tmp_path / "whole" / "checkpoint.pt")
    )
    rows = read_metrics(tmp_path / "killed" / "metrics.jsonl")
    assert [row["iteration"] for row in rows] == list(range(1, 41))
