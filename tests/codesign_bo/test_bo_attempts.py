"""Attempts, their tokens, and which failures are tried again. No surrogate takes part here."""

import math
import time

import numpy as np
import pytest
from codesign_bo import BoxSpace, EvalResult, Study, StudyError

GOOD = EvalResult(1.0, 0.1, 4)
LOST = EvalResult.failure("lost", "the machine went away")
DIVERGED = EvalResult.failure("diverged", "loss is nan")


@pytest.fixture
def study(tmp_path):
    with Study(BoxSpace.box(["a", "b"], 0.0, 1.0, 0.5), tmp_path / "s.sqlite", n_init=100) as study:
        yield study


def history(study, trial=0):
    return [(a.attempt, a.status, a.final) for a in study.attempts() if a.trial == trial]


def test_an_attempt_is_recorded_from_dispatch_to_result(study):
    before = time.time()
    (request,) = study.ask(deadline=before + 1000)
    (running,) = study.attempts()
    assert (running.status, running.ended, running.result) == ("running", None, None)
    assert running.deadline == request.deadline == before + 1000
    assert study.tell(0, GOOD, request.token) == "counted"
    (ended,) = study.attempts()
    assert (ended.token, ended.attempt, ended.status, ended.final) == (request.token, 1, "ok", True)
    assert ended.result == GOOD
    assert before <= ended.started <= ended.ended <= time.time()
    assert 0.0 <= ended.seconds <= time.time() - before
    assert study.trials()[0].seconds == ended.seconds


def test_tokens_are_given_out_once(study):
    tokens = {request.token for request in study.ask(5)}
    study.tell(0, LOST)
    tokens.add(study.ask()[0].token)
    assert len(tokens) == 6
    assert "" not in tokens


def test_a_token_that_was_never_given_out_is_refused(study):
    first, second = study.ask(2)
    for token in ("forged", "", second.token):
        with pytest.raises(StudyError, match=r"no attempt of trial 0 .* refused"):
            study.tell(0, GOOD, token)
    assert study.finished() == 0
    assert study.tell(0, GOOD, first.token) == "counted"


def test_the_same_result_twice_counts_once_and_another_is_refused(study):
    (request,) = study.ask()
    assert [study.tell(0, GOOD, request.token) for _ in range(3)] == ["counted", "repeated", "repeated"]
    assert study.tell(0, GOOD) == "repeated"
    for token in (request.token, None):
        with pytest.raises(StudyError, match="different result"):
            study.tell(0, EvalResult(2.0), token)
    assert study.finished() == 1


def test_a_lost_evaluation_is_dispatched_again_as_it_was_until_the_retries_are_used_up(study):
    requests = [study.ask()[0]]
    for _ in range(2):
        assert study.tell(0, LOST, requests[-1].token) == "retry"
        requests.append(study.ask()[0])
    assert [r.attempt for r in requests] == [1, 2, 3]
    assert len({(r.trial, r.seed, tuple(r.params.items())) for r in requests}) == 1
    assert study.finished() == 0
    assert study.tell(0, LOST, requests[-1].token) == "counted"
    assert study.trials()[0].status == "lost"
    assert study.ask()[0].trial == 1
    assert history(study) == [(1, "lost", False), (2, "lost", False), (3, "lost", True)]


@pytest.mark.parametrize("retries", [0, 1, 3])
def test_the_number_of_retries_is_a_setting(tmp_path, retries):
    with Study(BoxSpace.box(["a"], 0.0, 1.0, 0.5), tmp_path / "s.sqlite", retries=retries) as study:
        told = []
        while "counted" not in told:
            told.append(study.tell(0, LOST, study.ask()[0].token))
        assert told == ["retry"] * retries + ["counted"]


@pytest.mark.parametrize("kind", ["crash", "infeasible", "timeout"])
def test_failures_that_would_repeat_are_final_at_once(study, kind):
    (request,) = study.ask()
    assert study.tell(0, EvalResult.failure(kind, "x"), request.token) == "counted"
    assert study.ask()[0].trial == 1


def test_divergence_is_final_the_second_time(study):
    assert study.tell(0, DIVERGED, study.ask()[0].token) == "retry"
    assert study.tell(0, LOST, study.ask()[0].token) == "retry"  # the machine's fault counts by itself
    assert study.tell(0, DIVERGED, study.ask()[0].token) == "counted"
    assert study.tell(1, DIVERGED, study.ask()[0].token) == "retry"
    assert study.tell(1, GOOD, study.ask()[0].token) == "counted"
    assert [t.status for t in study.trials()] == ["diverged", "ok"]


def test_a_timeout_after_the_deadline_is_the_end_of_the_run_not_of_the_trial(study):
    slow = EvalResult.failure("timeout", "too slow")
    for _ in range(5):
        (request,) = study.ask(deadline=time.time() - 1)
        assert study.tell(0, slow, request.token) == "retry"
    (request,) = study.ask(deadline=time.time() + 1000)
    assert study.tell(0, slow, request.token) == "counted"


def test_what_comes_late_after_being_given_up_is_taken_if_the_trial_is_open(study):
    (first,) = study.ask()
    assert study.give_up(0, first.token, "not heard of") == "retry"
    (second,) = study.ask()
    assert (second.trial, second.attempt) == (0, 2)
    assert study.tell(0, GOOD, first.token) == "counted"
    assert history(study) == [(1, "ok", True), (2, "superseded", False)]
    assert study.tell(0, EvalResult(7.0), second.token) == "late"
    assert study.trials()[0].result == GOOD
    assert [a.result.mean for a in study.attempts()] == [1.0, 7.0]  # both on record
    assert study.tell(0, EvalResult(7.0), second.token) == "repeated"
    with pytest.raises(StudyError, match="different result"):
        study.tell(0, EvalResult(8.0), second.token)


def test_what_comes_late_after_another_attempt_finished_is_kept_for_audit_only(study):
    (first,) = study.ask()
    study.give_up(0, first.token)
    (second,) = study.ask()
    assert study.tell(0, GOOD, second.token) == "counted"
    assert study.tell(0, EvalResult(5.0), first.token) == "late"
    assert study.trials()[0].result == GOOD
    assert study.finished() == 1
    assert [(a.result.mean, a.final) for a in study.attempts()] == [(5.0, False), (1.0, True)]


@pytest.mark.parametrize("kind", ["crash", "lost", "diverged", "timeout", "infeasible"])
def test_a_failure_that_comes_late_does_not_settle_what_another_attempt_works_on(tmp_path, kind):
    with Study(BoxSpace.box(["a"], 0.0, 1.0, 0.5), tmp_path / "s.sqlite", retries=1) as study:
        (first,) = study.ask()
        assert study.give_up(0, first.token) == "retry"
        (second,) = study.ask()
        assert study.tell(0, EvalResult.failure(kind, "late"), first.token) == "retry"
        assert study.finished() == 0
        assert study.ask()[0].trial == 1  # the second attempt is still in hand
        assert study.tell(0, GOOD, second.token) == "counted"
        assert study.trials()[0].result == GOOD
        assert [a.status for a in study.attempts() if a.trial == 0] == [kind, "ok"]


def test_a_trial_given_up_too_often_is_lost_and_a_late_result_does_not_bring_it_back(study):
    for told in ("retry", "retry", "counted"):
        (request,) = study.ask()
        assert study.give_up(0, request.token) == told
    assert study.trials()[0].status == "lost"
    assert study.tell(0, GOOD, request.token) == "late"
    assert study.trials()[0].status == "lost"
    with pytest.raises(StudyError, match="has a result"):
        study.give_up(0, request.token)


def test_interruptions_by_the_coordinator_cost_no_retry(tmp_path):
    space = BoxSpace.box(["a"], 0.0, 1.0, 0.5)
    tokens = []
    for attempt in range(1, 6):
        with Study(space, tmp_path / "s.sqlite", retries=1) as study:
            (request,) = study.ask()
            assert (request.trial, request.attempt) == (0, attempt)
            tokens.append(request.token)
    with Study(space, tmp_path / "s.sqlite", retries=1) as study:
        assert [a.status for a in study.attempts()] == ["interrupted"] * 4 + ["running"]
        (request,) = study.ask()
        assert study.tell(0, LOST, request.token) == "retry"
        assert study.tell(0, GOOD, tokens[2]) == "counted"  # a worker outlived its coordinator


def test_retrying_failures_gives_fresh_retries_and_late_news_of_the_old_attempt_change_nothing(study):
    requests = []
    for _ in range(3):
        requests.append(study.ask()[0])
        study.tell(0, LOST, requests[-1].token)
    assert study.retry_failed() == 1
    assert study.tell(0, LOST, requests[-1].token) == "repeated"
    assert study.finished() == 0
    assert [study.tell(0, LOST, study.ask()[0].token) for _ in range(3)] == ["retry", "retry", "counted"]


def test_without_a_token_a_reopened_trial_takes_a_new_result_as_another_attempt(study):
    study.ask()
    study.tell(0, EvalResult.failure("crash", "no module named legs"))
    study.retry_failed()
    assert study.tell(0, GOOD) == "counted"
    assert history(study) == [(1, "crash", True), (2, "ok", True)]


def test_numbers_that_are_not_finite_never_get_in(study):
    smuggled = EvalResult(1.0)
    object.__setattr__(smuggled, "mean", math.nan)  # as unpickling does, past the checks
    (request,) = study.ask()
    assert study.tell(0, smuggled, request.token) == "retry"
    assert "nan" in study.attempts()[0].message
    assert study.tell(0, smuggled, study.ask()[0].token) == "counted"
    assert study.trials()[0].status == "diverged"
    with pytest.raises(TypeError, match="float"):
        study.tell(0, 1.0)


def test_a_further_objective_is_demanded_and_must_be_finite(tmp_path):
    space = BoxSpace.box(["a"], 0.0, 1.0, 0.5)
    with Study(space, tmp_path / "s.sqlite", objectives={"energy": "minimize"}, retries=0) as study:
        study.ask()
        with pytest.raises(ValueError, match=r"no \['energy'\]"):
            study.tell(0, EvalResult(1.0, extras={"power": 3.0}))
        assert study.finished() == 0
        study.tell(0, EvalResult(1.0, extras={"energy": 3.0, "energy_sem": 0.5}))
        study.ask()
        study.tell(1, EvalResult(1.0, extras={"energy": math.inf}))
        assert [t.status for t in study.trials()] == ["ok", "diverged"]
    with pytest.raises(StudyError, match=r"objectives is \{'energy': 'minimize'\} there"):
        Study(space, tmp_path / "s.sqlite")
    with pytest.raises(ValueError, match="maximize"):
        Study(space, tmp_path / "t.sqlite", objectives={"energy": "down"})


def test_messages_and_settings_may_hold_what_files_cannot(tmp_path):
    """File names that are no Unicode end up in exceptions, and settings in numpy's types."""
    space = BoxSpace.box(["a"], 0.0, 1.0, np.float32(0.5))
    with Study(space, tmp_path / "s.sqlite", seed=np.int64(3), n_init=np.int64(50), maximize=np.True_) as study:
        for trial, name in enumerate(("leg-\udcff.urdf", "null \0 byte", "ünïcode")):
            study.ask()
            study.tell(trial, EvalResult.failure("crash", f"no {name}"))
            assert EvalResult.from_json(study.trials()[trial].result.to_json()) == study.trials()[trial].result
        assert "leg-\\udcff.urdf" in study.trials()[0].result.message

        def broken(request):
            raise ValueError("leg-\udcff.urdf")

        assert study.run(broken, until=4)[3].status == "crash"
    with Study(space, tmp_path / "s.sqlite", seed=3, n_init=50) as study:
        assert study.finished() == 4


@pytest.mark.parametrize("deadline", [math.inf, math.nan])
def test_a_deadline_is_a_time(study, deadline):
    with pytest.raises(ValueError, match=f"deadline is {deadline}"):
        study.ask(deadline=deadline)
    assert study.trials() == []
