"""The predicted cost of a training: right by hand, and without a trace in the run."""

from __future__ import annotations

import pytest
import torch
from locorl import Trainer, checkpoint
from locorl.training.cost import Cost, in_words, predict


def test_the_prediction_follows_from_the_trial(factory, tiny, monkeypatch):
    trainer = Trainer(factory, tiny, threads=1)
    trainer.iteration = 1
    trials = []

    def step(trial):
        trials.append(trial)
        return {"collect_seconds": 1.0, "seconds": 3.0}

    monkeypatch.setattr(Trainer, "step", step)
    cost = predict(trainer)
    # a minibatch has 24 rows: 8 robots x 3 steps
    assert trials[0].config.num_envs * trials[0].config.ppo.steps == 24
    assert trials[0].config.ppo.minibatches == 1
    # 3 iterations of 48 samples; 24 samples take 1 s to collect and 2 s to learn from, which is done twice
    assert cost.samples == 3 * 48
    assert cost.seconds == pytest.approx(3 * 2 * (1.0 + 2 * 2.0))
    assert trainer not in trials


def test_the_prediction_leaves_no_trace(factory, tiny, tmp_path):
    for name in ("plain", "predicted"):
        trainer = Trainer(factory, tiny, tmp_path / name, threads=1)
        if name == "predicted":
            cost = predict(trainer)
            assert cost.samples == 4 * 48
            assert 0.0 < cost.seconds < 60.0
            assert cost.memory is None or 5e7 < cost.memory < 2e10
        trainer.run(quiet=True)
    plain, predicted = (checkpoint.load(tmp_path / name / "checkpoint.pt") for name in ("plain", "predicted"))
    for part in ("model", "ppo", "env", "torch_generator"):
        torch.testing.assert_close(plain[part], predicted[part], rtol=0, atol=0)


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (20, "less than a minute"),
        (59, "less than a minute"),
        (89, "about 1 min"),
        (200, "about 3 min"),
        (9 * 60, "about 9 min"),
        (9.7 * 60, "about 10 min"),
        (23 * 60, "about 25 min"),
        (87 * 60, "about 85 min"),
        (89 * 60, "about 1.5 h"),
        (3.1 * 3600, "about 3 h"),
        (3.3 * 3600, "about 3.5 h"),
        (9.9 * 3600, "about 10 h"),
        (41.4 * 3600, "about 41 h"),
    ],
)
def test_times_are_rounded_honestly(seconds, words):
    assert in_words(seconds) == words


def test_a_cost_in_words():
    assert str(Cost(12_288_000, 1400.0, 0.83e9)) == "about 25 min at 8.8 k steps/s, 0.8 GB of memory"
    assert str(Cost(12_288_000, 140.0, None)) == "about 2 min at 88 k steps/s"
