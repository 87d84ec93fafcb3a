import json
import math
import pickle
from pathlib import Path

import pytest
from codesign_bo import EvalRequest, EvalResult
from hypothesis import given
from hypothesis import strategies as st

finite = st.floats(allow_nan=False, allow_infinity=False)
results = st.builds(
    EvalResult,
    mean=finite,
    sem=st.none() | st.floats(0.0, 1e300),
    n=st.integers(1, 10**6),
    extras=st.dictionaries(st.text(max_size=5), finite | st.sampled_from([math.inf, -math.inf]), max_size=3),
    curve=st.lists(st.tuples(finite, finite), max_size=3),
    message=st.text(max_size=10),
)


@given(results)
def test_results_survive_json_and_pickle(result):
    text = result.to_json()
    json.loads(text, parse_constant=pytest.fail)  # strict JSON has no NaN or Infinity
    assert EvalResult.from_json(text) == result
    assert pickle.loads(pickle.dumps(result)) == result


def test_requests_survive_json_and_pickle():
    request = EvalRequest(3, 2, {"a": 0.1 + 0.2}, 7, 0.25, Path("x/0003"), 12.5)
    assert EvalRequest.from_json(request.to_json()) == request
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


def test_a_result_is_detached_from_the_callers_dictionary():
    extras = {"energy": 1.0}
    result = EvalResult(1.0, extras=extras)
    extras["energy"] = 2.0
    assert result.extras["energy"] == 1.0
