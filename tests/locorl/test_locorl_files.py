"""Files: configurations there and back, checkpoints all or nothing, nothing executed on reading."""

from __future__ import annotations

import itertools
import json
import os
import pickle
import re
import time
from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from locorl import CheckpointError, FinetuneConfig, TaskConfig, TrainConfig, checkpoint, load_policy, table_i
from locorl.bodies.family import BodyFamily
from locorl.config import config_hash, differences, from_dict, to_dict
from locorl.learning.policy import PolicyCard
from locorl.training.metrics import MetricsFile, TrainingProgress, read_metrics

CARD = PolicyCard("box", ("a", "b"), (0.5, 0.6), (1.0, 2.0), {"proprio": 3}, TaskConfig(), TrainConfig().network, 7, 1)
positive = st.floats(min_value=0.0, exclude_min=True, allow_infinity=False)


@given(
    st.builds(TrainConfig, num_envs=st.integers(1), seed=st.integers(0), task=st.builds(TaskConfig, max_tilt=positive))
)
def test_a_configuration_comes_back(config):
    text = json.dumps(to_dict(config))
    assert from_dict(TrainConfig, json.loads(text)) == config


@pytest.mark.parametrize(
    "config",
    [
        replace(TrainConfig(), task=TaskConfig(reward=table_i())),  # no cap
        FinetuneConfig(command_vx=(0.6, 0.6), specific_power=-1.0),
        FinetuneConfig(),
        CARD,
        replace(CARD, family=BodyFamily({"scaling": "paper"}, (40.0,) * 12, (0.5, 0.7) * 6)),
    ],
)
def test_nested_fields_and_tuples_come_back(config):
    again = from_dict(type(config), to_dict(config))
    assert again == config
    assert config_hash(to_dict(again)) == config_hash(to_dict(config))


def test_an_unknown_field_is_named():
    data = to_dict(TrainConfig())
    data["task"]["reward"]["bonus"] = 1.0
    with pytest.raises(ValueError, match=r"RewardConfig has no field \['bonus'\]"):
        from_dict(TrainConfig, data)


def test_differences_name_the_field_and_both_values():
    old, new = TrainConfig(seed=1), TrainConfig(seed=1, task=TaskConfig(reward=table_i()))
    lines = differences(to_dict(old), to_dict(new))
    assert "task.reward.kernel: gaussian -> l1" in lines
    assert not any(line.startswith("seed") for line in lines)
    assert differences(to_dict(old), to_dict(old)) == []
    assert config_hash(to_dict(old)) != config_hash(to_dict(new))


def test_a_checkpoint_comes_back(tmp_path):
    path = tmp_path / "new" / "a.pt"
    checkpoint.save(path, {"weights": torch.arange(3.0), "note": [1, "x"]})
    content = checkpoint.load(path)
    assert torch.equal(content["weights"], torch.arange(3.0))
    assert content["note"] == [1, "x"]
    assert [file.name for file in path.parent.iterdir()] == ["a.pt"]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), MemoryError("No space left")])
@pytest.mark.parametrize("write", [checkpoint.save, checkpoint.save_next])
@pytest.mark.parametrize("failing", ["save", "fsync", "replace"])
def test_a_failing_write_leaves_the_old_file(tmp_path, monkeypatch, failing, write, error):
    path = tmp_path / "a.pt"
    checkpoint.save(path, {"value": 1})

    def fail(*args: object, **kwargs: object) -> None:
        if failing == "save":
            args[1].write(b"half a check")
        raise error

    monkeypatch.setattr(torch if failing == "save" else os, failing, fail)
    with pytest.raises(CheckpointError, match=r"a\.pt.*No space left.*previous file is untouched"):
        write(path, {"value": 2})
    monkeypatch.undo()
    assert checkpoint.load(path)["value"] == 1
    assert [file.name for file in tmp_path.iterdir()] == ["a.pt"]


def test_the_file_before_the_newest_is_kept(tmp_path):
    path = tmp_path / "a.pt"
    assert checkpoint.load_newest(path) is None
    for value in (1, 2, 3):
        checkpoint.save_next(path, {"value": value})
    assert checkpoint.load(path)["value"] == 3
    assert checkpoint.load(checkpoint.previous(path))["value"] == 2
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.previous.pt", "a.pt"]
    content, warning = checkpoint.load_newest(path)
    assert (content["value"], warning) == (3, "")
    path.write_bytes(path.read_bytes()[:-1])
    content, warning = checkpoint.load_newest(path)
    assert content["value"] == 2
    assert "a.pt is not readable" in warning
    checkpoint.save_next(path, {"value": 4})  # the damaged file does not take the good one's place
    assert checkpoint.load(checkpoint.previous(path))["value"] == 2
    assert checkpoint.load(path)["value"] == 4


def test_a_file_of_a_newer_version_is_not_damaged(tmp_path):
    path = tmp_path / "a.pt"
    checkpoint.save(checkpoint.previous(path), {"value": 1})
    torch.save({"format": 99}, path)
    with pytest.raises(CheckpointError, match="checkpoint format 99"):
        checkpoint.load_newest(path)


def test_a_file_that_cannot_be_read_now_is_not_damaged(tmp_path, monkeypatch):
    path = tmp_path / "a.pt"
    for value in (1, 2):
        checkpoint.save_next(path, {"value": value})

    def fail(*args: object, **kwargs: object) -> None:
        raise MemoryError

    monkeypatch.setattr(torch, "load", fail)
    for attempt in (lambda: checkpoint.load_newest(path), lambda: checkpoint.save_next(path, {"value": 3})):
        with pytest.raises(CheckpointError, match=r"cannot read .*a\.pt: MemoryError"):
            attempt()
    monkeypatch.undo()
    assert checkpoint.load(path)["value"] == 2
    assert checkpoint.load(checkpoint.previous(path))["value"] == 1


@pytest.mark.parametrize("write", [checkpoint.save, checkpoint.save_next])
def test_a_disk_that_is_really_full_leaves_the_old_file(tmp_path, write):
    resource = pytest.importorskip("resource")
    path = tmp_path / "a.pt"
    checkpoint.save(path, {"value": 1})
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))  # files end here
    try:
        with pytest.raises(CheckpointError, match=r"cannot write .*a\.pt.*previous file is untouched"):
            write(path, {"value": torch.zeros(100_000)})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert checkpoint.load(path)["value"] == 1
    assert [file.name for file in tmp_path.iterdir()] == ["a.pt"]


def test_a_folder_that_cannot_be_written_to_is_named(tmp_path):
    (tmp_path / "file").write_text("I am no folder")
    with pytest.raises(CheckpointError, match=r"cannot write to .*file.*choose another folder"):
        checkpoint.save(tmp_path / "file" / "a.pt", {})


class Bomb:
    def __reduce__(self) -> tuple[object, ...]:
        return os.system, ("touch exploded",)


@pytest.mark.parametrize("writer", ["torch", "pickle"])
def test_code_in_a_checkpoint_is_not_executed(tmp_path, monkeypatch, writer):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "bomb.pt"
    content = {"format": 1, "bomb": Bomb()}
    if writer == "torch":
        torch.save(content, path)
    else:
        path.write_bytes(pickle.dumps(content, protocol=2))
    with pytest.raises(CheckpointError, match=r"bomb\.pt is not a readable checkpoint"):
        checkpoint.load(path)
    assert not (tmp_path / "exploded").exists()


def test_what_is_no_checkpoint_is_named(tmp_path):
    with pytest.raises(CheckpointError, match=r"no checkpoint at .*none\.pt"):
        checkpoint.load(tmp_path / "none.pt")
    future = tmp_path / "future.pt"
    torch.save({"format": 99}, future)
    with pytest.raises(CheckpointError, match=r"future\.pt: checkpoint format 99, this version of locorl reads 1"):
        checkpoint.load(future)
    text = tmp_path / "notes.txt"
    text.write_text("no checkpoint")
    with pytest.raises(CheckpointError) as refused:
        checkpoint.load(text)
    assert "another kind of file" in str(refused.value)
    assert "weights_only" not in str(refused.value)  # torch's advice is to execute what is in the file
    other = tmp_path / "other.pt"
    checkpoint.save(other, {"kind": "something else"})
    with pytest.raises(CheckpointError, match=r"other\.pt holds no policy"):
        load_policy(other)


def test_metrics_drop_what_will_be_written_again(tmp_path):
    path = tmp_path / "metrics.jsonl"
    log = MetricsFile(path)
    for iteration in range(1, 6):
        log.write({"iteration": iteration, "reward": iteration / 2})
    with path.open("a") as file:
        file.write('{"iteration": 6, "rew')  # the machine went down here
    assert [row["iteration"] for row in read_metrics(path)] == [1, 2, 3, 4, 5]
    log = MetricsFile(path, keep_until=3)
    log.write({"iteration": 4, "reward": 9.0})
    assert [json.loads(line) for line in path.read_text().splitlines()] == [
        {"iteration": 1, "reward": 0.5},
        {"iteration": 2, "reward": 1.0},
        {"iteration": 3, "reward": 1.5},
        {"iteration": 4, "reward": 9.0},
    ]


def test_progress_without_a_terminal_tells_the_time_left(capsys, monkeypatch):
    clock = itertools.count(100, 11)  # a line every ten seconds at most
    monkeypatch.setattr("locorl.training.metrics.time.monotonic", lambda: next(clock))
    with TrainingProgress("train", 100, 40) as progress:
        for done in (41, 42, 100):
            time.sleep(0.1)
            progress.update(done, f"note {done}")
    lines = capsys.readouterr().out.split("\n")
    assert lines[0] == "train 41/100 note 41"
    seconds = re.fullmatch(r"train 42/100 note 42  0:00:(\d\d) left", lines[1])
    assert seconds is not None
    assert 6 <= int(seconds[1]) <= 30  # 58 iterations of a little more than 0.1 s
    assert lines[2] == "train 100/100 note 100"
