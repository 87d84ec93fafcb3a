"""Trainings that produce NaN stop, and leave a dump in which it happens again."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
import torch
from locorl import CheckpointError, DivergedError, Trainer, checkpoint
from locorl.training.faults import replay


def before_iteration(trainer: Trainer, iteration: int, poison) -> None:
    """Let `poison(trainer)` happen just before `iteration`, counted from 0."""
    choose = trainer.sampler.next

    def next_bodies(now, scores):
        designs = choose(now, scores)
        if now == iteration:
            poison(trainer)
        return designs

    trainer.sampler.next = next_bodies


def nan_command(trainer: Trainer) -> None:
    trainer.env.command[3, 0] = float("nan")


def nan_critic(trainer: Trainer) -> None:
    with torch.no_grad():
        next(trainer.model.critic.parameters()).fill_(float("nan"))


def nan_momentum(trainer: Trainer) -> None:
    # after the first minibatch the weights are not finite
    for state in trainer.ppo.optimizer.state.values():
        state["exp_avg"].fill_(float("nan"))


def huge_log_std(trainer: Trainer) -> None:
    with torch.no_grad():
        trainer.model.log_std.fill_(200.0)


@pytest.mark.parametrize("poison", [nan_command, nan_critic, nan_momentum, huge_log_std])
def test_a_fault_happens_again_in_its_dump(factory, tiny, tmp_path, poison):
    trainer = Trainer(factory, replace(tiny, save_every=1), tmp_path, threads=1)
    before_iteration(trainer, 2, poison)
    with pytest.raises(DivergedError, match=r"^iteration 3: (.|\n)*fault\.pt repeats it: `locorl train") as stopped:
        trainer.run(quiet=True)
    dump = checkpoint.load(tmp_path / "fault.pt")
    assert dump["fault"]["iteration"] == 3
    assert dump["fault"]["message"] in str(stopped.value)
    assert dump["config"]["seed"] == tiny.seed
    torch.manual_seed(123)
    with pytest.raises(DivergedError, match=re.escape(dump["fault"]["message"])) as again:
        replay(tmp_path / "fault.pt", factory, threads=1)
    assert (again.value.what, again.value.robots, again.value.step) == (
        stopped.value.what,
        stopped.value.robots,
        stopped.value.step,
    )
    if poison is nan_command:
        assert (again.value.what, again.value.robots) == ("observation", (3,))
    # the checkpoint of before stands
    content = checkpoint.load(tmp_path / "checkpoint.pt")
    assert content["iteration"] == 2
    assert all(values.isfinite().all() for values in content["model"].values())


def test_a_learning_rate_without_measure_is_caught(factory, tiny, tmp_path):
    ppo = replace(tiny.ppo, learning_rate=1e20, max_learning_rate=1e20)
    with pytest.raises(DivergedError):
        Trainer(factory, replace(tiny, ppo=ppo), tmp_path, threads=1).run(quiet=True)
    with pytest.raises(DivergedError):
        replay(tmp_path / "fault.pt", factory, threads=1)


def test_the_dump_is_the_state_before_the_rollout(factory, tiny, tmp_path):
    trainer = Trainer(factory, tiny, tmp_path / "fault", threads=1)
    update = trainer.ppo.update

    def fail() -> dict[str, float]:
        stats = update()
        if trainer.iteration == 2:
            raise DivergedError("out of the blue")
        return stats

    trainer.ppo.update = fail
    with pytest.raises(DivergedError, match="iteration 3: out of the blue"):
        trainer.run(quiet=True)
    dump, before = (checkpoint.load(tmp_path / "fault" / name) for name in ("fault.pt", "checkpoint.pt"))
    assert dump.pop("fault")["message"] == "out of the blue"
    for part in ("model", "ppo", "env", "sampler", "iteration"):
        torch.testing.assert_close(dump[part], before[part], rtol=0, atol=0)
    # what failed is no part of the run, so the iteration goes well this time: as in a run that nothing stopped
    whole = Trainer(factory, tiny, threads=1).run(quiet=True)
    metrics = replay(tmp_path / "fault" / "fault.pt", factory, threads=1)
    assert (metrics["iteration"], metrics["kl"]) == (3, whole[2]["kl"])


def test_nan_in_a_reward_names_the_robot(factory, tiny, tmp_path):
    trainer = Trainer(factory, tiny, tmp_path, threads=1)
    step = trainer.env.step

    def poisoned(action):
        obs, reward, *rest = step(action)
        reward[5] = float("nan")
        return obs, reward, *rest

    trainer.env.step = poisoned
    with pytest.raises(DivergedError, match=r"reward is not finite for 1 of 8 robots \(5\)"):
        trainer.run(quiet=True)
    fault = checkpoint.load(tmp_path / "fault.pt")["fault"]
    assert (fault["what"], fault["robots"], fault["step"], fault["iteration"]) == ("reward", [5], 0, 1)


def test_bodies_that_have_just_changed_are_in_the_dump(factory, tiny, tmp_path):
    config = replace(tiny, morphology=replace(tiny.morphology, kind="adaptive", every=2))
    trainer = Trainer(factory, config, tmp_path, threads=1)
    before_iteration(trainer, 2, nan_critic)
    with pytest.raises(DivergedError):
        trainer.run(quiet=True)
    dump = checkpoint.load(tmp_path / "fault.pt")
    assert not torch.equal(dump["designs"], checkpoint.load(tmp_path / "checkpoint.pt")["designs"])
    with pytest.raises(DivergedError, match=re.escape(dump["fault"]["message"])):
        replay(tmp_path / "fault.pt", factory, threads=1)


def test_without_a_folder_the_run_stops_all_the_same(factory, tiny):
    trainer = Trainer(factory, tiny, threads=1)
    before_iteration(trainer, 1, nan_command)
    with pytest.raises(DivergedError, match=r"^iteration 2: the observation group 'proprio' is not finite"):
        trainer.run(quiet=True)


def test_a_dump_that_cannot_be_written_hides_no_fault(factory, tiny, tmp_path, monkeypatch):
    trainer = Trainer(factory, tiny, tmp_path, threads=1)
    before_iteration(trainer, 1, nan_command)

    def full(*args: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(torch, "save", full)
    with pytest.raises(DivergedError, match=r"not finite(.|\n)*No dump was made: .*No space left"):
        trainer.run(quiet=True)


def test_a_checkpoint_is_no_dump(factory, tiny, tmp_path):
    Trainer(factory, replace(tiny, iterations=1), tmp_path, threads=1).run(quiet=True)
    with pytest.raises(CheckpointError, match=r"checkpoint\.pt is no dump of a fault"):
        replay(tmp_path / "checkpoint.pt", factory)
    with pytest.raises(CheckpointError, match=r"no checkpoint at .*fault\.pt"):
        replay(tmp_path / "fault.pt", factory)
