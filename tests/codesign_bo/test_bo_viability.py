"""The probability that a design can be evaluated."""

import numpy as np
import pytest
import torch
from codesign_bo import BoxSpace, Categorical, Continuous, EvalResult, Study
from codesign_bo.data import Viability
from codesign_bo.models.features import Features
from codesign_bo.models.viability import THRESHOLD, covariance, fit_viability
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, stats
from scipy.special import expit
from sklearn.gaussian_process import GaussianProcessClassifier
from sklearn.gaussian_process.kernels import ConstantKernel, Matern

SPACE = BoxSpace.box(["a", "b"], 0, 1, 0.2)


def sample(n=25, seed=0):
    x = np.random.default_rng(seed).uniform(size=(n, 2))
    return Viability(x, x.sum(axis=1) < 1.2)


def peer(model, data):
    kernel = ConstantKernel(4.0) + ConstantKernel(model.variance) * Matern(model.lengthscale, nu=2.5)
    return GaussianProcessClassifier(kernel, optimizer=None, max_iter_predict=1000).fit(data.x, data.viable)


def test_it_agrees_with_scikit_learn():
    data = sample()
    model = fit_viability(SPACE, data)
    other = peer(model, data)
    points = np.random.default_rng(1).uniform(size=(50, 2))
    np.testing.assert_allclose(model.probability(points), other.predict_proba(points)[:, 1], atol=0.01)
    assert model.evidence == pytest.approx(other.log_marginal_likelihood(other.kernel_.theta), abs=1e-4)


def test_its_hyperparameters_have_the_highest_evidence_of_the_grid():
    data = sample()
    model = fit_viability(SPACE, data)
    for lengthscale in (0.2, 0.4, 1.6):
        for variance in (1.0, 16.0):
            kernel = ConstantKernel(4.0) + ConstantKernel(variance) * Matern(lengthscale, nu=2.5)
            other = GaussianProcessClassifier(kernel, optimizer=None, max_iter_predict=1000).fit(data.x, data.viable)
            assert other.log_marginal_likelihood(other.kernel_.theta) <= model.evidence + 1e-4


def test_the_mean_of_the_logistic_function_is_close_to_its_integral():
    data = sample()
    model = fit_viability(SPACE, data)
    points = np.random.default_rng(1).uniform(size=(10, 2))
    x = torch.as_tensor(points)
    cross = covariance(model.x, x, model.lengthscale, model.variance)
    gram = covariance(model.x, model.x, model.lengthscale, model.variance).numpy()
    mean = (model.slope @ cross).numpy()
    inner = np.linalg.inv(gram + np.diag(1 / model.weight.numpy() ** 2))
    for i in range(10):
        k = cross[:, i].numpy()
        std = np.sqrt(model.variance + 4.0 - k @ inner @ k)
        exact, _ = integrate.quad(
            lambda f, i=i, std=std: expit(f) * stats.norm.pdf(f, mean[i], std), -40, 40, limit=200
        )
        assert model.probability(points[[i]])[0] == pytest.approx(exact, abs=0.02)


def test_there_is_no_model_as_long_as_nothing_failed():
    assert (
        fit_viability(SPACE, Viability(np.random.default_rng(0).uniform(size=(5, 2)), np.ones(5, dtype=bool))) is None
    )
    assert fit_viability(SPACE, Viability(np.empty((0, 2)), np.ones(0, dtype=bool))) is None


def test_one_failure_casts_doubt_around_it_more_than_afar():
    x = np.array([[0.1, 0.1], [0.2, 0.3], [0.5, 0.2], [0.3, 0.6], [0.9, 0.9]])
    model = fit_viability(SPACE, Viability(x, np.array([True] * 4 + [False])))
    near, far = model.probability(np.array([[0.9, 0.9], [0.3, 0.3]]))
    assert near < far
    assert far > 0.5


def test_kinds_of_parameters_are_told_apart():
    space = BoxSpace((Continuous("a", 0, 1, 0.5), Categorical("c", ("good", "bad"), "good")))
    x = np.random.default_rng(0).uniform(size=(16, 2))
    model = fit_viability(space, Viability(x, x[:, 1] < 0.5))
    good, bad = model.probability(np.array([[0.5, 0.25], [0.5, 0.75]]))
    assert good > 0.75
    assert bad < 0.25
    assert Features(space)(torch.as_tensor(x)).shape == (16, 3)


@settings(max_examples=15)
@given(st.integers(1, 12), st.integers(0, 2**31 - 1), st.data())
def test_any_history_gives_probabilities(n, seed, data):
    x = np.random.default_rng(seed).uniform(size=(n, 2)).round(1)  # repeats, also contradictory ones
    viable = np.array(data.draw(st.lists(st.booleans(), min_size=n, max_size=n)))
    model = fit_viability(SPACE, Viability(x, viable))
    if viable.all():
        assert model is None
        return
    chances = model.probability(np.random.default_rng(0).uniform(size=(20, 2)))
    assert ((chances > 0) & (chances < 1)).all()
    # swapping what failed and what did not mirrors the probabilities
    if viable.any():
        mirrored = fit_viability(SPACE, Viability(x, ~viable))
        points = np.random.default_rng(0).uniform(size=(20, 2))
        np.testing.assert_allclose(mirrored.probability(points), 1 - model.probability(points), atol=1e-5)


@settings(max_examples=20)
@given(st.lists(st.floats(0.01, 0.99), min_size=2, max_size=2))
def test_gradients_agree_with_differences(point):
    model = fit_viability(SPACE, sample())
    at = torch.tensor([point], dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(model.log_probability(at).sum(), at)
    steps = 1e-6 * np.eye(2)
    rise = np.log(model.probability(np.array(point) + steps)) - np.log(model.probability(np.array(point) - steps))
    np.testing.assert_allclose(gradient[0].numpy(), rise / 2e-6, rtol=1e-3, atol=1e-4)


def test_a_study_stays_near_what_is_viable(tmp_path):
    """The objective pulls into a corner that crashes, up to a + b = 2; its viable edge is at a + b = 1.1."""
    space = BoxSpace.box(["a", "b"], 0, 1, 0.2)
    sums = []
    with Study(space, tmp_path / "study.sqlite", seed=3, n_init=6) as study:
        for _ in range(20):
            (request,) = study.ask()
            sums.append(request.params["a"] + request.params["b"])
            failure = EvalResult.failure("crash", "fell")
            study.tell(request.trial, failure if sums[-1] > 1.1 else EvalResult(sums[-1], sem=0.02))
        best = study.best()
        model = study.viability_model()
    assert max(sums[12:]) < 1.5
    assert sum(total > 1.1 for total in sums[6:]) <= 9  # the best viable designs lie right beside those that fail
    assert 1.0 < best.params["a"] + best.params["b"] <= 1.1
    assert model is not None
    assert model.probability(np.array([[0.9, 0.9]]))[0] < THRESHOLD < model.probability(np.array([[0.2, 0.2]]))[0]


def test_lost_evaluations_say_nothing_of_their_designs(tmp_path):
    with Study(SPACE, tmp_path / "study.sqlite", retries=0) as study:
        (request,) = study.ask()
        study.tell(request.trial, EvalResult.failure("lost", "the machine went away"))
        assert study.viability_model() is None
