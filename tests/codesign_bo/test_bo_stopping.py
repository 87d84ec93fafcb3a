"""Stopping of hopeless evaluations by their learning curves."""

import math
import pickle

import numpy as np
import pytest
from codesign_bo import BoxSpace, EvalRequest, EvalResult, MedianStopping, Score, Study
from codesign_bo.stopping import Thresholds
from hypothesis import given
from hypothesis import strategies as st

SPACE = BoxSpace.box(["a"], 0.0, 1.0, 0.5)
STEPS = 20


def line(slope):
    """A learning curve that rises evenly."""
    return [(float(step), slope * step) for step in range(1, STEPS + 1)]


def test_the_bar_is_the_median_of_the_best_values_so_far():
    rule = MedianStopping(min_trials=3, min_share=0.25)
    falling = [(1.0, 9.0), (10.0, 5.0), (20.0, 0.0)]  # its best stays 9
    bar = rule.thresholds([line(1.0), line(2.0), falling])
    assert bar.steps == tuple(float(s) for s in range(5, 21))
    expected = [np.median([step, 2 * step, 9.0]) for step in range(5, 21)]
    assert bar.values == pytest.approx(expected)
    assert not bar.hopeless([(4.0, -100.0)])  # too early
    assert bar.hopeless([(5.0, 8.99)])
    assert not bar.hopeless([(5.0, 9.0)])
    assert not bar.hopeless([(3.0, 9.0), (5.0, -100.0)])  # the best so far counts
    assert bar.hopeless([(9.0, 8.0), (14.5, 13.9)])  # between two steps the last one passed counts
    assert bar.hopeless([(1000.0, 19.9)])
    assert not bar.hopeless([])


def test_minimising_turns_everything_round():
    rule = MedianStopping(min_trials=3)
    up = [line(1.0), line(2.0), line(4.0)]
    down = [[(step, -value) for step, value in curve] for curve in up]
    bar, mirrored = rule.thresholds(up), rule.thresholds(down, maximize=False)
    assert mirrored.values == tuple(-v for v in bar.values)
    assert mirrored.hopeless([(10.0, -19.0)])
    assert not mirrored.hopeless([(10.0, -21.0)])


def test_there_is_no_bar_while_too_few_have_finished():
    rule = MedianStopping(min_trials=3)
    assert rule.thresholds([line(1.0)] * 2) is None
    assert rule.thresholds([line(1.0), line(2.0), []]) is None
    assert rule.thresholds([line(1.0), line(2.0), [(1.0, math.nan)]]) is None


def test_stopped_evaluations_do_not_raise_the_bar_for_those_that_follow():
    rule = MedianStopping(min_trials=3)
    cut = [line(0.1)[:6], line(0.2)[:6]]
    bar = rule.thresholds([line(1.0), line(2.0), *cut])
    assert bar.values[-1] == pytest.approx(1.2)  # the lower middle one of 0.6, 1.2, 20, 40, not the survivors' 20


def test_a_lower_quantile_stops_fewer():
    curves = [line(slope) for slope in range(1, 12)]
    half = MedianStopping(quantile=0.5).thresholds(curves)
    tenth = MedianStopping(quantile=0.1).thresholds(curves)
    assert half.values[-1] == pytest.approx(20 * 6)
    assert tenth.values[-1] == pytest.approx(20 * 2)


@given(
    st.lists(
        st.lists(st.tuples(st.integers(1, 50), st.floats(-1e6, 1e6)), min_size=1, max_size=8, unique_by=lambda p: p[0]),
        min_size=3,
        max_size=9,
    )
)
def test_the_best_curve_is_never_stopped(curves):
    """Whatever the curves: one that is at least as good as all others everywhere beats any median."""
    curves = [sorted((float(s), v) for s, v in curve) for curve in curves]
    bar = MedianStopping(min_trials=3).thresholds(curves)
    top = max(value for curve in curves for _, value in curve)
    steps = sorted({step for curve in curves for step, _ in curve})
    winner = [(step, top) for step in steps]
    assert bar is None or not any(bar.hopeless(winner[: i + 1]) for i in range(len(winner)))


@pytest.mark.parametrize("fields", [{"min_trials": 0}, {"min_share": 1.0}, {"quantile": 0.0}, {"quantile": 1.0}])
def test_settings_out_of_range_are_refused(fields):
    with pytest.raises(ValueError, match=next(iter(fields))):
        MedianStopping(**fields)


def test_the_bar_travels_with_the_request():
    request = EvalRequest(3, 1, {"a": 0.5}, 7, thresholds=Thresholds((5.0, 10.0), (1.0, 2.0)))
    for copy in (EvalRequest.from_json(request.to_json()), pickle.loads(pickle.dumps(request))):
        assert copy == request
        assert copy.stop([(10.0, 1.5)])
        assert not copy.stop([(9.0, 1.5)])
    assert not EvalRequest(3, 1, {"a": 0.5}, 7).stop([(10.0, -1e9)])


def test_a_stopped_result_keeps_its_last_value_at_its_fidelity():
    result = EvalResult.stopped(line(1.0)[:5], fidelity=0.25)
    assert not result.ok
    assert not result.failed
    assert math.isnan(result.mean)
    assert result.scores == (Score(0.25, 5.0),)
    assert EvalResult.from_json(result.to_json()) == result
    own = EvalResult.stopped(line(1.0)[:5], 0.25, Score(0.25, -3.0, 0.5, 8))
    assert own.scores == (Score(0.25, -3.0, 0.5, 8),)
    for bad in (lambda: EvalResult.stopped([], 0.2), lambda: EvalResult.stopped(line(1.0), 1.0)):
        with pytest.raises(ValueError):
            bad()
    with pytest.raises(ValueError, match="lower fidelity"):
        EvalResult(1.0, status="stopped")


class Trainer:
    """Learns at a rate that the design sets, and counts its steps."""

    def __init__(self):
        self.steps = 0

    def __call__(self, request):
        curve = []
        for step in range(1, STEPS + 1):
            self.steps += 1
            curve.append((step, step * (1.0 - abs(request.params["a"] - 0.6))))
            if request.stop(curve):
                return EvalResult.stopped(curve, fidelity=step / STEPS)
        return EvalResult(curve[-1][1], 0.1, 4, curve=curve)


def test_a_study_with_stopping_saves_what_it_says(tmp_path):
    full, short = Trainer(), Trainer()
    with Study(SPACE, tmp_path / "full.sqlite", seed=1, n_init=100) as study:
        everything = study.run(full, until=16)
        assert study.savings().stopped == 0
    assert full.steps == 16 * STEPS  # off by default
    with Study(SPACE, tmp_path / "short.sqlite", seed=1, n_init=100) as study:
        trials = study.run(short, until=16, stopping=MedianStopping(min_trials=6))
        savings = study.savings()
        stopped = [t for t in trials if t.status == "stopped"]
        assert all(t.status in ("ok", "stopped") for t in trials)
        assert all(t.ok for t in trials[:6])
        assert len(stopped) == savings.stopped > 2
        assert savings.evaluations * STEPS == pytest.approx(full.steps - short.steps)
        assert savings.share == pytest.approx(1.0 - short.steps / full.steps)
        # the best design is still there, and what was stopped was worse than the median of those before
        values = [t.result.mean for t in everything]
        best = int(np.argmax(values))
        assert trials[best].ok
        assert all(values[t.trial] < np.median(values[: t.trial]) for t in stopped)
        # a stopped trial is no score in full, no failure, and says that the design is viable
        assert {e.trial for e in study.ranking()} == {t.trial for t in trials if t.ok}
        assert len(study.observations().y) == 16 - len(stopped)
        assert study.viability().viable.all()
        assert [s.trial for s in study.scores()] == [t.trial for t in stopped]
        assert study.retry_failed() == 0


def test_the_decision_is_the_same_after_an_interruption(tmp_path):
    rule = MedianStopping(min_trials=4)

    def run(path, kill=None):
        trainer = Trainer()

        def evaluate(request):
            result = trainer(request)
            if request.trial == kill and request.attempt == 1:
                raise KeyboardInterrupt
            return result

        with Study(SPACE, path, seed=1, n_init=100) as study:
            return study.run(evaluate, until=12, stopping=rule)

    whole = run(tmp_path / "whole.sqlite")
    (first, *_) = (t.trial for t in whole if t.status == "stopped")
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "killed.sqlite", kill=first)
    assert run(tmp_path / "killed.sqlite") == whole
