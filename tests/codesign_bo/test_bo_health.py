"""Health checks: each has a sick study that it must find and a sound one that it must pass."""

import numpy as np
import pytest
from codesign_bo import BoxSpace, EvalResult, Integer, Study
from codesign_bo.health import SEVERITIES, Check, health, worst
from codesign_bo.records import Basis, Proposal

SQUARE = BoxSpace.box(["a", "b"], 0.0, 1.0, 0.5)


@pytest.fixture
def told(tmp_path):
    opened = []

    def make(result, n=15, space=SQUARE, designs=None, **settings):
        study = Study(space, tmp_path / f"{len(opened)}.sqlite", n_init=1000, **settings)
        opened.append(study)
        study.enqueue(designs or [])
        for request in (study.ask()[0] for _ in range(n)):
            study.tell(request.trial, result(request), request.token)
        return study

    yield make
    for study in opened:
        study.close()


def of(study, name):
    (found,) = [c for c in health(study) if c.name == name]
    return found


def bowl(request):
    noise = np.random.default_rng(request.seed).normal()
    return EvalResult(
        5 - 9 * (request.params["a"] - 0.9) ** 2 - 4 * (request.params["b"] - 0.2) ** 2 + 0.1 * noise, 0.1
    )


def noise(request):
    return EvalResult(np.random.default_rng(request.seed).normal(), 1.0)


def test_a_sound_study(told):
    study = told(bowl)
    study.confirm(bowl, top_k=1, repeats=4)
    found = {c.name: c.severity for c in health(study)}
    assert found == {
        "candidates": "ok",
        "failures": "ok",
        "improvement over nominal": "ok",
        "parameter effects": "ok",
        "predictability": "ok",
        "bounds": "ok",
        "standard errors": "ok",
        "repeats": "ok",
    }


def test_every_finding_has_a_way_out_and_the_worst_comes_first(told):
    checks = health(told(lambda r: EvalResult.failure("crash", "x") if r.trial % 2 else noise(r)))
    assert [SEVERITIES.index(c.severity) for c in checks] == sorted(SEVERITIES.index(c.severity) for c in checks)
    assert all(c.way_out for c in checks if c.severity in ("warning", "error"))
    assert worst(checks) == "warning"
    assert worst([Check("x", "ok", "x"), Check("y", "error", "y")]) == "error"


@pytest.mark.parametrize("n", [0, 1])
def test_a_study_that_has_hardly_begun(told, n):
    assert worst(health(told(noise, n))) == "info"


# --- candidates -----------------------------------------------------------------------------------------


def test_all_designs_of_a_small_space_were_tried(told):
    space = BoxSpace((Integer("teeth", 1, 3, 2),))
    study = told(noise, 3, space, [{"teeth": 1}, {"teeth": 3}])
    assert "All 3 designs of the space have been tried" in of(study, "candidates").sentence
    assert of(told(noise, 2, space, [{"teeth": 1}]), "candidates").severity == "ok"


def test_a_fit_that_failed_is_named(told):
    study = told(noise, 2)
    for trial in (2, 3):
        proposal = Proposal({"a": 0.1, "b": 0.1 * trial}, "surrogate", basis=Basis("prior", "", 0.0, ()))
        study._storage.add_trial(trial, proposal, 1)
    check = of(study, "candidates")
    assert check.severity == "warning"
    assert "trials 2-3" in check.sentence


# --- failures -------------------------------------------------------------------------------------------


def test_failures_are_counted_by_kind(told):
    def result(request):
        kind = {3: "timeout", 5: "crash", 8: "crash"}.get(request.trial)
        return noise(request) if kind is None else EvalResult.failure(kind, "x")

    check = of(told(result, 20), "failures")
    assert check.severity == "info"
    assert "3 of 20 trials failed (15%: 2 crash, 1 timeout)" in check.sentence
    assert "stderr.txt" in check.way_out
    assert "timeout" in check.way_out


@pytest.mark.parametrize(("every", "severity"), [(3, "warning"), (1, "error")])
def test_many_failures_are_worse(told, every, severity):
    study = told(lambda r: noise(r) if r.trial % every else EvalResult.failure("crash", "x"), 12)
    assert of(study, "failures").severity == severity


def test_failures_in_one_part_are_located(told):
    study = told(lambda r: EvalResult.failure("infeasible", "x") if r.params["a"] > 0.75 else noise(r), 30)
    check = of(study, "failures")
    assert check.severity == "warning"
    assert "failures cluster where a > 0.7" in check.sentence
    assert "constraint" in check.way_out


# --- improvement ----------------------------------------------------------------------------------------


def test_nothing_differs_from_the_nominal_design(told):
    study = told(lambda r: EvalResult(1.0 + 1e-3 * np.random.default_rng(r.seed).normal(), 0.5), 12)
    check = of(study, "improvement over nominal")
    assert check.severity == "warning"
    assert check.sentence == "No design differs from the nominal beyond noise."


def test_the_nominal_design_is_the_best(told):
    def peak(request):
        return EvalResult(-sum((v - 0.5) ** 2 for v in request.params.values()), 0.01)

    check = of(told(peak), "improvement over nominal")
    assert check.sentence == "No design is expected to be better than the nominal one."


def test_a_better_design_is_better_only_once_confirmed(told):
    study = told(bowl)
    check = of(study, "improvement over nominal")
    assert (check.severity, check.way_out) == ("info", "Run `confirm()`.")
    assert "is better than the nominal design" in check.sentence
    study.confirm(noise, top_k=1, repeats=3)  # on fresh seeds there is nothing in it
    check = of(study, "improvement over nominal")
    assert (check.severity, check.sentence) == (
        "warning",
        "No confirmed design is better than the nominal one beyond noise.",
    )


def test_a_nominal_design_that_failed(told):
    study = told(lambda r: noise(r) if r.trial else EvalResult.failure("crash", "x"))
    check = of(study, "improvement over nominal")
    assert "The nominal design failed (crash)" in check.sentence


# --- effects and predictions ----------------------------------------------------------------------------


def test_no_effects_and_no_predictions(told):
    study = told(noise, 20)
    assert of(study, "parameter effects").sentence == "No parameter has an effect that the data can tell from noise."
    assert "hardly better than the mean" in of(study, "predictability").sentence


def test_a_parameter_that_does_nothing(told):
    study = told(lambda r: EvalResult(r.params["a"] * 5 + 0.1 * np.random.default_rng(r.seed).normal(), 0.1), 20)
    check = of(study, "parameter effects")
    assert (check.severity, check.sentence) == ("info", "The data cannot tell whether b matters.")


def test_a_surrogate_that_is_too_sure_of_itself(told, monkeypatch):
    study = told(bowl)
    sure = study.leave_one_out()
    narrow = type(sure)(sure.y, sure.mean, sure.std / 8)
    monkeypatch.setattr(type(study), "leave_one_out", lambda self: narrow)
    check = of(study, "predictability")
    assert check.severity == "warning"
    assert check.sentence.startswith("The surrogate is too sure of itself")


# --- bounds, standard errors, repeats -------------------------------------------------------------------


def test_the_best_design_lies_at_a_bound(told):
    def slope(request):
        return EvalResult(request.params["a"] - (request.params["b"] - 0.5) ** 2, 0.01)

    study = told(slope, 6, designs=[{"a": 1.0, "b": 0.5}])
    check = of(study, "bounds")
    assert check.severity == "info"
    assert "at the upper bound of a (1)" in check.sentence
    assert "b" not in check.sentence.split("bound of ")[1].split(" ")[0]
    teeth = BoxSpace((Integer("teeth", 2, 9, 5),))
    study = told(lambda r: EvalResult(-float(r.params["teeth"]), 0.01), 4, teeth, [{"teeth": t} for t in (2, 4, 8)])
    assert "at the lower bound of teeth (2)" in of(study, "bounds").sentence


@pytest.mark.parametrize(("known", "severity"), [(0, "info"), (5, "warning")])
def test_missing_standard_errors(told, known, severity):
    study = told(lambda r: EvalResult(noise(r).mean, 0.5 if r.trial < known else None), 12)
    check = of(study, "standard errors")
    assert (check.severity, check.sentence.split(" have")[0]) == (severity, f"{12 - known} of 12 scores")


def half_told(request):
    """A slope with noise of 0.5, of which the reported error of 0.02 leaves out nearly all."""
    noise = np.random.default_rng(request.seed).normal()
    return EvalResult(4 * request.params["a"] + 0.5 * noise, 0.02)


def test_standard_errors_that_leave_the_noise_out(told):
    check = of(told(half_told, 25), "standard errors")
    assert check.severity == "warning"
    assert "far more than the reported standard errors say (±0.02 at the median)" in check.sentence


def test_repeats_show_that_standard_errors_leave_the_noise_out(told):
    study = told(half_told, 3)  # too few for the surrogate to tell
    assert of(study, "standard errors").severity == "ok"
    study.confirm(half_told, top_k=2, repeats=4)
    scores = {}
    for c in study.confirmations():
        scores.setdefault(c.trial, []).append(c.result.mean)
    for t in study.trials():
        scores[t.trial].append(t.result.mean)
    spread = np.sqrt(sum(np.var(s) * len(s) for s in scores.values()) / (3 * 4))  # 5 scores of each of 3 designs
    check = of(study, "standard errors")
    assert check.severity == "warning"
    assert check.sentence.startswith(f"Repeated evaluations of a design vary by ±{spread:.2g}, far more than")
    honest = told(lambda r: EvalResult(half_told(r).mean, 0.5), 3)
    honest.confirm(lambda r: EvalResult(half_told(r).mean, 0.5), top_k=2, repeats=4)
    assert of(honest, "standard errors").severity == "ok"


def test_a_callback_that_ignores_its_seed(told):
    def deaf(request):
        return EvalResult(request.params["a"], 0.3)

    study = told(deaf, 4)
    assert of(study, "repeats").sentence == "No design has been evaluated on more than one seed."
    study.confirm(deaf, top_k=1, repeats=2)
    check = of(study, "repeats")
    assert check.severity == "warning"
    assert "exactly the same score" in check.sentence
    exact = told(lambda r: EvalResult(r.params["a"], 0.0), 4)
    exact.confirm(lambda r: EvalResult(r.params["a"], 0.0), top_k=1, repeats=2)
    assert of(exact, "repeats").severity == "ok"
