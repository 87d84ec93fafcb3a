"""Warm start from past studies."""

import numpy as np
import pytest
from codesign_bo import BoxSpace, Categorical, Continuous, EvalResult, Integer, Study, StudyError, open_study
from codesign_bo.exchange import export_study, import_study

AB = BoxSpace.box(["a", "b"], 0.0, 1.0, 0.5)


def bowl(request):
    return EvalResult(1.0 - sum((v - 0.8) ** 2 for v in request.params.values()), 0.01, 4)


def past(path, space, points=(), maximize=True, callback=bowl):
    """A finished study of the nominal design and these."""
    with Study(space, path, seed=9, n_init=100, maximize=maximize) as study:
        study.enqueue(points)
        study.run(callback, until=1 + len(points))
    return path


def points(*values):
    return [{"a": a, "b": b} for a, b in values]


def loses_0(request):
    return bowl(request) if request.trial else EvalResult.failure("lost", "x")


@pytest.fixture
def other(tmp_path):
    return past(tmp_path / "other.sqlite", AB, points((0.9, 0.7), (0.2, 0.1), (0.7, 0.9)))


@pytest.fixture
def study(tmp_path):
    with Study(AB, tmp_path / "study.sqlite", seed=3) as study:
        yield study


def test_results_become_data_but_no_trials(study, other):
    imported = study.add_history(other)
    assert (imported.added, imported.left_out) == (4, {})
    assert study.trials() == []
    assert study.finished() == 0
    data = study.observations()
    assert data.imported.all()
    assert data.x.tolist() == [[0.5, 0.5], [0.9, 0.7], [0.2, 0.1], [0.7, 0.9]]
    assert data.y == pytest.approx([1 - 2 * 0.09, 1 - 0.01 - 0.01, 1 - 0.36 - 0.49, 1 - 0.01 - 0.01])
    assert (data.sem == 0.01).all()
    assert data.trial.tolist() == [0, 1, 2, 3]
    trials = study.run(bowl, until=2)
    assert [t.trial for t in trials] == [0, 1]
    assert study.observations().imported.tolist() == [False, False, True, True, True, True]
    assert {e.trial for e in study.ranking()} == {0, 1}  # what is recommended was tried here


def test_the_search_starts_where_the_other_left_off(study, other):
    study.add_history(other)
    trials = study.run(bowl, until=5)
    assert [t.origin for t in trials] == ["nominal", *["surrogate"] * 4]  # the nominal design still comes first
    assert max(t.result.mean for t in trials) > 0.95


def test_adding_again_adds_only_what_is_new(study, other):
    with open_study(other) as view:
        assert study.add_history(view).added == 4
        assert study.add_history(view).added == 0
    with Study(AB, other, seed=9, n_init=100) as more:
        more.run(bowl, until=6)
        assert study.add_history(more).added == 2  # also while it is being written
    assert len(study.history()) == 6


def test_the_same_history_gives_the_same_next_design_after_a_restart_and_an_export(tmp_path, other):
    def next_designs(path):
        with Study(AB, path, seed=3) as study:
            return [r.params for r in study.ask(2)]

    for name in ("a", "b"):
        with Study(AB, tmp_path / f"{name}.sqlite", seed=3) as study:
            study.run(bowl, until=2)
            study.add_history(other)
            export_study(study, tmp_path / "a.json")
    import_study(tmp_path / "a.json", tmp_path / "c.sqlite")
    with open_study(tmp_path / "b.sqlite") as b, open_study(tmp_path / "c.sqlite") as c:
        assert b.history() == c.history()
        assert b.identity == c.identity
    designs = [next_designs(tmp_path / f"{name}.sqlite") for name in "abc"]
    assert designs[0] == designs[1] == designs[2]


def test_a_parameter_that_only_this_study_has_is_at_its_nominal_value(tmp_path, other):
    space = BoxSpace.box(["c", "b", "a"], 0.0, 1.0, [0.25, 0.5, 0.5])
    with Study(space, tmp_path / "s.sqlite") as study:
        assert study.add_history(other).added == 4
        assert [dict(h.params) for h in study.history()][1] == {"c": 0.25, "b": 0.7, "a": 0.9}


def test_a_parameter_that_only_the_other_study_has_must_not_have_been_varied(tmp_path, other):
    with Study(BoxSpace.box(["a"], 0.0, 1.0, 0.5), tmp_path / "s.sqlite") as study:
        space = AB.with_nominal({"a": 0.3, "b": 0.3})
        nothing = past(tmp_path / "x.sqlite", space, points((0.9, 0.7)), callback=loses_0)
        with pytest.raises(StudyError, match=r"no trial of .* has a place in this study; trial 0: it was lost"):
            study.add_history(nothing)
        imported = study.add_history(other)
        assert imported.added == 1
        assert set(imported.left_out) == {1, 2, 3}
        assert "varies ['b']" in imported.left_out[1]
        assert [dict(h.params) for h in study.history()] == [{"a": 0.5}]


def test_designs_outside_the_space_are_left_out_with_the_reason(tmp_path, other):
    space = AB.with_bounds({"a": (0.3, 0.8)})
    with Study(space, tmp_path / "s.sqlite") as study:
        imported = study.add_history(other)
        assert imported.added == 2
        assert set(imported.left_out) == {1, 2}
        assert "0.9" in imported.left_out[1]
    with Study(AB.fix({"b": 0.7}), tmp_path / "t.sqlite") as study:
        assert study.add_history(other).added == 1
        assert [dict(h.params) for h in study.history()] == [{"a": 0.9, "b": 0.7}]


def test_failures_teach_viability_and_lost_evaluations_nothing(tmp_path, study):
    kinds = ["ok"] * 5 + ["crash", "diverged", "lost", "infeasible", "timeout"]

    def fails(request):
        kind = kinds[request.trial]
        return bowl(request) if kind == "ok" else EvalResult.failure(kind, "x")

    other = past(tmp_path / "o.sqlite", AB, points(*[(0.1 * i, 0.9) for i in range(1, 10)]), callback=fails)
    imported = study.add_history(other)
    assert (imported.added, imported.left_out) == (9, {7: "it was lost"})
    assert len(study.observations().y) == 5
    viability = study.viability()
    assert viability.viable.tolist() == [True] * 5 + [False] * 4
    assert viability.x[1:, 0] == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 0.9])
    study.tell(study.ask()[0].trial, EvalResult.failure("infeasible", "x"))
    assert study.viability().viable.tolist() == [False] + [True] * 5 + [False] * 4
    assert study.finished() == 1


def test_values_that_are_no_floats_are_matched_too(tmp_path):
    space = BoxSpace(
        (Continuous("a", 0.0, 1.0, 0.5), Integer("n", 1, 5, 2), Categorical("foot", ("ball", "flat"), "ball"))
    )

    def score(request):
        assert isinstance(request.params["n"], int)
        return EvalResult(request.params["a"] + request.params["n"] + (request.params["foot"] == "flat"), 0.1)

    other = past(tmp_path / "o.sqlite", space, [{"a": 0.1, "n": 4, "foot": "flat"}], callback=score)
    with Study(space, tmp_path / "s.sqlite") as study:
        assert study.add_history(other).added == 2
        assert [dict(h.params) for h in study.history()][1] == {"a": 0.1, "n": 4, "foot": "flat"}
        study.run(score, until=3)
    with Study(
        BoxSpace((*space.parameters[:2], Categorical("foot", ("ball", "hoof"), "ball"))), tmp_path / "t.sqlite"
    ) as study:
        imported = study.add_history(other)
        assert imported.added == 1
        assert "foot" in imported.left_out[1]


def test_what_cannot_be_history_is_refused(tmp_path, study, other):
    study.run(bowl, until=1)
    with pytest.raises(StudyError, match="this very study"):
        study.add_history(study)
    down = past(tmp_path / "down.sqlite", AB, maximize=False)
    with pytest.raises(StudyError, match="minimizes its objective, this study maximizes"):
        study.add_history(down)
    strange = past(tmp_path / "strange.sqlite", BoxSpace.box(["x"], 0.0, 1.0, 0.5))
    with pytest.raises(StudyError, match="none in common"):
        study.add_history(strange)
    with pytest.raises(StudyError, match="no study at"):
        study.add_history(tmp_path / "none.sqlite")
    assert study.history() == []


def test_further_objectives_come_along_where_they_are_known(tmp_path):
    def with_energy(request):
        extras = {"energy": 7.0, "energy_sem": 0.5} if request.trial else {}
        return EvalResult(1.0, 0.1, extras=extras)

    other = past(tmp_path / "o.sqlite", AB, points((0.9, 0.7)), callback=with_energy)
    with Study(AB, tmp_path / "s.sqlite", objectives={"energy": "minimize"}) as study:
        study.add_history(other)
        assert study.observations().y.tolist() == [1.0, 1.0]
        energy = study.observations("energy")
        assert (energy.y.tolist(), energy.sem.tolist(), energy.trial.tolist()) == ([7.0], [0.5], [1])
        with pytest.raises(ValueError, match=r"no objective 'power'; it has \['energy'\]"):
            study.observations("power")


def test_no_data_is_an_array_too(study):
    assert study.observations().x.shape == (0, 2)
    assert study.viability().x.shape == (0, 2)
    assert np.isnan(study.observations().sem).sum() == 0
