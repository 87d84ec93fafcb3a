"""The coordinator with executors that misbehave in every way; they are stand-ins that decide what happens when."""

import math
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from codesign_bo import BoxSpace, EvalResult, ExecutorError, Study, StudyError
from codesign_bo.executors import FuturesExecutor
from codesign_bo.running.evaluation import evaluate

SPACE = BoxSpace.box(["a", "b"], 0.0, 1.0, 0.5)


def score(request):
    return EvalResult(1.0 - (request.params["a"] - 0.7) ** 2, 0.1, 4)


class StandIn:
    """Runs evaluations here and now; `script(attempt number of the whole run, request)` may change what comes."""

    def __init__(self, slots=1, script=None):
        self.slots = slots
        self.script = script or (lambda number, request: None)
        self.requests = []
        self.cancelled = []
        self.most = 0
        self.open = set()

    def submit(self, callback, request):
        self.requests.append(request)
        self.open.add(request.token)
        self.most = max(self.most, len(self.open))
        return StandInJob(self, callback, request, self.script(len(self.requests) - 1, request))

    def close(self):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass


class StandInJob:
    """`what`: None (a good result), a result, an exception to raise, or a function that says whether it is done."""

    def __init__(self, executor, callback, request, what):
        self.executor, self.callback, self.request, self.what = executor, callback, request, what

    def done(self):
        ready = self.what() if callable(self.what) else True
        if ready:
            self.executor.open.discard(self.request.token)
        return ready

    def result(self):
        if isinstance(self.what, BaseException):
            raise self.what
        return self.what if isinstance(self.what, EvalResult) else evaluate(self.callback, self.request)

    def cancel(self):
        self.executor.open.discard(self.request.token)
        self.executor.cancelled.append(self.request.token)


@pytest.fixture
def study(tmp_path):
    with Study(SPACE, tmp_path / "s.sqlite", seed=3, n_init=100) as study:
        yield study


def never():
    return False


class Clock:
    """A steady clock that makes a leap at each look, so that nobody has to wait."""

    def __init__(self, leap):
        self.now, self.leap = 0.0, leap

    def __call__(self):
        self.now += self.leap
        return self.now


# --- the ordinary case ----------------------------------------------------------------------------------


def test_all_slots_are_kept_busy_and_the_total_is_exact(study):
    executor = StandIn(slots=3)
    trials = study.run(score, until=10, executor=executor)
    assert [t.trial for t in trials] == list(range(10))
    assert all(t.ok and t.result == score(r) for t, r in zip(trials, executor.requests, strict=True))
    assert executor.most == 3
    assert study.run(score, until=10, executor=executor) == trials
    assert len(executor.requests) == 10


def test_evaluations_in_a_pool_of_threads(study):
    def slow(request):
        time.sleep(0.002 * (request.seed % 5))
        return score(request)

    seen = []
    with FuturesExecutor(ThreadPoolExecutor(4), slots=4) as executor:
        trials = study.run(slow, until=12, executor=executor, progress=seen.append)
    assert [t.trial for t in trials] == list(range(12))
    assert sorted(seen, key=lambda t: t.trial) == trials
    assert {t.attempts for t in trials} == {1}
    with pytest.raises(TypeError, match="FuturesExecutor"):
        study.run(slow, until=13, executor=ThreadPoolExecutor(1))


def test_proposals_of_the_surrogate_know_what_is_in_flight(tmp_path):
    with Study(SPACE, tmp_path / "s.sqlite", seed=3, n_init=4) as study:
        study.run(score, until=6, executor=StandIn(slots=2))
        basis = study.trials()[5].basis
        assert basis.fit == "map"
        assert basis.seconds > 0.0
        assert len(basis.model) == 16
        assert study.trials()[3].basis is None
        (first, second) = study.ask(2)
        bases = [t.basis for t in study.trials()[6:]]
        assert [b.pending for b in bases] == [(), (first.trial,)]
        assert bases[0].model == bases[1].model != basis.model


# --- faults ---------------------------------------------------------------------------------------------


def test_nan_is_tried_once_more_and_then_recorded(study):
    def diverges(request):
        return EvalResult(math.nan) if request.trial == 1 else score(request)

    for executor in (None, StandIn(slots=2)):
        trials = study.run(diverges, until=3 if executor is None else 6, executor=executor)
    assert [t.status for t in trials] == ["ok", "diverged", "ok", "ok", "ok", "ok"]
    assert trials[1].attempts == 2
    assert study.attempts()[1].result.status == "diverged"


def test_a_lost_worker_costs_an_attempt_not_a_trial(study):
    def script(number, request):
        return EvalResult.failure("lost", "exit code -9") if number in (1, 4) else None

    executor = StandIn(slots=2, script=script)
    trials = study.run(score, until=6, executor=executor)
    assert [t.status for t in trials] == ["ok"] * 6
    assert sorted(t.attempts for t in trials) == [1, 1, 1, 1, 2, 2]
    assert len(executor.requests) == 8
    by_trial = {}
    for r in executor.requests:
        assert by_trial.setdefault(r.trial, (r.params, r.seed)) == (r.params, r.seed)


class SpeechlessError(Exception):
    """An exception that cannot be printed."""

    def __str__(self):
        raise RuntimeError("no words")


@pytest.mark.parametrize("error", [OSError("connection reset"), SpeechlessError(), RuntimeError("unpickled nothing")])
def test_an_executor_that_raises_loses_an_attempt_not_the_study(study, error):
    trials = study.run(score, until=3, executor=StandIn(script=lambda n, r: error if n == 1 else None))
    assert [t.status for t in trials] == ["ok"] * 3
    (lost,) = [a for a in study.attempts() if a.status == "lost"]
    assert type(error).__name__ in lost.message


def test_an_executor_that_is_gone_ends_the_run_and_costs_no_attempt(study):
    gone = ExecutorError("the cluster is gone")
    dying = StandIn(slots=2, script=lambda n, r: gone if n >= 2 else None)
    for _ in range(4):  # more often than a trial may be lost
        with pytest.raises(ExecutorError, match="the cluster is gone"):
            study.run(score, until=6, executor=dying)
    assert "lost" not in {a.status for a in study.attempts()}
    trials = study.run(score, until=6, executor=StandIn(slots=2))
    assert [t.status for t in trials] == ["ok"] * 6


def test_callbacks_that_raise_what_cannot_be_printed_are_crashes(study):
    def broken(request):
        if request.trial == 1:
            raise SpeechlessError
        return score(request)

    trials = study.run(broken, until=3)
    assert [t.status for t in trials] == ["ok", "crash", "ok"]
    assert "SpeechlessError" in trials[1].result.message


def test_a_hung_evaluation_is_given_up_and_dispatched_again(study, monkeypatch):
    monkeypatch.setattr(time, "monotonic", Clock(leap=1.0))
    executor = StandIn(slots=2, script=lambda n, r: never if n == 1 else None)
    trials = study.run(score, until=4, executor=executor, patience=30)
    assert [t.status for t in trials] == ["ok"] * 4
    hung = executor.requests[1]
    assert executor.cancelled == [hung.token]
    assert [a.status for a in study.attempts() if a.trial == hung.trial] == ["lost", "ok"]
    assert "given up after 30 s" in study.attempts()[1].message


def test_one_that_always_hangs_is_lost_in_the_end(study, monkeypatch):
    monkeypatch.setattr(time, "monotonic", Clock(leap=1.0))
    executor = StandIn(slots=2, script=lambda n, r: never if r.trial == 1 else None)
    trials = study.run(score, until=4, executor=executor, patience=30)
    assert [t.status for t in trials] == ["ok", "lost", "ok", "ok"]
    assert trials[1].attempts == 3


def test_a_result_that_comes_late_after_being_given_up_counts_and_ends_the_other_attempt(study, monkeypatch):
    monkeypatch.setattr(time, "monotonic", Clock(leap=1.0))

    def late():
        return len(study.attempts()) == 2  # once the second attempt at this trial runs

    def script(number, request):
        return late if number == 0 else never if request.trial == 0 else None

    executor = StandIn(slots=2, script=script)
    trials = study.run(score, until=1, executor=executor, patience=30)
    assert trials[0].ok
    first, second = [a for a in study.attempts() if a.trial == 0]
    assert (first.status, first.final, second.status) == ("ok", True, "superseded")
    assert second.token in executor.cancelled


def test_what_comes_in_twice_through_an_executor_counts_once(study):
    """Two jobs that answer for the same attempt, as after a network hiccup."""
    executor = StandIn()
    study.run(score, until=2, executor=executor)
    for request in executor.requests:
        assert study.tell(request.trial, score(request), request.token) == "repeated"
    assert study.finished() == 2


@pytest.mark.parametrize("slots", [1, 3])
def test_an_interruption_cancels_what_is_in_flight_and_loses_nothing(tmp_path, slots):
    def script(number, request):
        if number == 4:
            raise KeyboardInterrupt
        return never if number == 3 and slots > 1 else None

    executor = StandIn(slots, script)
    with Study(SPACE, tmp_path / "s.sqlite", seed=3, n_init=100) as study:
        with pytest.raises(KeyboardInterrupt):
            study.run(score, until=10, executor=executor)
        finished = study.finished()
        assert finished == (3 if slots > 1 else 4)
        in_flight = [r for r in executor.requests if study.trials()[r.trial].result is None]
        assert {a.status for a in study.attempts() if a.trial >= finished} == {"interrupted"}
        assert executor.cancelled == [r.token for r in in_flight if r is not executor.requests[4]]
        again = study.ask(len(in_flight))  # the same coordinator may go on
        assert [(r.trial, r.params, r.seed, r.attempt) for r in again] == [
            (r.trial, r.params, r.seed, 2) for r in in_flight
        ]
    with Study(SPACE, tmp_path / "s.sqlite", seed=3, n_init=100) as study:
        resumed = study.run(score, until=10, executor=StandIn(slots))
    with Study(SPACE, tmp_path / "whole.sqlite", seed=3, n_init=100) as study:
        assert study.run(score, until=10) == resumed


def test_an_executor_that_refuses_leaves_the_trial_open(study):
    class Closed(StandIn):
        def submit(self, callback, request):
            raise RuntimeError("this executor is closed")

    with pytest.raises(RuntimeError, match="is closed"):
        study.run(score, until=3, executor=Closed())
    assert [a.status for a in study.attempts()] == ["interrupted"]
    assert study.run(score, until=1)[0].attempts == 2


def test_too_many_failures_stop_the_run_and_what_is_in_flight(study):
    executor = StandIn(slots=3, script=lambda n, r: never if n == 2 else EvalResult.failure("crash", "no legs"))
    with pytest.raises(StudyError, match="6 of 6 trials"):  # two at a time, and none that came is lost
        study.run(score, until=30, executor=executor)
    assert executor.cancelled == [executor.requests[2].token]
    assert study.retry_failed() == 6
    assert all(t.ok for t in study.run(score, until=7))


# --- clocks ---------------------------------------------------------------------------------------------


def test_at_the_deadline_the_rest_is_cancelled_and_left_open(study, monkeypatch):
    now = [1000.0]
    monkeypatch.setattr(time, "time", lambda: now[0])

    def too_long():
        now[0] += 100.0
        return False

    executor = StandIn(script=lambda n, r: too_long if n == 4 else None)
    trials = study.run(score, until=50, executor=executor, deadline=1250.0)
    assert now[0] == 1300.0 + 100.0  # one last look, in case it is done after all
    assert {r.deadline for r in executor.requests} == {1250.0}
    assert [t.status for t in trials] == ["ok"] * 4 + ["unfinished"]
    assert study.attempts()[-1].status == "interrupted"
    assert executor.cancelled == [executor.requests[4].token]
    assert study.run(score, until=50, executor=executor, deadline=1250.0) == trials
    assert len(executor.requests) == 5  # nothing is begun after it


@pytest.mark.parametrize("jump", [-1e6, 1e6])
def test_a_jump_of_the_machines_clock_changes_nothing_but_stamps(tmp_path, monkeypatch, jump):
    def run(path):
        with Study(SPACE, path, seed=3, n_init=4) as study:
            return study.run(score, until=6, executor=StandIn(slots=2), patience=1000), study.attempts()

    expected, _ = run(tmp_path / "a.sqlite")
    now = time.time
    looks = []

    def jumping():
        looks.append(1)
        return now() + jump * (len(looks) > 5)

    monkeypatch.setattr(time, "time", jumping)
    trials, attempts = run(tmp_path / "b.sqlite")
    assert trials == expected
    assert any(a.ended - a.started == pytest.approx(jump, rel=0.01) for a in attempts)  # it was felt
    assert all(0.0 <= a.seconds < 1000.0 for a in attempts)


# --- confirmation ---------------------------------------------------------------------------------------


def test_confirmation_runs_in_parallel_with_retries_and_gives_the_same_answer(tmp_path):
    def noisy(request):
        return EvalResult(score(request).mean + (request.seed % 1000) / 1e4, 0.1, 4)

    answers = []
    for name, executor in (
        ("a", None),
        ("b", StandIn(slots=4, script=lambda n, r: EvalResult.failure("lost", "x") if n in (1, 5) else None)),
    ):
        with Study(SPACE, tmp_path / f"{name}.sqlite", seed=3, n_init=100) as study:
            study.run(noisy, until=5)
            seen = []
            answers.append(study.confirm(noisy, top_k=2, repeats=3, executor=executor, progress=seen.append))
            assert sorted((c.trial, c.repeat) for c in seen) == [(c.trial, c.repeat) for c in study.confirmations()]
            assert len(study.trials()) == 5  # confirmation is no trial
    assert answers[0] == answers[1]
    assert executor.most == 4
    assert len(executor.requests) == 9 + 2
    assert {r.repeat for r in executor.requests} == {0, 1, 2}


def test_an_interrupted_confirmation_goes_on(study):
    study.run(score, until=4)

    def script(number, request):
        if number == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        study.confirm(score, top_k=1, repeats=3, executor=StandIn(slots=2, script=script))
    done = [c for c in study.confirmations() if c.result is not None]
    executor = StandIn(slots=2)
    assert study.confirm(score, top_k=1, repeats=3, executor=executor).best.repeats == 3
    assert len(executor.requests) == 6 - len(done)
