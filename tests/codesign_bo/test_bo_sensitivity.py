"""Sobol indices against closed forms, effects against simulations, clusters of failures against their cause."""

import numpy as np
import pytest
from codesign_bo import BoxSpace, Categorical, Continuous, EvalResult, Integer, Study, StudyError
from codesign_bo.failures import failure_cluster
from codesign_bo.sensitivity import any_effect, constant_log_likelihood, sensitivity, sobol_indices

CUBE = BoxSpace.box(["a", "b", "c"], 0.0, 1.0, 0.5)


def study_of(path, space, designs, result, **settings):
    study = Study(space, path, n_init=1000, **settings)
    study.enqueue(designs)
    for _ in range(len(designs) + 1):
        (request,) = study.ask()
        study.tell(request.trial, result(request.params), request.token)
    return study


def scattered(n, seed, names="abc"):
    return [dict(zip(names, row, strict=True)) for row in np.random.default_rng(seed).random((n, len(names))).tolist()]


# --- Sobol indices --------------------------------------------------------------------------------------


def test_indices_of_ishigami_are_those_of_its_closed_form():
    """Ishigami's function with a = 7, b = 0.1 over [-pi, pi]^3."""

    def ishigami(u):
        x = np.pi * (2 * u - 1)
        return np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])

    first, total = sobol_indices(ishigami, 3, seed=0, n=4096)
    np.testing.assert_allclose(first, [0.3139, 0.4424, 0.0], atol=0.02)
    np.testing.assert_allclose(total, [0.5576, 0.4424, 0.2437], atol=0.02)


@pytest.mark.parametrize("weights", [(1.0, 2.0), (1.0, 0.0, 3.0), (5.0,)])
def test_indices_of_a_sum_are_shares_of_its_variance(weights):
    squares = np.array(weights) ** 2
    first, total = sobol_indices(lambda u: u @ np.array(weights) + 1e4, len(weights), seed=1)
    np.testing.assert_allclose(first, squares / squares.sum(), atol=0.01)
    np.testing.assert_allclose(total, squares / squares.sum(), atol=0.01)


def test_a_constant_has_no_indices():
    first, total = sobol_indices(lambda u: np.full(len(u), 1e6), 3, seed=0)
    assert (first.tolist(), total.tolist()) == ([0.0] * 3, [0.0] * 3)


# --- effects --------------------------------------------------------------------------------------------


def test_effects_of_a_study(tmp_path):
    """Two of three parameters matter, and the data show it; the third is found to be idle."""
    noise = np.random.default_rng(7)

    def value(p):
        return EvalResult(4 * p["a"] + 3 * np.sin(4 * p["b"]) + 0.1 * noise.normal(), 0.1)

    with study_of(tmp_path / "s.sqlite", CUBE, scattered(24, 3), value) as study:
        a, b, c = sensitivity(study)
        assert [e.name for e in (a, b, c)] == ["a", "b", "c"]
        assert a.identifiable
        assert b.identifiable
        assert not c.identifiable
        # variances over the cube: 16 / 12 of 4 a, and 9 (1/2 - sin(8) / 16 - ((1 - cos 4) / 4)^2) of 3 sin(4 b)
        of_a, of_b = 16 / 12, 9 * (0.5 - np.sin(8) / 16 - ((1 - np.cos(4)) / 4) ** 2)
        assert a.total == pytest.approx(of_a / (of_a + of_b), abs=0.1)
        assert b.total == pytest.approx(of_b / (of_a + of_b), abs=0.1)
        assert c.total < 0.05
        assert b.lengthscale < c.lengthscale
        assert any_effect(study)


@pytest.mark.slow
def test_what_does_nothing_is_rarely_called_identifiable(tmp_path):
    """Of 24 idle parameters about one may be, at 95 %; of 8 studies of noise alone none or one has any effect."""
    told, effects = 0, 0
    for seed in range(8):
        noise = np.random.default_rng(100 + seed)
        made = study_of(
            tmp_path / f"{seed}.sqlite", CUBE, scattered(17, seed), lambda p, n=noise: EvalResult(n.normal(), 0.3)
        )
        with made as study:
            told += sum(e.identifiable for e in sensitivity(study))
            effects += any_effect(study)
    assert told <= 4
    assert effects <= 2


def test_noise_alone_has_the_likelihood_of_a_normal_sample(tmp_path):
    """Without known errors: -n/2 (log(2 pi v) + 1), with the variance v = (n - 1)/n of standardised scores."""
    noise = np.random.default_rng(3)
    with study_of(tmp_path / "s.sqlite", CUBE, scattered(11, 0), lambda p: EvalResult(7 + 2 * noise.normal())) as study:
        found = constant_log_likelihood(study.surrogate())
    assert found == pytest.approx(-6 * (np.log(2 * np.pi * 11 / 12) + 1), abs=0.01)


def test_effects_of_a_categorical_and_an_integer(tmp_path):
    space = BoxSpace(
        (Categorical("foot", ("ball", "flat"), "ball"), Integer("teeth", 1, 9, 5), Continuous("idle", 0.0, 1.0, 0.5))
    )
    rng = np.random.default_rng(0)
    designs = [
        {"foot": str(rng.choice(["ball", "flat"])), "teeth": int(rng.integers(1, 10)), "idle": float(rng.random())}
        for _ in range(20)
    ]

    def value(p):
        return EvalResult((p["foot"] == "flat") * 2.0 + p["teeth"] / 9 + 0.05 * rng.normal(), 0.05)

    with study_of(tmp_path / "s.sqlite", space, designs, value) as study:
        foot, teeth, idle = sensitivity(study)
        assert foot.identifiable
        assert teeth.identifiable
        assert not idle.identifiable
        # variances: 1 of the foot, (81 - 1) / 12 / 81 of the teeth
        assert foot.total == pytest.approx(1 / (1 + 80 / 12 / 81), abs=0.06)


def test_effects_need_three_scores(tmp_path):
    with study_of(tmp_path / "s.sqlite", CUBE, scattered(1, 0), lambda p: EvalResult(1.0)) as study:
        for ask in (sensitivity, any_effect):
            with pytest.raises(StudyError, match="has 2 scores; effects of parameters need at least 3"):
                ask(study)


# --- clusters of failures -------------------------------------------------------------------------------


def failing(tmp_path, space, designs, fails):
    return study_of(
        tmp_path / "f.sqlite",
        space,
        designs,
        lambda p: EvalResult.failure("infeasible", "x") if fails(p) else EvalResult(0.0),
    )


def test_failures_in_a_corner_are_found(tmp_path):
    designs = scattered(39, 5)
    with failing(tmp_path, CUBE, designs, lambda p: p["a"] > 0.6 and p["b"] <= 0.4) as study:
        found = failure_cluster(study)
        inside = [p for p in designs if p["a"] > 0.6 and p["b"] <= 0.4]
        assert [words.split()[:2] for words in found.where] == [["a", ">"], ["b", "<="]]
        a, b = (float(words.split()[-1]) for words in found.where)
        assert (a, b) == (pytest.approx(0.6, abs=0.1), pytest.approx(0.4, abs=0.1))
        assert found.failed_inside + found.failed_outside == len(inside)
        assert found.inside + found.outside == 40
        assert found.failed_outside <= 1
        assert found.chance < 0.05
        counts = f"{found.failed_inside} of {found.inside} failed there, {found.failed_outside} of {found.outside}"
        assert counts in found.sentence()


def test_failures_beyond_one_threshold_need_one_condition(tmp_path):
    with failing(tmp_path, CUBE, scattered(29, 6), lambda p: p["c"] > 0.7) as study:
        (where,) = failure_cluster(study).where
        assert where.startswith("c > 0.")
        assert float(where.split()[-1]) == pytest.approx(0.7, abs=0.1)


def test_failures_of_a_choice_are_found(tmp_path):
    space = BoxSpace((Categorical("foot", ("ball", "flat", "claw"), "ball"), Integer("teeth", 1, 9, 5)))
    designs = [{"foot": foot, "teeth": teeth} for foot in ("ball", "flat", "claw") for teeth in range(1, 10, 2)]
    designs.remove({"foot": "ball", "teeth": 5})
    with failing(tmp_path, space, designs, lambda p: p["foot"] == "flat") as study:
        assert failure_cluster(study).where == ("foot is flat",)


def test_failures_anywhere_are_no_cluster(tmp_path):
    """A part as clear as chance gives in 19 of 20 studies is none; of 6 studies at most 2 may have one."""
    found = 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        path = tmp_path / f"{seed}"
        path.mkdir()
        with failing(path, CUBE, scattered(29, seed + 50), lambda p, r=rng: r.random() < 0.3) as study:
            found += failure_cluster(study) is not None
    assert found <= 2


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_all_or_no_failures_are_no_cluster(tmp_path, share):
    with failing(tmp_path, CUBE, scattered(9, 0), lambda p: share == 1.0) as study:
        assert failure_cluster(study) is None
