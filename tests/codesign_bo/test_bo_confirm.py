import numpy as np
import pytest
from codesign_bo import ConfirmationRecord, EvalResult
from codesign_bo.confirm import analyse
from scipy import stats

DESIGNS = {t: {"x": float(t)} for t in range(6)}


def records(table):
    """`table` maps a trial to its scores by repeat; None is a failure."""
    return [
        ConfirmationRecord(t, r, r, EvalResult(v) if v is not None else EvalResult.failure("crash", ""))
        for t, row in table.items()
        for r, v in enumerate(row)
    ]


def test_one_design_gives_the_paired_t_interval():
    nominal, best = [1.0, 2.5, 2.0, 4.0], [1.6, 2.9, 3.1, 4.2]
    gain = analyse(records({0: nominal, 3: best}), DESIGNS).best
    truth = stats.ttest_rel(best, nominal)
    interval = truth.confidence_interval(0.95)
    assert (gain.trial, gain.repeats, gain.params) == (3, 4, {"x": 3.0})
    assert (gain.low, gain.high) == pytest.approx((interval.low, interval.high))
    assert gain.gain == pytest.approx(np.mean(best) - np.mean(nominal))
    assert gain.relative[0] == pytest.approx(gain.gain / np.mean(nominal))
    assert gain.significant == (truth.pvalue < 0.05)


def test_minimising_turns_the_sign():
    table = {0: [1.0, 2.5, 2.0], 3: [0.6, 2.2, 1.5]}
    up, down = analyse(records(table), DESIGNS).best, analyse(records(table), DESIGNS, maximize=False).best
    assert (down.gain, down.low, down.high) == pytest.approx((-up.gain, -up.high, -up.low))
    assert down.gain > 0


def test_intervals_hold_together_for_the_winner():
    rng = np.random.default_rng(0)
    missed, rounds = 0, 1500
    for _ in range(rounds):  # three designs, none better than nominal, strong shared seeds
        seeds = rng.normal(0, 3, 3)
        scores = seeds + rng.normal(0, 1, (4, 3))
        confirmation = analyse(records({t: list(map(float, row)) for t, row in enumerate(scores)}), DESIGNS)
        missed += any(g.significant for g in confirmation.gains)
    assert 0.02 < missed / rounds < 0.06  # 5 % promised, Bonferroni errs on the safe side


def test_failures_and_single_seeds_claim_nothing():
    confirmation = analyse(records({0: [1.0, None, 2.0], 1: [3.0, 9.0, 4.0], 2: [3.0, 3.0, None]}), DESIGNS)
    assert [g.trial for g in confirmation.gains] == [1]
    assert confirmation.failed == (2,)
    assert confirmation.best.gain == pytest.approx(2.0)  # seed 1 is dropped: the nominal design failed there
    single = analyse(records({0: [1.0], 1: [3.0]}), DESIGNS).best
    assert (single.low, single.high) == (-np.inf, np.inf)
    assert not single.significant
    assert analyse(records({0: [None], 1: [3.0]}), DESIGNS).best is None
    assert analyse([], DESIGNS).best is None
