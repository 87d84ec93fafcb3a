import math

import numpy as np
import pytest
from codesign_bo import BoxSpace, Categorical, Continuous, EvalResult, Score, Study, StudyError


@pytest.fixture
def study(space, tmp_path):
    with Study(space, tmp_path / "study.sqlite", seed=3) as study:
        yield study


def test_order_of_proposals_and_seeds(study, bowl):
    queued = [{"shank": 0.9, "thigh": 1.3}, {"thigh": 0.7, "shank": 1.4}]
    study.enqueue(queued)
    study.enqueue(queued)  # a resumed script queues the same again
    trials = study.run(bowl, until=6)
    assert [t.origin for t in trials] == ["nominal", "queued", "queued", "sobol", "surrogate", "surrogate"]
    assert trials[0].params == {"thigh": 1.0, "shank": 1.0}
    assert [dict(t.params) for t in trials[1:3]] == queued
    assert [q.trial for q in study.queue()] == [1, 2]
    for t in trials:
        sequence = np.random.SeedSequence(3, spawn_key=(t.trial,))
        assert t.seed == int(sequence.generate_state(1)[0]) >> 1
    assert study.run(bowl, until=6) == trials  # a total


def test_search_finds_the_top_of_a_bowl(study, bowl):
    study.run(bowl, until=14)
    best = study.best()
    assert math.hypot(best.params["thigh"] - 1.2, best.params["shank"] - 0.8) < 0.12
    assert best.mean == pytest.approx(1.0, abs=0.1)
    assert best.result == study.trials()[best.trial].result
    along = study.slices(17)["thigh"]
    assert along.values[0] == 0.6
    assert along.values[-1] == 1.4
    assert along.values[np.argmax(along.mean)] == pytest.approx(1.2, abs=0.11)
    assert study.leave_one_out().r2 > 0.5


def test_minimising_finds_the_bottom_and_counts_gains_downwards(space, bowl, tmp_path):
    def flipped(request):
        result = bowl(request)
        return EvalResult(-result.mean, result.sem, result.n)

    with Study(space, tmp_path / "s.sqlite", maximize=False) as study:
        study.run(flipped, until=10)
        best = study.best()
        gain = study.confirm(flipped, top_k=1, repeats=2).best
    assert math.hypot(best.params["thigh"] - 1.2, best.params["shank"] - 0.8) < 0.2
    assert gain.mean < gain.nominal_mean
    assert gain.gain > 0


def test_best_is_not_the_luckiest_observation(study):
    lucky = {"thigh": 1.31, "shank": 1.3}
    study.enqueue([{"thigh": 1.3, "shank": 1.31}, lucky, {"thigh": 1.32, "shank": 1.32}])
    told = [(1.0, 0.05), (0.5, 0.05), (1.5, 0.8), (0.5, 0.05), (0.0, 0.05)]
    for request in study.ask(5):
        study.tell(request.trial, EvalResult(*told[request.trial], 4))
    assert study.trials()[2].params == lucky
    assert study.best().trial == 0


def test_fixed_parameters_stay_exact(tmp_path):
    space = BoxSpace.box(["a", "b", "c"], 0.6, 1.4, 1.0).fix({"b": 1.1000000000000001})
    with Study(space, tmp_path / "s.sqlite", n_init=3) as study:
        study.run(lambda r: EvalResult(-((r.params["a"] - 1.3) ** 2) - r.params["c"]), until=6)
        assert {t.params["b"] for t in study.trials()} == {1.1000000000000001}
        assert study.best().params["b"] == 1.1000000000000001


def test_every_proposal_is_feasible(space, bowl, tmp_path):
    def short(designs):
        return designs.sum(axis=1) <= 2.0

    with Study(space, tmp_path / "s.sqlite", feasible=short) as study:
        for t in study.run(bowl, until=9):
            assert sum(t.params.values()) <= 2.0
        with pytest.raises(ValueError, match="infeasible"):
            study.enqueue([{"thigh": 1.4, "shank": 1.5}])
    with pytest.raises(ValueError, match="infeasible"):
        Study(space, tmp_path / "t.sqlite", feasible=lambda designs: designs[:, 0] > 1.2)


def test_parallel_asks_differ(study, bowl):
    requests = study.ask(8)
    points = np.array([list(r.params.values()) for r in requests])
    gaps = np.abs(points[:, None] - points[None]).max(-1) + np.eye(8)
    assert gaps.min() > 1e-3
    for r in requests:
        study.tell(r.trial, bowl(r))
    points = np.array([list(r.params.values()) for r in study.ask(4)])
    assert (np.abs(points[:, None] - points[None]).max(-1) + np.eye(4)).min() > 1e-3
    assert [t.origin for t in study.trials()[8:]] == ["surrogate"] * 4


def test_same_history_gives_the_same_next_design_whatever_the_order_of_telling(space, bowl, tmp_path):
    designs = []
    for name, order in (("a", 1), ("b", -1)):
        with Study(space, tmp_path / f"{name}.sqlite", seed=5) as study:
            for r in study.ask(6)[::order]:
                study.tell(r.trial, bowl(r))
            designs.append([r.params for r in study.ask(2)])
    assert designs[0] == designs[1]


def test_telling_is_idempotent_and_results_are_final(study):
    (request,) = study.ask()
    study.tell(request.trial, EvalResult(1.0, 0.1, 4))
    study.tell(request.trial, EvalResult(1.0, 0.1, 4))
    with pytest.raises(StudyError, match=r"trial 0 .* different result"):
        study.tell(request.trial, EvalResult(1.0, 0.2, 4))
    with pytest.raises(StudyError, match="no trial 7"):
        study.tell(7, EvalResult(1.0))
    assert study.trials()[0].result == EvalResult(1.0, 0.1, 4)


def test_failures_are_recorded_and_stay_out_of_the_model(study, bowl):
    def fragile(request):
        if request.params["thigh"] > 1.25:
            raise ZeroDivisionError("leg too long")
        return bowl(request)

    trials = study.run(fragile, until=12)
    failed = [t for t in trials if not t.ok]
    assert failed
    assert all(t.status == "crash" and "leg too long" in t.result.message for t in failed)
    assert len(study.surrogate().y) == 12 - len(failed)
    points = np.array([list(t.params.values()) for t in failed])
    assert len(np.unique(points.round(3), axis=0)) == len(failed)  # no failed design is tried twice


def test_a_broken_callback_is_stopped_and_can_be_retried(study, bowl):
    def broken(request):
        raise ImportError("no module named legs")

    with pytest.raises(StudyError, match=r"(?s)5 of 5 trials.*no module named legs.*retry_failed"):
        study.run(broken, until=30)
    before = study.trials()
    assert study.retry_failed() == 5
    after = study.run(bowl, until=5)
    assert all(t.ok for t in after)
    assert [(t.params, t.seed) for t in after] == [(t.params, t.seed) for t in before]
    assert {t.attempts for t in after} == {2}


def test_a_callback_that_returns_something_else_leaves_its_trial_open(study, bowl):
    with pytest.raises(TypeError, match="float"):
        study.run(lambda request: 1.0, until=1)
    assert study.trials()[0].status == "unfinished"


@pytest.mark.parametrize("fault", [KeyboardInterrupt, OSError, MemoryError])
def test_faults_of_the_machine_pass_through_and_the_trial_is_dispatched_again(space, tmp_path, fault):
    def interrupted(request):
        raise fault

    with Study(space, tmp_path / "s.sqlite") as study, pytest.raises(fault):
        study.run(interrupted, until=3)
    with Study(space, tmp_path / "s.sqlite") as study:
        (request,) = study.ask()
        assert (request.trial, request.attempt) == (0, 2)
        assert study.ask()[0].trial == 1


def test_progress_and_work_folders(study, bowl, tmp_path):
    seen = []

    def evaluate(request):
        (request.workdir / "log.txt").write_text("done")
        return bowl(request)

    study.run(evaluate, until=2, progress=lambda t: seen.append((t.trial, t.status)))
    assert seen == [(0, "ok"), (1, "ok")]
    assert (tmp_path / "trials" / "0001" / "log.txt").exists()


def test_screening_chooses_what_is_tried_first(study, bowl):
    points = [
        {"thigh": 1.001, "shank": 1.0},  # the best score, but next to the nominal design
        {"thigh": 1.2, "shank": 0.8},
        {"thigh": 1.21, "shank": 0.81},  # next to a better one
        {"thigh": 0.7, "shank": 1.4},
        {"thigh": 1.4, "shank": 1.5},
    ]
    study.add_screening(points, [9.0, 8.0, 7.0, 6.0, 5.0])
    study.add_screening(points[-1:], [-5.0])
    assert [(dict(s.params), s.value) for s in study.screening()][-1] == (points[-1], -5.0)
    assert study.enqueue_screened(2) == [points[1], points[3]]
    trials = study.run(bowl, until=3)
    assert [dict(t.params) for t in trials[1:]] == [points[1], points[3]]
    assert len(study.surrogate().y) == 3  # screening scores are no data
    with pytest.raises(ValueError, match="finite"):
        study.add_screening(points[:1], [math.nan])
    with pytest.raises(ValueError, match="1 designs, but 2"):
        study.add_screening(points[:1], [1.0, 2.0])


def test_other_choices_are_other_designs_when_screening(tmp_path):
    names = tuple(f"foot{i}" for i in range(30))  # neighbours are 1/30 apart on their edge of the unit cube
    space = BoxSpace((Categorical("foot", names, "foot0"), Continuous("a", 0.0, 1.0, 0.5)))
    points = [{"foot": foot, "a": a} for foot, a in (("foot0", 0.55), ("foot1", 0.5), ("foot2", 0.5), ("foot2", 0.55))]
    with Study(space, tmp_path / "s.sqlite") as study:
        study.add_screening(points, [4.0, 3.0, 2.0, 1.0])
        assert study.enqueue_screened(4) == points[1:3]


def test_scores_at_lower_fidelities_are_kept_but_are_no_data_of_the_model(study, bowl):
    study.add_screening([{"thigh": 1.2, "shank": 0.8}, {"thigh": 0.7, "shank": 1.4}], [8.0, 6.0], [0.5, None])

    def evaluate(request):
        result = bowl(request)
        if request.trial == 1:
            return EvalResult.stopped([(1, 0.1), (2, 0.3)], fidelity=0.5)
        return EvalResult(result.mean, result.sem, 4, scores=(Score(0.0, -1.0 - request.trial, 0.25, 8),))

    study.run(evaluate, until=3)
    found = [(s.trial, s.fidelity, s.mean, s.sem) for s in study.scores()]
    assert found[:2] == [(None, 0.0, 8.0, 0.5), (None, 0.0, 6.0, None)]
    assert found[2:] == [(0, 0.0, -1.0, 0.25), (1, 0.5, 0.3, None), (2, 0.0, -3.0, 0.25)]
    assert [s.params for s in study.scores()][2:] == [t.params for t in study.trials()]
    assert study.observations().trial.tolist() == [0, 2]
    with pytest.raises(ValueError, match="1 designs, but 2 standard errors"):
        study.add_screening([{"thigh": 1.2, "shank": 0.8}], [8.0], [0.5, 0.5])


def test_confirmation_runs_on_fresh_shared_seeds_and_adds_up(study, bowl):
    study.run(bowl, until=8)
    calls = []

    def counted(request):
        calls.append(request)
        return bowl(request)

    confirmation = study.confirm(counted, top_k=2, repeats=3)
    searched = {t.seed for t in study.trials()}
    ranked = [e.trial for e in study.ranking() if e.trial != 0][:2]
    assert {g.trial for g in confirmation.gains} == set(ranked)
    seeds = [{r.seed for r in calls if r.trial == t} for t in (0, *ranked)]
    assert seeds[0] == seeds[1] == seeds[2]
    assert len(seeds[0]) == 3
    assert not seeds[0] & searched
    assert len({r.workdir for r in calls}) == 9
    assert confirmation.best.gain == pytest.approx(0.08, abs=0.1)  # 1 - 0 against 1 - 0.2**2 - 0.2**2
    calls.clear()
    assert study.confirm(counted, top_k=2, repeats=3) == confirmation
    assert not calls
    more = study.confirm(counted, top_k=2, repeats=4)
    assert len(calls) == 3
    assert more.best.repeats == 4


def test_settings_out_of_range_are_refused(space, tmp_path):
    with pytest.raises(ValueError, match="seed"):
        Study(space, tmp_path / "s.sqlite", seed=-1)
    with pytest.raises(ValueError, match="n_init"):
        Study(space, tmp_path / "s.sqlite", n_init=0)
    with Study(space, tmp_path / "s.sqlite") as study:
        with pytest.raises(StudyError, match="no trial"):
            study.best()
        for counts in ({"top_k": 0}, {"repeats": 0}):
            with pytest.raises(ValueError, match=r"is 0 .*must be >= 1|is 0; both"):
                study.confirm(lambda request: EvalResult(1.0), **counts)


def test_trouble_of_the_machine_leaves_the_trial_open(space, tmp_path):
    calls = []

    def evaluate(request):
        calls.append(request)
        if len(calls) == 2:
            raise OSError(28, "No space left on device")
        return EvalResult(mean=float(len(calls)), sem=0.1)

    with Study(space, tmp_path / "study.sqlite", seed=3) as study:
        with pytest.raises(OSError, match="No space left"):
            study.run(evaluate, until=3)
        assert [t.status for t in study.trials()] == ["ok", "unfinished"]
    with Study(space, tmp_path / "study.sqlite", seed=3) as study:
        assert [t.status for t in study.run(evaluate, until=3)] == ["ok"] * 3
    assert (calls[2].trial, calls[2].params, calls[2].seed) == (calls[1].trial, calls[1].params, calls[1].seed)
