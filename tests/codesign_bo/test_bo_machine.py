"""Any history of ask, tell, fail, retry, queue and crash counts each trial once."""

import tempfile
from pathlib import Path

import pytest
from codesign_bo import BoxSpace, EvalResult, Study, StudyError
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

SPACE = BoxSpace.box(["a", "b"], 0.0, 1.0, 0.5)
scores = st.builds(EvalResult, mean=st.floats(-1e6, 1e6), sem=st.none() | st.floats(0, 10))
kinds = st.sampled_from(["crash", "timeout", "lost", "diverged", "infeasible"])


class StudyMachine(RuleBasedStateMachine):
    @initialize()
    def start(self):
        self.folder = tempfile.TemporaryDirectory()
        self.proposed = {}  # trial -> (params, seed)
        self.results = {}
        self.in_hand = set()
        self.queued = []
        self.open()

    def open(self):
        # No surrogate here: it has its own tests, and this one is about accounting.
        self.study = Study(SPACE, Path(self.folder.name) / "s.sqlite", seed=2, n_init=10_000)

    @rule(n=st.integers(1, 3))
    def ask(self, n):
        for _ in range(n):
            lost = sorted(set(self.proposed) - set(self.results) - self.in_hand)
            (request,) = self.study.ask()
            assert request.trial == (lost[0] if lost else len(self.proposed))
            asked = (request.params, request.seed)
            assert self.proposed.setdefault(request.trial, asked) == asked
            self.in_hand.add(request.trial)

    def finish(self, data, result):
        trial = data.draw(st.sampled_from(sorted(set(self.proposed) - set(self.results))))
        self.study.tell(trial, result)
        self.results[trial] = result
        self.in_hand.discard(trial)

    @precondition(lambda self: set(self.proposed) - set(self.results))
    @rule(data=st.data(), result=scores)
    def tell(self, data, result):
        self.finish(data, result)

    @precondition(lambda self: set(self.proposed) - set(self.results))
    @rule(data=st.data(), kind=kinds)
    def fail(self, data, kind):
        self.finish(data, EvalResult.failure(kind, "x"))

    @precondition(lambda self: self.results)
    @rule(data=st.data(), other=scores)
    def tell_again(self, data, other):
        trial = data.draw(st.sampled_from(sorted(self.results)))
        self.study.tell(trial, self.results[trial])
        if other != self.results[trial]:
            with pytest.raises(StudyError):
                self.study.tell(trial, other)

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

    @invariant()
    def each_trial_counts_once(self):
        trials = self.study.trials()
        assert [t.trial for t in trials] == list(range(len(self.proposed)))
        assert {t.trial: (t.params, t.seed) for t in trials} == self.proposed
        assert {t.trial: t.result for t in trials if t.result is not None} == self.results
        tried = [t.params["a"] for t in trials if t.origin == "queued"]
        assert tried == self.queued[: len(tried)]

    def teardown(self):
        if hasattr(self, "study"):
            self.study.close()
            self.folder.cleanup()


StudyMachine.TestCase.settings = settings(max_examples=15, stateful_step_count=25, deadline=None)
TestStudyMachine = StudyMachine.TestCase
