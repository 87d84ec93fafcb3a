"""Noisy expected improvement, of a value and of a hypervolume."""

from types import SimpleNamespace

import mpmath
import numpy as np
import pytest
import torch
from botorch.acquisition.logei import qLogNoisyExpectedImprovement
from botorch.acquisition.multi_objective.analytic import ExpectedHypervolumeImprovement
from botorch.acquisition.objective import GenericMCObjective
from botorch.models.gpytorch import GPyTorchModel
from botorch.models.model import Model
from botorch.sampling.normal import SobolQMCNormalSampler
from botorch.utils.multi_objective.box_decompositions.non_dominated import NondominatedPartitioning
from codesign_bo.acquisition.functions import Objective, log_ei, noisy_log_ehvi, noisy_log_ei
from codesign_bo.acquisition.pareto import hypervolume
from codesign_bo.models.gp import Hyperparameters
from codesign_bo.models.surrogate import fit_surrogate
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

NONE = np.empty((0, 2))


class View(GPyTorchModel):
    """Lets BoTorch see a surrogate's model."""

    num_outputs = 1
    batch_shape = torch.Size()

    def __init__(self, surrogate):
        super().__init__()
        self.gp, self.likelihood = surrogate.gp, surrogate.gp.noise

    def forward(self, x):
        return self.gp.posterior(x)


@pytest.fixture
def fitted():
    rng = np.random.default_rng(3)
    x = rng.uniform(size=(10, 2))
    y = -np.sum((x - 0.6) ** 2, axis=1) + 0.1 * rng.normal(size=10)
    return fit_surrogate(x, y, np.full(10, 0.1), 0)


@pytest.fixture
def exact():
    """Observed without noise, so that the best value so far is known."""
    x = np.random.default_rng(5).uniform(size=(8, 2))
    s = fit_surrogate(x, np.sin(5 * x[:, 0]) + x[:, 1], np.zeros(8), 0)
    s.gp.hold(Hyperparameters(np.array([0.4, 0.8]), 1.0, 1e-9))
    return s


def values(acquisition, points):
    with torch.no_grad():
        return acquisition(torch.as_tensor(points)).numpy()


@given(st.floats(-1e8, 30.0))
def test_log_ei_agrees_with_high_precision(u):
    with mpmath.workdps(60):
        density = mpmath.exp(-(mpmath.mpf(u) ** 2) / 2) / mpmath.sqrt(2 * mpmath.pi)
        truth = mpmath.log(density + u * mpmath.erfc(-mpmath.mpf(u) / mpmath.sqrt(2)) / 2) if u > -100 else None
        if truth is None:  # the leading terms of the asymptotic series
            truth = -(mpmath.mpf(u) ** 2) / 2 - mpmath.log(2 * mpmath.pi) / 2 + mpmath.log(1 / mpmath.mpf(u) ** 2)
    got = log_ei(torch.tensor(u, dtype=torch.float64)).item()
    assert got == pytest.approx(float(truth), rel=1e-6, abs=1e-9)


@given(st.floats(-1e7, 30.0))
def test_log_ei_has_a_gradient_everywhere(u):
    at = torch.tensor(u, dtype=torch.float64, requires_grad=True)
    log_ei(at).backward()
    # d/du log h(u) = Phi(u) / h(u), which is close to -u far in the tail
    assert at.grad.item() > 0
    if u < -1e3:
        assert at.grad.item() == pytest.approx(-u, rel=1e-2)


@pytest.mark.parametrize("maximize", [True, False])
def test_noisy_ei_agrees_with_plain_monte_carlo(fitted, maximize):
    candidates = np.random.default_rng(7).uniform(size=(12, 2))
    mean, cov = fitted.joint(np.concatenate([candidates, fitted.x]))
    sign = 1 if maximize else -1
    draws = sign * np.random.default_rng(0).multivariate_normal(mean, cov, size=200_000)
    best = draws[:, 12:].max(axis=1, keepdims=True)
    truth = np.maximum(draws[:, :12] - best, 0).mean(axis=0) / fitted.scale
    got = np.exp(values(noisy_log_ei(Objective(fitted, maximize), NONE, 0, draws=1024), candidates))
    worth = truth > 0.1 * truth.max()
    assert worth.sum() >= 2
    np.testing.assert_allclose(got[worth], truth[worth], rtol=0.05)


def test_noisy_ei_agrees_with_botorch_also_with_pending_points(fitted):
    candidates = np.random.default_rng(7).uniform(size=(12, 2))
    pending = np.array([[0.55, 0.6], [0.7, 0.4]])
    peer = qLogNoisyExpectedImprovement(
        model=View(fitted),
        X_baseline=torch.as_tensor(fitted.x),
        sampler=SobolQMCNormalSampler(torch.Size([4096]), seed=1),
        objective=GenericMCObjective(lambda samples, X=None: samples[..., 0]),
        X_pending=torch.as_tensor(pending),
        prune_baseline=False,
    )
    with torch.no_grad():
        truth = peer(torch.as_tensor(candidates)[:, None]).numpy()
    got = values(noisy_log_ei(Objective(fitted), pending, 0, draws=1024), candidates)
    worth = truth > truth.max() - 3
    assert worth.sum() >= 3
    np.testing.assert_allclose(got[worth], truth[worth], atol=0.12)


def test_without_noise_it_is_expected_improvement(exact):
    candidates = np.random.default_rng(7).uniform(size=(200, 2))
    mean, std = exact.predict(candidates)
    u = (mean - exact.y.max()) / std
    truth = std * (stats.norm.pdf(u) + u * stats.norm.cdf(u)) / exact.scale
    got = np.exp(values(noisy_log_ei(Objective(exact), NONE, 0), candidates))
    worth = truth > 1e-2 * truth.max()
    assert worth.sum() >= 3
    np.testing.assert_allclose(got[worth], truth[worth], rtol=0.03)


@settings(max_examples=15)
@given(st.lists(st.floats(0.05, 0.95), min_size=2, max_size=2), st.integers(0, 3))
def test_gradients_agree_with_differences(point, seed):
    rng = np.random.default_rng(3)
    x = rng.uniform(size=(6, 2))
    both = [Objective(fit_surrogate(x, rng.normal(size=6), np.full(6, 0.2), seed), way) for way in (True, False)]
    reference = np.array([-2.0, 2.0])
    for acquisition in (
        noisy_log_ei(both[0], np.array([[0.5, 0.5]]), seed, 16),
        noisy_log_ehvi(both, reference, NONE, seed, 8),
    ):
        at = torch.tensor([point], dtype=torch.float64, requires_grad=True)
        (gradient,) = torch.autograd.grad(acquisition(at).sum(), at)
        steps = 1e-6 * np.eye(2)
        rise = values(acquisition, np.array(point) + steps) - values(acquisition, np.array(point) - steps)
        np.testing.assert_allclose(gradient[0].numpy(), rise / 2e-6, rtol=2e-3, atol=2e-3)


def test_a_pending_point_takes_the_interest_out_of_its_place(fitted):
    points = np.random.default_rng(0).uniform(size=(400, 2))
    free = noisy_log_ei(Objective(fitted), NONE, 0)
    first = points[np.argmax(values(free, points))]
    taken = noisy_log_ei(Objective(fitted), first[None], 0)
    near = np.clip(first[None] + 1e-3, 0, 1)
    assert values(taken, near)[0] < values(free, near)[0] - 1.0
    second = points[np.argmax(values(taken, points))]
    assert np.abs(second - first).max() > 0.01


def two_objectives(noise):
    x = np.random.default_rng(2).uniform(size=(7, 2))
    rewards = fit_surrogate(x, 3 * x[:, 0] + noise * x[:, 1], np.full(7, noise), 0)
    energy = fit_surrogate(x, 100 * (x[:, 0] ** 2 + x[:, 1]), np.full(7, 100 * noise), 0)
    return Objective(rewards, True), Objective(energy, False)


class Marginals(Model):
    """Lets BoTorch see two surrogates' means and variances, more being better."""

    num_outputs = 2
    batch_shape = torch.Size()

    def __init__(self, objectives):
        super().__init__()
        self.objectives = objectives

    def posterior(self, X, **options):
        found = [o.surrogate.predict(X.squeeze(-2).numpy()) for o in self.objectives]
        mean = np.column_stack([o.sign * m for o, (m, _) in zip(self.objectives, found, strict=True)])
        std = np.column_stack([s for _, s in found])
        return SimpleNamespace(mean=torch.as_tensor(mean)[:, None], variance=torch.as_tensor(std**2)[:, None])


def test_hypervolume_improvement_agrees_with_botorch_without_noise():
    objectives = two_objectives(0.0)
    reference, sign = np.array([0.2, 150.0]), np.array([1.0, -1.0])
    candidates = np.random.default_rng(7).uniform(size=(20, 2))
    observed = sign * np.column_stack([o.surrogate.y for o in objectives])
    floor = torch.as_tensor(sign * reference)
    cells = NondominatedPartitioning(ref_point=floor, Y=torch.as_tensor(observed))
    peer = ExpectedHypervolumeImprovement(Marginals(objectives), floor.tolist(), cells)
    truth = peer(torch.as_tensor(candidates)[:, None]).numpy()
    unit = objectives[0].surrogate.scale * objectives[1].surrogate.scale
    got = np.exp(values(noisy_log_ehvi(objectives, reference, NONE, 0), candidates)) * unit
    worth = truth > 0.02 * truth.max()
    assert worth.sum() >= 3
    np.testing.assert_allclose(got[worth], truth[worth], rtol=0.1)


@pytest.mark.parametrize("pending", [NONE, np.array([[0.1, 0.1]])])
def test_noisy_hypervolume_improvement_agrees_with_plain_monte_carlo(pending):
    objectives = two_objectives(0.3)
    reference = np.array([-0.5, 220.0])
    candidates = np.random.default_rng(7).uniform(size=(5, 2))
    rng, k = np.random.default_rng(0), 7 + len(pending)
    draws = []
    for o in objectives:
        mean, cov = o.surrogate.joint(np.concatenate([o.surrogate.x, pending, candidates]))
        draws.append(o.sign * rng.multivariate_normal(mean, cov, size=1500))
    both, floor = np.stack(draws, axis=-1), np.array([1.0, -1.0]) * reference
    before = np.array([hypervolume(d[:k], floor) for d in both])
    got = np.exp(values(noisy_log_ehvi(objectives, reference, pending, 0, draws=256), candidates))
    got *= objectives[0].surrogate.scale * objectives[1].surrogate.scale
    for i in range(5):
        gains = [hypervolume(np.concatenate([d[:k], d[k + i : k + i + 1]]), floor) for d in both] - before
        error = gains.std() / np.sqrt(len(gains))
        assert got[i] == pytest.approx(gains.mean(), abs=4 * error + 0.06 * gains.mean())


def test_nothing_is_compiled_for_several_objectives(monkeypatch):
    from torch.utils import cpp_extension

    def refuse(*args, **kwargs):
        raise AssertionError("a compiler was called")

    monkeypatch.setattr(cpp_extension, "load", refuse)
    monkeypatch.setattr(cpp_extension, "load_inline", refuse)
    acquisition = noisy_log_ehvi(two_objectives(0.3), np.array([-0.5, 220.0]), NONE, 0)
    assert np.isfinite(values(acquisition, np.array([[0.5, 0.5]]))).all()


def test_far_from_any_hope_it_is_still_finite(exact):
    points = np.random.default_rng(0).uniform(size=(200, 2))
    hopeless = fit_surrogate(np.concatenate([exact.x, [[0.5, 0.5]]]), np.append(exact.y, 1e4), np.zeros(9), 0)
    assert np.isfinite(values(noisy_log_ei(Objective(hopeless), NONE, 0), points)).all()
