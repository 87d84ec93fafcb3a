"""Fine-tuning: from one file to one body, judged in between without being disturbed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import locorl.commands.finetune
import locorl.training.finetune
import numpy as np
import pytest
import torch
from locorl import (
    CheckpointError,
    CommandConfig,
    EvalConfig,
    FinetuneConfig,
    Policy,
    PPOConfig,
    Trainer,
    checkpoint,
    evaluate,
    finetune,
    load_policy,
)
from locorl.commands.finetune import Finetune
from locorl.training.metrics import read_metrics

TINY = FinetuneConfig(num_envs=8, iterations=2, ppo=PPOConfig(steps=6, epochs=2, minibatches=2))
CHOICE = EvalConfig(seconds=0.4, settle=0.1, robots_per_body=3, reset_joint=0.1, seed=9001)
CHOOSING = replace(TINY, iterations=4, evaluate_every=1, choice=CHOICE)
DESIGN = np.array([1.0, 1.2, 0.9, 1.1])


@pytest.fixture(scope="module")
def folder(factory, tiny, tmp_path_factory) -> Path:
    """A training's folder."""
    folder = tmp_path_factory.mktemp("generalist")
    Trainer(factory, replace(tiny, iterations=2), folder, threads=1).run(quiet=True)
    return folder


@pytest.fixture(scope="module")
def generalist(folder) -> Policy:
    return load_policy(folder / "policy.pt")


def same(a: Policy, b: Policy) -> bool:
    return all(torch.equal(x, y) for x, y in zip(a.model.parameters(), b.model.parameters(), strict=True))


def script(monkeypatch, *returns: float) -> list[int]:
    """Let the evaluations in between find these returns, in order, by robots that differ by 1."""
    calls: list[int] = []

    def scripted(policy, factory, designs, task, config, threads, simulator):
        calls.append(len(calls))
        values = returns[len(calls) - 1] + np.array([[-1.0, 0.0, 1.0]])
        return SimpleNamespace(returns=values, energy=values, survived=np.ones((1, 3), dtype=bool))

    monkeypatch.setattr(locorl.training.finetune, "evaluate", scripted)
    return calls


def test_fine_tuning_leaves_the_generalist_alone(factory, generalist):
    before = {name: values.clone() for name, values in generalist.model.state_dict().items()}
    tuned = finetune(generalist, factory, DESIGN, TINY, seed=3, threads=1)
    after = generalist.model.state_dict()
    assert all(torch.equal(before[name], after[name]) for name in before)
    moved = tuned.policy.model.state_dict()
    assert not torch.equal(moved["actor.0.weight"], before["actor.0.weight"])
    assert torch.allclose(moved["actor.0.weight"], before["actor.0.weight"], atol=0.05)  # it started from there
    assert [row["iteration"] for row in tuned.curve] == [1, 2]
    assert tuned.policy.card.samples == generalist.card.samples + TINY.samples
    assert tuned.policy.card.network == generalist.card.network
    assert (tuned.iteration, tuned.stopped, tuned.candidates) == (2, False, [])


def test_a_body_gets_the_same_policy_whatever_came_before(factory, folder):
    path = folder / "policy.pt"
    first = finetune(path, factory, DESIGN, TINY, seed=3, threads=1).policy
    finetune(path, factory, np.ones(4), TINY, seed=4, threads=1)
    assert same(finetune(path, factory, DESIGN, TINY, seed=3, threads=1).policy, first)
    assert same(finetune(load_policy(path), factory, DESIGN, TINY, seed=3, threads=1).policy, first)


def test_fine_tuning_trains_on_the_task_that_was_asked_for(factory, generalist):
    config = replace(TINY, iterations=1, command_vx=(0.4, 0.4), specific_power=-2.0)
    card = finetune(generalist, factory, np.ones(4), config, seed=0, threads=1).policy.card
    assert card.task.command == CommandConfig((0.4, 0.4), (0.0, 0.0), (0.0, 0.0), hold=10.0, standing=0.0)
    assert card.task.reward == replace(generalist.card.task.reward, specific_power=-2.0)


def test_a_finished_fine_tune_is_read_from_its_folder(factory, generalist, tmp_path):
    first = finetune(generalist, factory, np.ones(4), TINY, seed=0, folder=tmp_path, threads=1)
    again = finetune(generalist, factory, np.ones(4), TINY, seed=0, folder=tmp_path, threads=1)
    assert [row["reward"] for row in again.curve] == [row["reward"] for row in first.curve]
    assert again.policy.card == first.policy.card
    assert same(again.policy, first.policy)
    with pytest.raises(CheckpointError, match="another robot or another starting policy"):
        finetune(first.policy, factory, np.ones(4), TINY, seed=0, folder=tmp_path, threads=1)


@pytest.mark.parametrize(
    ("design", "message"),
    [
        ([1.0, 1.5, 1.0, 0.5], r"front_shank=1\.5 not in \[0\.6, 1\.4\], hind_shank=0\.5 not in"),
        ([1.4, 0.6, 0.6, 0.6], "has no stance"),
        ([1.0, 1.0], "has 4 parameters"),
    ],
)
def test_impossible_designs_are_refused(factory, generalist, design, message):
    with pytest.raises(ValueError, match=message):
        finetune(generalist, factory, np.array(design), TINY, seed=0, threads=1)


def test_evaluating_in_between_changes_nothing(factory, generalist):
    judged = finetune(generalist, factory, DESIGN, CHOOSING, seed=3, threads=1)
    left_alone = finetune(generalist, factory, DESIGN, replace(TINY, iterations=4), seed=3, threads=1)
    assert same(judged.policy, left_alone.policy)
    assert [row["reward"] for row in judged.curve] == [row["reward"] for row in left_alone.curve]
    assert [candidate.iteration for candidate in judged.candidates] == [0, 1, 2, 3, 4]
    assert same(judged.candidates[0].policy, generalist)
    assert same(judged.candidates[4].policy, left_alone.policy)
    # what a candidate counts is what an evaluation of it on the fine-tune's task counts
    for candidate in (judged.candidates[0], judged.candidates[3]):
        result = evaluate(candidate.policy, factory, DESIGN[None], generalist.card.task, CHOICE, threads=1)
        np.testing.assert_array_equal(candidate.returns, result.returns[0])
        np.testing.assert_array_equal(candidate.energy, result.energy[0])
        assert candidate.survived == result.survived.mean()


def test_the_best_is_kept(factory, generalist, monkeypatch):
    script(monkeypatch, 3.0, 5.0, 7.0, 6.0, 4.0)
    kept = finetune(generalist, factory, DESIGN, replace(CHOOSING, keep_best=True), seed=3, threads=1)
    assert kept.iteration == 2
    assert len(kept.curve) == 4
    # the policy of iteration 2 is that of a fine-tune of two iterations
    assert same(kept.policy, finetune(generalist, factory, DESIGN, TINY, seed=3, threads=1).policy)
    assert kept.policy.card.samples == generalist.card.samples + TINY.samples


def test_the_generalist_may_be_the_best(factory, generalist, monkeypatch):
    calls = script(monkeypatch, 3.0, 2.0)
    config = replace(TINY, keep_best=True, choice=CHOICE, specific_power=-2.0)
    kept = finetune(generalist, factory, DESIGN, config, seed=3, threads=1)
    assert len(calls) == 2  # at the start and at the end alone
    assert kept.iteration == 0
    assert same(kept.policy, generalist)
    assert kept.policy.card.samples == generalist.card.samples
    assert kept.policy.card.task.reward.specific_power == -2.0  # judged by what the fine-tune was about


def test_a_plateau_ends_it(factory, generalist, monkeypatch):
    # improvements at iteration 1 alone: each robot gains the same, so any gain is larger than its error
    script(monkeypatch, 3.0, 5.0, 4.9, 5.0)
    config = replace(CHOOSING, iterations=8, patience=2)
    tuned = finetune(generalist, factory, DESIGN, config, seed=3, threads=1)
    assert tuned.stopped
    assert [row["iteration"] for row in tuned.curve] == [1, 2, 3]
    assert tuned.iteration == 3  # the last one, as long as `keep_best` is not set
    assert same(tuned.policy, tuned.candidates[3].policy)
    assert tuned.policy.card.samples == generalist.card.samples + 3 * 48


def test_a_plateau_at_the_end_is_no_early_stop(factory, generalist, monkeypatch):
    script(monkeypatch, 3.0, 3.0, 3.0)
    config = replace(CHOOSING, iterations=2, patience=2)
    assert not finetune(generalist, factory, DESIGN, config, seed=3, threads=1).stopped


def test_an_interrupted_choice_goes_on(factory, generalist, monkeypatch, tmp_path):
    config = replace(CHOOSING, keep_best=True, evaluate_every=2)
    whole = finetune(generalist, factory, DESIGN, config, seed=3, folder=tmp_path / "whole", threads=1)

    def stop(*args):
        if args[0].card.samples > generalist.card.samples + 48:
            raise KeyboardInterrupt
        return evaluate(*args)

    with monkeypatch.context() as patch:
        patch.setattr(locorl.training.finetune, "evaluate", stop)
        with pytest.raises(KeyboardInterrupt):
            finetune(generalist, factory, DESIGN, config, seed=3, folder=tmp_path / "cut", threads=1)
    assert len(read_metrics(tmp_path / "cut" / "metrics.jsonl")) == 2
    cut = finetune(generalist, factory, DESIGN, config, seed=3, folder=tmp_path / "cut", threads=1)
    again = finetune(generalist, factory, DESIGN, config, seed=3, folder=tmp_path / "cut", threads=1)
    for other in (cut, again):
        assert other.iteration == whole.iteration
        assert same(other.policy, whole.policy)
        assert [row["reward"] for row in other.curve] == [row["reward"] for row in whole.curve]
        for one, two in zip(other.candidates, whole.candidates, strict=True):
            assert one.iteration == two.iteration
            np.testing.assert_array_equal(one.returns, two.returns)
            assert same(one.policy, two.policy)
    # candidates are policies
    assert load_policy(tmp_path / "cut" / "candidates" / "00002.pt").card.samples == generalist.card.samples + 96
    changed = replace(config, keep_best=False)
    with pytest.raises(CheckpointError, match=r"another fine-tune(.|\n)*\n  keep_best: True -> False$"):
        finetune(generalist, factory, DESIGN, changed, seed=3, folder=tmp_path / "cut", threads=1)


def test_a_longer_fine_tune_forgets_the_end_of_the_shorter(factory, generalist, tmp_path):
    config = replace(CHOOSING, iterations=3, evaluate_every=2)
    finetune(generalist, factory, DESIGN, config, seed=3, folder=tmp_path, threads=1)
    longer = finetune(generalist, factory, DESIGN, replace(config, iterations=4), seed=3, folder=tmp_path, threads=1)
    assert [candidate.iteration for candidate in longer.candidates] == [0, 2, 4]
    whole = finetune(generalist, factory, DESIGN, replace(config, iterations=4), seed=3, threads=1)
    assert same(longer.policy, whole.policy)


def adam_steps(path: Path) -> set[float]:
    return {float(state["step"]) for state in checkpoint.load(path)["ppo"]["optimizer"]["state"].values()}


@pytest.mark.parametrize(("optimizer", "earlier"), [("keep", 8), ("fresh", 0)])
def test_the_optimiser_goes_on_or_starts_fresh(factory, folder, tmp_path, optimizer, earlier):
    path = folder / "checkpoint.pt"
    assert adam_steps(path) == {8.0}  # 2 iterations of 2 epochs and 2 minibatches
    config = replace(TINY, iterations=1, optimizer=optimizer)
    tuned = finetune(path, factory, DESIGN, config, seed=3, folder=tmp_path, threads=1)
    assert adam_steps(tmp_path / "checkpoint.pt") == {earlier + 4.0}
    again = finetune(path, factory, DESIGN, config, seed=3, folder=tmp_path, threads=1)
    assert same(again.policy, tuned.policy)


def test_a_kept_learning_rate_stays_within_the_bounds(factory, folder, tmp_path):
    path = folder / "checkpoint.pt"
    assert checkpoint.load(path)["ppo"]["learning_rate"] > 1e-4
    slow = replace(TINY.ppo, learning_rate=2e-5, max_learning_rate=1e-4, desired_kl=1e-9)
    config = replace(TINY, iterations=1, optimizer="keep", ppo=slow)
    # the rate falls from its start by 1.5 at each of four minibatches, but the first, whose divergence is 0
    (row,) = finetune(path, factory, DESIGN, config, seed=3, threads=1).curve
    assert row["learning_rate"] == pytest.approx(1e-4 / 1.5**3)


def test_a_policy_without_its_optimiser_is_refused(factory, folder, generalist):
    config = replace(TINY, optimizer="keep")
    for bare, name in ((generalist, "a policy in memory"), (folder / "policy.pt", r".*policy\.pt")):
        with pytest.raises(CheckpointError, match=rf"{name} has no optimiser's state to keep.*checkpoint\.pt"):
            finetune(bare, factory, DESIGN, config, seed=3, threads=1)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"patience": 2}, "set evaluate_every"),
        ({"patience": 0, "evaluate_every": 1}, "patience is 0"),
        ({"evaluate_every": 0}, "evaluate_every is 0"),
    ],
)
def test_settings_that_contradict_each_other_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        FinetuneConfig(**wrong)


def test_the_command_prints_before_and_after(factory, folder, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(locorl.commands.finetune, "find_factory", lambda name: factory)
    monkeypatch.setenv("COLUMNS", "160")
    report = EvalConfig(seconds=0.4, settle=0.1, robots_per_body=5, reset_joint=0.1)
    config = replace(CHOOSING, iterations=2, keep_best=True)
    command = Finetune(
        folder / "policy.pt", tmp_path, tuple(DESIGN), config=config, evaluation=report, plot=tmp_path / "curve.png"
    )
    command.run()
    out = capsys.readouterr().out
    assert (tmp_path / "curve.png").read_bytes().startswith(b"\x89PNG")
    generalist, tuned = load_policy(folder / "policy.pt"), load_policy(tmp_path / "policy.pt")
    before, after = (
        evaluate(policy, factory, DESIGN[None], tuned.card.task, report, threads=1).returns[0]
        for policy in (generalist, tuned)
    )
    gain = after - before
    (row,) = [line for line in out.splitlines() if "return (eq. 9)" in line and "±" in line]
    cells = [cell.strip() for cell in row.split("│")[2:-1]]
    assert cells == [
        f"{before.mean():.4g} ± {before.std(ddof=1) / np.sqrt(5):.2g}",
        f"{after.mean():.4g} ± {after.std(ddof=1) / np.sqrt(5):.2g}",
        f"{gain.mean():+.4g} ± {gain.std(ddof=1) / np.sqrt(5):.2g}",
    ]
    assert "policies to choose from" in out
    assert "policy.pt is that of iteration" in out
    assert json.loads((tmp_path / "finetune.json").read_text())["keep_best"] is True


def test_what_chooses_does_not_report(factory, folder, tmp_path, monkeypatch):
    monkeypatch.setattr(locorl.commands.finetune, "find_factory", lambda name: factory)
    config = replace(CHOOSING, choice=replace(CHOICE, seed=0))
    with pytest.raises(ValueError, match="what chose a policy cannot report"):
        Finetune(folder / "policy.pt", tmp_path, tuple(DESIGN), config=config).run()


# ---------------------------------------------------------------- hooks


class Counting:
    """A hook that learns one number from the past frames that it is shown, and notes what it was attached to."""

    name = "counting"

    def __init__(self) -> None:
        self.weight, self.iterations, self.model = torch.zeros(()), [], None

    def begin(self, iteration):
        assert self.model is not None
        self.iterations.append(iteration)

    def observe(self, obs):
        return obs

    def end(self, rollout):
        self.weight = self.weight + rollout.obs["history"].square().mean()
        return {"weight": self.weight.item()}

    def loss(self, batch):
        return None

    def parameters(self):
        return ()

    def state_dict(self):
        return {"weight": self.weight}

    def load_state_dict(self, state):
        self.weight = state["weight"]


def hooked(generalist, factory, folder, config):
    hook = Counting()
    tuned = finetune(
        generalist,
        factory,
        DESIGN,
        config,
        seed=3,
        folder=folder,
        threads=1,
        hooks=[hook],
        attach=lambda model: setattr(hook, "model", model),
    )
    return tuned, hook


def test_hooks_learn_beside_a_fine_tune_and_go_on_where_it_stopped(generalist, factory, tmp_path):
    config = replace(TINY, iterations=3, history=2)
    whole, hook = hooked(generalist, factory, tmp_path / "whole", config)
    assert hook.iterations == [0, 1, 2]
    assert hook.model is whole.policy.model
    assert [row["counting/weight"] > 0.0 for row in whole.curve] == [True] * 3
    assert whole.policy.card.task.observation.history == 2
    assert generalist.card.task.observation.history == 0
    _, first = hooked(generalist, factory, tmp_path / "cut", replace(config, iterations=2))
    assert first.iterations == [0, 1]
    cut, second = hooked(generalist, factory, tmp_path / "cut", config)
    assert second.iterations == [2]
    assert torch.equal(second.weight, hook.weight)
    assert same(cut.policy, whole.policy)


def test_a_fine_tune_without_its_hooks_is_not_resumed(generalist, factory, tmp_path):
    config = replace(TINY, history=2)
    hooked(generalist, factory, tmp_path, config)
    with pytest.raises(ValueError, match="give it the same"):
        finetune(generalist, factory, DESIGN, replace(config, iterations=3), seed=3, folder=tmp_path, threads=1)
