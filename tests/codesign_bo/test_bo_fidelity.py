"""Scores at lower fidelities, used where they help and left alone where they mislead."""

import math

import numpy as np
import pytest
from codesign_bo import BoxSpace, EvalResult, Score, ScoreRecord, Study
from codesign_bo.models.fidelity import MIN_FULL, fit_with_scores, levels
from codesign_bo.models.surrogate import fit_surrogate
from hypothesis import given, settings
from hypothesis import strategies as st

SPACE = BoxSpace.box(["a", "b", "c"], 0, 1, 0.5)


def objective(x):
    return np.sin(6 * x[:, 0]) + x[:, 1] ** 2 - np.cos(5 * x[:, 2])


def screening(n, function, seed=0, fidelity=0.0):
    x = np.random.default_rng(seed).uniform(size=(n, 3))
    y = function(x)
    return [
        ScoreRecord(SPACE.params(SPACE.from_unit(row[None])[0]), fidelity, float(v), 0.05, None)
        for row, v in zip(x, y, strict=True)
    ]


def full(n, seed=9):
    x = np.random.default_rng(seed).uniform(size=(n, 3))
    return x, objective(x), np.full(n, 0.02)


def test_informative_scores_are_used_and_make_the_surrogate_better():
    x, y, sem = full(10)
    scores = screening(100, lambda x: 0.3 * objective(x) - 2 + 0.1 * x[:, 0])
    surrogate, (verdict,) = fit_with_scores(x, y, sem, 0, SPACE, scores)
    assert (verdict.level, verdict.used, surrogate.fit) == ("zero", True, "map+scores")
    assert verdict.gain > 2 * verdict.error
    assert verdict.weight > 0
    points = np.random.default_rng(1).uniform(size=(200, 3))
    plain = fit_surrogate(x, y, sem, 0, SPACE)
    with_scores, without = (np.std(s.predict(points)[0] - objective(points)) for s in (surrogate, plain))
    assert with_scores < 0.5 * without


@pytest.mark.parametrize(
    "misleading",
    [lambda x: np.random.default_rng(3).normal(size=len(x)), lambda x: -objective(x), lambda x: np.sin(9 * x[:, 1])],
    ids=["noise", "opposite", "unrelated"],
)
def test_misleading_scores_are_left_alone(misleading):
    x, y, sem = full(12)
    surrogate, (verdict,) = fit_with_scores(x, y, sem, 0, SPACE, screening(80, misleading))
    assert not verdict.used
    plain = fit_surrogate(x, y, sem, 0, SPACE)
    points = np.random.default_rng(1).uniform(size=(5, 3))
    np.testing.assert_array_equal(surrogate.predict(points)[0], plain.predict(points)[0])
    assert surrogate.fit == "map"


def test_of_two_levels_the_better_one_is_used():
    x, y, sem = full(12)
    scores = screening(60, lambda x: objective(x) + np.sin(8 * x[:, 1])) + screening(60, objective, 1, 0.25)
    surrogate, verdicts = fit_with_scores(x, y, sem, 0, SPACE, scores)
    assert [v.level for v in verdicts] == ["zero", "partial"]
    assert verdicts[1].gain > verdicts[0].gain
    points = np.random.default_rng(1).uniform(size=(200, 3))
    assert np.std(surrogate.predict(points)[0] - objective(points)) < 0.3


def test_too_few_evaluations_have_no_say():
    x, y, sem = full(MIN_FULL - 1)
    surrogate, verdicts = fit_with_scores(x, y, sem, 0, SPACE, screening(50, objective))
    assert (verdicts, surrogate.fit) == ([], "map")


def test_of_repeated_scores_the_newest_at_the_highest_fidelity_counts():
    rows = [(0.1, 0.3, 1.0), (0.1, 0.2, 2.0), (0.5, 0.3, 3.0), (0.5, 0.3, 4.0), (0.7, 0.0, 9.0)]
    rows += [(0.2 + i / 100, 0.5, 5.0) for i in range(3)]
    (level,) = levels(SPACE, [ScoreRecord({"a": a, "b": 0.0, "c": 0.0}, f, mean, None, None) for a, f, mean in rows])
    assert level.name == "partial"  # one score at fidelity 0 is no level
    found = {round(float(x[0]), 9): y for x, y in zip(level.x, level.y, strict=True)}
    assert (found[0.1], found[0.5], len(found)) == (1.0, 4.0, 5)
    assert all(map(math.isnan, level.sem))


@settings(max_examples=5)
@given(st.integers(0, 10_000))
def test_pure_noise_rarely_passes_for_help(seed):
    x, y, sem = full(10, seed)
    rng = np.random.default_rng(seed)
    scores = screening(20, lambda x: rng.normal(size=len(x)), seed)
    surrogate, (verdict,) = fit_with_scores(x, y, sem, 0, SPACE, scores)
    assert verdict.used == (verdict.weight > 0 and verdict.gain > 2 * verdict.error)
    assert np.isfinite(surrogate.predict(x)[0]).all()


def test_a_study_uses_what_its_evaluations_report_on_the_way(tmp_path):
    with Study(SPACE, tmp_path / "s.sqlite", seed=2) as study:
        points = np.random.default_rng(0).uniform(size=(60, 3))
        designs = [SPACE.params(row) for row in SPACE.from_unit(points)]
        study.add_screening(designs, objective(points).tolist(), [0.05] * 60)
        for _ in range(9):
            (request,) = study.ask()
            value = float(objective(np.array([list(request.params.values())]))[0])
            study.tell(request.trial, EvalResult(2 * value + 1, 0.02, scores=(Score(0.0, value, 0.05),)))
        (verdict,) = study.fidelity_verdicts()
        assert verdict.used
        assert study.surrogate().fit == "map+scores"
        study.ask()
        assert study.trials()[-1].basis.fit == "map+scores"
