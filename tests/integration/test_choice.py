"""The verdict of a run, on studies whose scores are known."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from codesign_bo import BoxSpace, EvalRequest, EvalResult, Study
from scipy import stats

from legged_codesign.choice import Choice, choose

SPACE = BoxSpace.box(["front_thigh", "front_shank"], 0.6, 1.4, 1.0)
LONG = {"front_thigh": 1.3, "front_shank": 1.1}

NOMINAL = np.array([-0.310, -0.302, -0.317])
BETTER = np.array([-0.281, -0.279, -0.284])
WORSE = np.array([-0.341, -0.330, -0.352])
CLOSE = np.array([-0.309, -0.306, -0.314])

Scores = dict[tuple[float, ...], np.ndarray]


def evaluator(scores: Scores) -> Callable[[EvalRequest], EvalResult]:
    """The first score in the search, all three in the confirmation, by its repeat."""

    def evaluate(request: EvalRequest) -> EvalResult:
        known = scores[tuple(request.params.values())]
        confirming = "confirm" in request.workdir.parts
        value = float(known[int(request.workdir.name)]) if confirming else float(known[0])
        if np.isnan(value):
            return EvalResult.failure("crash", "fell apart")
        return EvalResult(mean=value, sem=0.001, n=4)

    return evaluate


@pytest.fixture
def confirmed(tmp_path: Path) -> Iterator[Callable[..., Study]]:
    """A study of the nominal body and one other with these scores on three fresh seeds."""
    opened: list[Study] = []

    def make(nominal: np.ndarray, other: np.ndarray) -> Study:
        study = Study(SPACE, tmp_path / "study.sqlite", n_init=2)
        opened.append(study)
        study.enqueue([LONG])
        callback = evaluator({(1.0, 1.0): nominal, tuple(LONG.values()): other})
        study.run(callback, until=2)
        study.confirm(callback, top_k=1, repeats=3)
        return study

    yield make
    for study in opened:
        study.close()


@pytest.mark.parametrize("other", [BETTER, WORSE, CLOSE], ids=["better", "worse", "close"])
def test_gain_and_interval_are_those_of_the_paired_t_test(confirmed: Callable, other: np.ndarray) -> None:
    choice = choose(confirmed(NOMINAL, other))
    size = abs(NOMINAL.mean())
    interval = stats.ttest_rel(other, NOMINAL).confidence_interval(0.95)
    assert choice.gain == pytest.approx((other - NOMINAL).mean() / size)
    assert choice.low == pytest.approx(interval.low / size)
    assert choice.high == pytest.approx(interval.high / size)
    assert choice.significant == (stats.ttest_rel(other, NOMINAL).pvalue < 0.05)
    assert (choice.seeds, choice.challenger) == (3, 1)
    assert choice.nominal == pytest.approx(NOMINAL.mean())


def test_a_better_body_is_chosen_with_its_best_policy(confirmed: Callable) -> None:
    choice = choose(confirmed(NOMINAL, BETTER))
    assert (choice.trial, dict(choice.params)) == (1, LONG)
    assert choice.mean == pytest.approx(BETTER.mean())
    assert choice.repeat == 1, "of -0.281, -0.279, -0.284 the second is the best"
    assert choice.design(["front_shank", "front_thigh"]).tolist() == [1.1, 1.3]


def test_the_nominal_body_wins_where_no_other_is_better(confirmed: Callable) -> None:
    choice = choose(confirmed(NOMINAL, WORSE))
    assert (choice.trial, dict(choice.params)) == (0, {"front_thigh": 1.0, "front_shank": 1.0})
    assert choice.mean == choice.nominal
    assert choice.repeat == 1, "the nominal body's own best seed"
    assert choice.gain < 0.0
    assert choice.challenger == 1


def test_an_equal_body_is_no_gain(confirmed: Callable) -> None:
    choice = choose(confirmed(NOMINAL, NOMINAL.copy()))
    assert choice.trial == 0
    assert (choice.gain, choice.significant) == (0.0, False)


def test_seeds_on_which_the_nominal_body_failed_are_left_out(confirmed: Callable) -> None:
    choice = choose(confirmed(np.array([-0.31, np.nan, -0.32]), BETTER))
    assert choice.seeds == 2
    assert choice.gain == pytest.approx(((-0.281 + 0.31) + (-0.284 + 0.32)) / 2 / 0.315)


def test_nothing_to_compare_is_an_error(confirmed: Callable) -> None:
    with pytest.raises(RuntimeError, match=r"trials \(1,\) failed"):
        choose(confirmed(NOMINAL, np.array([-0.28, np.nan, -0.28])))


CHOICE = Choice(
    trial=3,
    repeat=1,
    params={"front_thigh": 1.3, "front_shank": 1.1},
    mean=-0.28,
    nominal=-0.31,
    gain=0.0968,
    low=0.051,
    high=0.142,
    seeds=3,
    challenger=3,
)


def test_json_round_trip() -> None:
    assert Choice.from_json(CHOICE.to_json()) == CHOICE


def test_sentence_of_a_real_gain() -> None:
    assert CHOICE.sentence("cost-of-transport") == (
        "best body: front thigh 1.30, front shank 1.10; cost-of-transport 0.2800 against 0.3100, "
        "+9.7 % (95 % interval +5.1 to +14.2 %) on 3 fresh seeds: a real gain"
    )


def test_sentence_admits_what_is_not_separable() -> None:
    sentence = replace(CHOICE, low=-0.01).sentence("energy")
    assert "not separable from the nominal body" in sentence
    assert "a real gain" not in sentence


def test_sentence_admits_that_nothing_was_found() -> None:
    sentence = replace(CHOICE, trial=0, gain=-0.04, low=-0.09, high=0.01).sentence("return")
    assert sentence.startswith("no searched body beat the nominal one on 3 fresh seeds")
    assert "-4.0 % (95 % interval -9.0 to +1.0 %)" in sentence
