import json
import math
import pickle
import subprocess
import sys
from pathlib import Path

import codesign_bo
import pytest
from codesign_bo import DivergedError, EvalRequest, EvalResult, Score
from hypothesis import given
from hypothesis import strategies as st

finite = st.floats(allow_nan=False, allow_infinity=False)
scores = st.builds(
    Score, st.floats(0.0, 1.0, exclude_max=True), finite, st.none() | st.floats(0.0, 1e300), st.integers(1, 10**6)
)
results = st.builds(
    EvalResult,
    mean=finite,
    sem=st.none() | st.floats(0.0, 1e300),
    n=st.integers(1, 10**6),
    extras=st.dictionaries(st.text(max_size=5), finite | st.sampled_from([math.inf, -math.inf]), max_size=3),
    curve=st.lists(st.tuples(finite, finite), max_size=3),
    message=st.text(max_size=10),
    scores=st.lists(scores, max_size=3).map(tuple),
)


@given(results)
def test_results_survive_json_and_pickle(result):
    text = result.to_json()
    json.loads(text, parse_constant=pytest.fail)  # strict JSON has no NaN or Infinity
    assert EvalResult.from_json(text) == result
    assert pickle.loads(pickle.dumps(result)) == result


def test_requests_survive_json_and_pickle():
    params = {"a": 0.1 + 0.2, "n": 3, "foot": "flat", "tail": True}
    request = EvalRequest(3, 2, params, 7, 0.25, Path("x/0003"), 12.5, "a1b2", repeat=1)
    copy = EvalRequest.from_json(request.to_json())
    assert copy == request
    assert [type(v) for v in copy.params.values()] == [float, int, str, bool]
    assert pickle.loads(pickle.dumps(request)) == request


def test_failures_compare_equal_after_json_although_their_mean_is_nan():
    failure = EvalResult.failure("diverged", "loss is nan", {"step": 12.0})
    assert math.isnan(failure.mean)
    assert not failure.ok
    assert EvalResult.from_json(failure.to_json()) == failure


@pytest.mark.parametrize(
    ("fields", "word"),
    [
        ({"mean": math.nan}, "mean"),
        ({"mean": math.inf}, "mean"),
        ({"mean": 1.0, "sem": -0.1}, "sem"),
        ({"mean": 1.0, "sem": math.nan}, "sem"),
        ({"mean": 1.0, "n": 0}, "n is 0"),
        ({"mean": 1.0, "status": "fine"}, "status"),
    ],
)
def test_bad_results_are_refused(fields, word):
    with pytest.raises(ValueError, match=word):
        EvalResult(**fields)


@pytest.mark.parametrize("text", ["{}", '{"mean": 1, "colour": 2}', "[", '{"mean": "nan"}'])
def test_text_that_is_no_result_is_refused(text):
    with pytest.raises(ValueError):
        EvalResult.from_json(text)


@pytest.mark.parametrize(
    ("fields", "word"),
    [
        ({"fidelity": 1.0, "mean": 0.0}, "fidelity"),
        ({"fidelity": -0.1, "mean": 0.0}, "fidelity"),
        ({"fidelity": math.nan, "mean": 0.0}, "fidelity"),
        ({"fidelity": 0.5, "mean": math.inf}, "mean"),
        ({"fidelity": 0.5, "mean": 0.0, "sem": -1.0}, "sem"),
        ({"fidelity": 0.5, "mean": 0.0, "n": 0}, "n is 0"),
    ],
)
def test_bad_scores_are_refused(fields, word):
    with pytest.raises(ValueError, match=word):
        Score(**fields)


def test_scores_come_in_rising_order_of_fidelity():
    low, high = Score(0.0, 1.0), Score(0.5, 2.0)
    assert EvalResult(3.0, scores=(high, low)).scores == (low, high)


def test_a_mean_that_is_not_finite_has_an_error_of_its_own():
    with pytest.raises(DivergedError):
        EvalResult(math.nan)


def test_a_result_is_detached_from_the_callers_dictionary():
    extras = {"energy": 1.0}
    result = EvalResult(1.0, extras=extras)
    extras["energy"] = 2.0
    assert result.extras["energy"] == 1.0


def test_every_public_name_is_there_and_what_an_evaluation_needs_is_light():
    assert all(getattr(codesign_bo, name) is not None for name in codesign_bo.__all__)
    assert set(codesign_bo.__all__) <= set(dir(codesign_bo))
    with pytest.raises(AttributeError, match="no attribute 'Studies'"):
        _ = codesign_bo.Studies
    script = "import sys; from codesign_bo import EvalRequest, EvalResult; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script]).returncode == 0
