"""Any history of ask, tell, fail, lose, come late, retry, queue, import and crash counts each trial once."""

import tempfile
from pathlib import Path

import pytest
from codesign_bo import BoxSpace, EvalResult, Study, StudyError
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

SPACE = BoxSpace.box(["a", "b"], 0.0, 1.0, 0.5)
RETRIES = 1
scores = st.builds(EvalResult, mean=st.floats(-1e6, 1e6), sem=st.none() | st.floats(0, 10))
failures = st.sampled_from(["crash", "timeout", "lost", "diverged", "infeasible"]).map(
    lambda kind: EvalResult.failure(kind, "x")
)


class Attempt:
    """What the model knows of one attempt."""

    def __init__(self, trial):
        self.trial = trial
        self.told = None
        self.given_up = False
        self.fault = None  # "lost" or "diverged", if that is how it ended
        self.closed = False  # whether the trial was settled since


class StudyMachine(RuleBasedStateMachine):
    @initialize()
    def start(self):
        self.folder = tempfile.TemporaryDirectory()
        self.proposed = {}  # trial -> (params, seed)
        self.results = {}  # trial -> result
        self.attempts = {}  # token -> Attempt, in order of dispatch
        self.in_hand = set()
        self.queued = []
        self.open()

    def open(self):
        # No surrogate here: it has its own tests, and this one is about accounting.
        path = Path(self.folder.name) / "s.sqlite"
        self.study = Study(SPACE, path, seed=2, n_init=10_000, retries=RETRIES)

    # --- what the model expects -------------------------------------------------------------------------

    def settle(self, token, result):
        """Take an outcome of an attempt; return what the study should make of it."""
        attempt = self.attempts[token]
        trial = attempt.trial
        if trial in self.results:
            return "late"
        of_trial = [a for a in self.attempts.values() if a.trial == trial]
        others = [a.fault for a in of_trial if a is not attempt and not a.closed]
        attempt.fault = result.status if result.status in ("lost", "diverged") else None
        newest = self.attempts[self.latest(trial)]
        replaced = attempt is not newest and newest.told is None and not newest.given_up
        again = not result.ok and (
            replaced  # another attempt has taken over, and decides
            or (result.status == "lost" and others.count("lost") < RETRIES)
            or (result.status == "diverged" and "diverged" not in others)
        )
        if again:
            if token == self.latest(trial):
                self.in_hand.discard(trial)
            return "retry"
        self.results[trial] = result
        for a in of_trial:
            a.closed = True
        self.in_hand.discard(trial)
        return "counted"

    def latest(self, trial):
        return [token for token, a in self.attempts.items() if a.trial == trial][-1]

    def tokens(self, told):
        # in the order of dispatch: tokens are random, and a replay must draw the same attempts
        return [token for token, a in self.attempts.items() if (a.told is not None) == told]

    # --- what happens -----------------------------------------------------------------------------------

    @rule(n=st.integers(1, 3))
    def ask(self, n):
        for _ in range(n):
            waiting = sorted(set(self.proposed) - set(self.results) - self.in_hand)
            (request,) = self.study.ask()
            assert request.trial == (waiting[0] if waiting else len(self.proposed))
            asked = (request.params, request.seed)
            assert self.proposed.setdefault(request.trial, asked) == asked
            assert request.token not in self.attempts
            self.attempts[request.token] = Attempt(request.trial)
            assert request.attempt == sum(a.trial == request.trial for a in self.attempts.values())
            self.in_hand.add(request.trial)

    @precondition(lambda self: self.tokens(told=False))
    @rule(data=st.data(), result=scores | failures)
    def tell(self, data, result):
        """In time or late, whichever attempt it is."""
        token = data.draw(st.sampled_from(self.tokens(told=False)))
        trial = self.attempts[token].trial
        assert self.study.tell(trial, result, token) == self.settle(token, result)
        self.attempts[token].told = result

    @precondition(lambda self: self.tokens(told=False))
    @rule(data=st.data())
    def give_up(self, data):
        token = data.draw(st.sampled_from(self.tokens(told=False)))
        lost = EvalResult.failure("lost", "gone")
        trial = self.attempts[token].trial
        assert self.study.give_up(trial, token, "gone") == self.settle(token, lost)
        self.attempts[token].given_up = True

    @precondition(lambda self: self.tokens(told=True))
    @rule(data=st.data(), other=scores)
    def tell_again(self, data, other):
        token = data.draw(st.sampled_from(self.tokens(told=True)))
        attempt = self.attempts[token]
        assert self.study.tell(attempt.trial, attempt.told, token) == "repeated"
        if other != attempt.told:
            with pytest.raises(StudyError):
                self.study.tell(attempt.trial, other, token)

    @precondition(lambda self: self.attempts)
    @rule(data=st.data(), result=scores)
    def tell_with_a_foreign_token(self, data, result):
        trial = data.draw(st.sampled_from(sorted(self.proposed)))
        foreign = [token for token, a in self.attempts.items() if a.trial != trial]
        with pytest.raises(StudyError):
            self.study.tell(trial, result, data.draw(st.sampled_from([*foreign, "forged"])))

    @rule()
    def retry_failed(self):
        failed = [t for t, r in self.results.items() if not r.ok]
        assert self.study.retry_failed() == len(failed)
        for trial in failed:
            del self.results[trial]

    @rule(a=st.sampled_from([0.1, 0.2, 0.3]))
    def enqueue(self, a):
        self.study.enqueue([{"a": a, "b": 0.25}])
        if a not in self.queued:
            self.queued.append(a)

    @rule()
    def crash_and_resume(self):
        self.study.close()
        self.in_hand.clear()
        self.open()

    # --- what must always hold --------------------------------------------------------------------------

    @invariant()
    def each_trial_counts_once(self):
        trials = self.study.trials()
        assert [t.trial for t in trials] == list(range(len(self.proposed)))
        assert {t.trial: (t.params, t.seed) for t in trials} == self.proposed
        assert {t.trial: t.result for t in trials if t.result is not None} == self.results
        assert self.study.finished() == len(self.results)
        tried = [t.params["a"] for t in trials if t.origin == "queued"]
        assert tried == self.queued[: len(tried)]

    @invariant()
    def every_word_is_on_record(self):
        recorded = {a.token: a for a in self.study.attempts()}
        assert {token: a.result for token, a in recorded.items()} == {t: a.told for t, a in self.attempts.items()}
        for trial in self.results:
            assert any(a.final for a in recorded.values() if a.trial == trial)
            assert not any(a.status == "running" for a in recorded.values() if a.trial == trial)

    def teardown(self):
        if hasattr(self, "study"):
            self.study.close()
            self.folder.cleanup()


StudyMachine.TestCase.settings = settings(max_examples=15, stateful_step_count=25, deadline=None)
TestStudyMachine = StudyMachine.TestCase
