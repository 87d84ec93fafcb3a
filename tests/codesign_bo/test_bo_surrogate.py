from dataclasses import replace

import numpy as np
import pytest
import torch
from codesign_bo import BoxSpace, Categorical, Continuous, Integer
from codesign_bo.models import fit as module
from codesign_bo.models.fit import LogPosterior
from codesign_bo.models.gp import MaternGP
from codesign_bo.models.priors import PRIORS, Gamma, LogNormal
from codesign_bo.models.surrogate import fit_surrogate, leave_one_out, slices
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern


def matern(a, b, lengthscales):
    r = np.sqrt((((a[:, None] - b[None]) / lengthscales) ** 2).sum(-1))
    return (1 + np.sqrt(5) * r + 5 * r**2 / 3) * np.exp(-np.sqrt(5) * r)


class DenseGP:
    """Textbook Gaussian process with the hyperparameters of a fitted surrogate."""

    def __init__(self, s):
        self.x, self.l = s.x, s.lengthscales
        self.mu = s.shift + s.scale * s.gp.mean.constant.item()
        self.y = s.y - self.mu
        self.amplitude = s.signal**2
        self.noise = np.maximum(s.sem**2, 1e-6 * s.scale**2) + s.extra_noise**2
        self.K = self.amplitude * matern(self.x, self.x, self.l) + np.diag(self.noise)

    def posterior(self, points):
        k = self.amplitude * matern(points, self.x, self.l)
        mean = self.mu + k @ np.linalg.solve(self.K, self.y)
        cov = self.amplitude * matern(points, points, self.l) - k @ np.linalg.solve(self.K, k.T)
        return mean, cov


@pytest.fixture
def data():
    rng = np.random.default_rng(0)
    x = rng.uniform(size=(14, 3))
    sem = rng.uniform(0.5, 2.0, 14)
    y = 100 + 30 * np.sin(4 * x[:, 0]) + 10 * x[:, 1] + sem * rng.normal(size=14)
    return x, y, sem


def test_posterior_agrees_with_a_dense_gaussian_process(data):
    s = fit_surrogate(*data, seed=0)
    points = np.random.default_rng(1).uniform(size=(20, 3))
    mean, cov = DenseGP(s).posterior(points)
    got_mean, got_std = s.predict(points)
    np.testing.assert_allclose(got_mean, mean, rtol=1e-6)
    np.testing.assert_allclose(got_std, np.sqrt(np.diag(cov)), rtol=1e-4)


def test_posterior_agrees_with_scikit_learn(data):
    s = fit_surrogate(*data, seed=0)
    noise = np.maximum(s.sem**2, 1e-6 * s.scale**2) + s.extra_noise**2
    mu = s.shift + s.scale * s.gp.mean.constant.item()
    kernel = ConstantKernel(s.signal**2) * Matern(s.lengthscales, nu=2.5)
    peer = GaussianProcessRegressor(kernel, alpha=noise, optimizer=None).fit(s.x, s.y - mu)
    points = np.random.default_rng(1).uniform(size=(20, 3))
    mean, std = peer.predict(points, return_std=True)
    np.testing.assert_allclose(s.predict(points)[0], mu + mean, rtol=1e-6)
    np.testing.assert_allclose(s.predict(points)[1], std, rtol=1e-4)
    _, cov = peer.predict(points, return_cov=True)
    np.testing.assert_allclose(s.joint(points)[1], cov, rtol=1e-4, atol=1e-7 * cov.max())


def test_gpytorch_sees_the_same_model(data):
    s = fit_surrogate(*data, seed=0)
    points = np.random.default_rng(1).uniform(size=(5, 3))
    with torch.no_grad():
        there = s.gp(torch.as_tensor(points))
    np.testing.assert_allclose(s.predict(points)[0], s.shift + s.scale * there.mean.numpy(), rtol=1e-6)
    np.testing.assert_allclose(s.predict(points)[1], s.scale * there.stddev.numpy(), rtol=1e-4)


def test_hyperparameters_are_a_maximum_of_the_log_posterior(data):
    x, y, sem = data
    priors = replace(PRIORS, variance=LogNormal(0.0, 0.5))
    s = fit_surrogate(x, y, sem, seed=0, priors=priors)

    def log_posterior(log_l, log_noise, log_variance, constant):
        z, v = (y - y.mean()) / y.std(ddof=1), (sem / y.std(ddof=1)) ** 2
        cov = np.exp(log_variance) * matern(x, x, np.exp(log_l)) + np.diag(v + np.exp(log_noise))
        return (
            stats.multivariate_normal(np.full(14, constant), cov).logpdf(z)
            + log_density(PRIORS.lengthscale, np.exp(log_l)).sum()
            + log_density(PRIORS.extra_variance, np.exp(log_noise)).sum()
            + log_density(priors.variance, np.exp(log_variance)).sum()
        )

    at = np.log([*s.lengthscales, (s.extra_noise / s.scale) ** 2, (s.signal / s.scale) ** 2, 1.0])
    at[5] = s.gp.mean.constant.item()
    top = log_posterior(at[:3], *at[3:])
    rng = np.random.default_rng(2)
    for size in (0.02, 0.1, 0.5):
        for _ in range(50):
            moved = at + size * rng.normal(size=6)
            assert log_posterior(moved[:3], *moved[3:]) <= top + 1e-3


def log_density(prior, values):
    """The priors by scipy."""
    if isinstance(prior, Gamma):
        return stats.gamma(prior.shape, scale=1 / prior.rate).logpdf(values)
    return stats.lognorm(prior.scale, scale=np.exp(prior.location)).logpdf(values)


@pytest.mark.parametrize("prior", [Gamma(3.0, 6.0), Gamma(1.1, 30.0), LogNormal(0.3, 0.5)])
def test_priors_agree_with_scipy(prior):
    log = np.array([-3.0, 0.1, 1.2])
    value, slope = prior.log_density(log)
    np.testing.assert_allclose(value, log_density(prior, np.exp(log)))
    rise = log_density(prior, np.exp(log + 1e-6)) - log_density(prior, np.exp(log - 1e-6))
    np.testing.assert_allclose(slope, rise / 2e-6, rtol=1e-6)


@settings(max_examples=25)
@given(st.integers(0, 10_000), st.booleans())
def test_the_likelihood_and_its_gradient_agree_with_scipy_and_differences(seed, with_trend):
    rng = np.random.default_rng(seed)
    x, y, sem = rng.uniform(size=(6, 2)), rng.normal(size=6), rng.uniform(0.1, 0.5, 6)
    follow = torch.as_tensor(rng.normal(size=2))
    features = torch.as_tensor(x)
    trend = (lambda at: at @ follow) if with_trend else None
    gp = MaternGP(features, torch.as_tensor(y), torch.as_tensor(sem**2), [0, 1], trend)
    priors = replace(PRIORS, variance=LogNormal(0.0, 0.5))
    posterior = LogPosterior(gp, priors)
    at = posterior.random(rng)
    at[4:] = rng.normal(size=len(at) - 4)

    def truth(at):
        length, variance, extra = np.exp(at[:2]), np.exp(at[2]), np.exp(at[3])
        mean = np.full(6, at[4]) + (at[5] * (x @ follow.numpy()) if with_trend else 0.0)
        cov = variance * matern(x, x, length) + np.diag(sem**2 + extra)
        prior = log_density(PRIORS.lengthscale, length).sum() + log_density(priors.variance, variance)
        prior += log_density(PRIORS.extra_variance, extra)
        if with_trend:
            prior += stats.norm(0, PRIORS.weight).logpdf(at[5]) - stats.norm(0, PRIORS.weight).logpdf(0)
        return stats.multivariate_normal(mean, cov).logpdf(y) + prior

    value, gradient = posterior(at)
    assert value == pytest.approx(truth(at), rel=1e-8)
    rises = [(truth(at + step) - truth(at - step)) / 2e-5 for step in 1e-5 * np.eye(len(at))]
    np.testing.assert_allclose(gradient, rises, rtol=1e-4, atol=1e-5)


def test_learns_the_noise_that_standard_errors_leave_out():
    rng = np.random.default_rng(5)
    x = rng.uniform(size=(40, 2))
    y = 3 * x[:, 0] + 0.4 * rng.normal(size=40)
    told = fit_surrogate(x, y, np.full(40, 0.05), seed=0)
    assert 0.25 < told.extra_noise < 0.6
    honest = fit_surrogate(x, y, np.full(40, 0.4), seed=0)
    assert honest.extra_noise < 0.6 * told.extra_noise


def test_units_of_the_objective_do_not_matter(data):
    x, y, sem = data
    a, b = fit_surrogate(x, y, sem, 0), fit_surrogate(x, 1e6 * y - 5e8, 1e6 * sem, 0)
    np.testing.assert_allclose(b.lengthscales, a.lengthscales, rtol=1e-4)
    np.testing.assert_allclose((b.predict(x)[0] + 5e8) / 1e6, a.predict(x)[0], rtol=1e-5)


def test_leave_one_out_agrees_with_leaving_each_one_out(data):
    s = fit_surrogate(*data, seed=0)
    report, dense = leave_one_out(s), DenseGP(s)
    for i in range(len(s.y)):
        rest = np.arange(len(s.y)) != i
        k = dense.K[i, rest]
        solve = np.linalg.solve(dense.K[np.ix_(rest, rest)], np.c_[dense.y[rest], k])
        assert report.mean[i] == pytest.approx(dense.mu + k @ solve[:, 0], rel=1e-6)
        assert report.std[i] == pytest.approx(np.sqrt(dense.K[i, i] - k @ solve[:, 1]), rel=1e-5)
    assert 0.5 < report.r2 < 1.0
    assert report.coverage > 0.7


def test_slices_lie_on_the_posterior_and_pass_through_the_point(data):
    s = fit_surrogate(*data, seed=0)
    point = np.array([0.5, 0.25, 0.75])
    positions, mean, std = slices(s, point, 5)
    np.testing.assert_array_equal(positions, [0, 0.25, 0.5, 0.75, 1])
    centre = s.predict(point[None])
    for axis, at in enumerate([2, 1, 3]):
        assert mean[axis, at] == pytest.approx(centre[0][0])
        assert std[axis, at] == pytest.approx(centre[1][0])
    corner = s.predict(np.array([[0.0, 0.25, 0.75]]))
    assert mean[0, 0] == pytest.approx(corner[0][0])


@pytest.mark.parametrize(("failures", "fit"), [(3, "map"), (99, "prior")])
def test_fit_falls_back_step_by_step(data, monkeypatch, failures, fit):
    real, calls = module.minimize, []

    def flaky(*args, **kwargs):
        calls.append(1)
        if len(calls) <= failures:
            raise ValueError("not a number")
        return real(*args, **kwargs)

    monkeypatch.setattr(module, "minimize", flaky)
    s = fit_surrogate(*data, seed=0)
    assert s.fit == fit
    assert np.isfinite(s.predict(data[0])).all()


@pytest.mark.parametrize("y", [[1.0], [2.0, 2.0, 2.0], [0.0, 1e-300, 0.0], [1e12, 1e12 + 1, 1e12 - 1]])
def test_degenerate_outcomes_are_survived(y):
    x = np.random.default_rng(0).uniform(size=(len(y), 2))
    s = fit_surrogate(x, np.array(y), np.full(len(y), np.nan), 0)
    assert np.isfinite(s.predict(x)).all()


def test_repeated_points_are_survived():
    x = np.tile([[0.3, 0.7]], (6, 1))
    s = fit_surrogate(x, np.arange(6.0), np.zeros(6), 0)
    assert s.predict(x)[0][0] == pytest.approx(2.5, abs=0.2)


def test_replicates_count_as_one_observation_merged_by_inverse_variance(data):
    x, y, sem = data
    x, y, sem = (
        np.concatenate([x, x[:3], x[:1]]),
        np.concatenate([y, y[:3] + 5, y[:1] - 2]),
        np.concatenate([sem, sem[:4]]),
    )
    s = fit_surrogate(x, y, sem, seed=0)
    weight = 1 / (np.maximum(sem**2, 1e-6 * s.scale**2) + s.extra_noise**2)
    unique = x[:14]
    same = [np.flatnonzero((x == u).all(axis=1)) for u in unique]
    total = np.array([weight[i].sum() for i in same])
    merged = np.array([(weight[i] * y[i]).sum() for i in same]) / total
    mu = s.shift + s.scale * s.gp.mean.constant.item()
    kernel = ConstantKernel(s.signal**2) * Matern(s.lengthscales, nu=2.5)
    peer = GaussianProcessRegressor(kernel, alpha=1 / total, optimizer=None).fit(unique, merged - mu)
    points = np.random.default_rng(1).uniform(size=(20, 3))
    mean, std = peer.predict(points, return_std=True)
    np.testing.assert_allclose(s.predict(points)[0], mu + mean, rtol=1e-6)
    np.testing.assert_allclose(s.predict(points)[1], std, rtol=1e-4)


def test_the_spread_of_replicates_tells_the_extra_noise():
    rng = np.random.default_rng(0)
    x = np.repeat(rng.uniform(size=(6, 2)), 5, axis=0)
    y = 3 * x[:, 0] + 0.3 * rng.normal(size=30)
    assert fit_surrogate(x, y, np.zeros(30), 0).extra_noise == pytest.approx(0.3, rel=0.35)


MIXED = BoxSpace(
    (
        Continuous("a", 0, 1, 0.5),
        Integer("b", 1, 3, 2),
        Categorical("c", ("x", "y", "z"), "x"),
        Categorical("d", ("fixed",), "fixed", fixed=True),
    )
)


def test_a_mixed_space_is_modelled_on_its_features():
    rng = np.random.default_rng(4)
    x = rng.uniform(size=(30, 3))
    designs = MIXED.from_unit(x)
    y = np.sin(3 * designs[:, 0]) + designs[:, 1] + np.array([0.0, 2.0, -1.0])[designs[:, 2].astype(int)]
    s = fit_surrogate(x, y, np.full(30, 0.01), 0, MIXED)
    assert s.lengthscales.shape == (3,)
    features = MIXED.features(x)[:, :5] / s.lengthscales[[0, 1, 2, 2, 2]]
    mu = s.shift + s.scale * s.gp.mean.constant.item()
    noise = np.maximum(s.sem**2, 1e-6 * s.scale**2) + s.extra_noise**2
    kernel = ConstantKernel(s.signal**2) * Matern(1.0, nu=2.5)
    peer = GaussianProcessRegressor(kernel, alpha=noise, optimizer=None).fit(features, y - mu)
    points = rng.uniform(size=(20, 3))
    mean = mu + peer.predict(MIXED.features(points) / s.lengthscales[[0, 1, 2, 2, 2]])
    np.testing.assert_allclose(s.predict(points)[0], mean, rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(s.predict(MIXED.snap(points))[0], s.predict(points)[0])  # one value per bin
    assert leave_one_out(s).r2 > 0.8


def test_log_density_of_leave_one_out_is_that_of_normals(data):
    report = leave_one_out(fit_surrogate(*data, seed=0))
    np.testing.assert_allclose(report.log_density, stats.norm(report.mean, report.std).logpdf(report.y))


def test_the_variance_is_held_unless_it_has_a_prior(data):
    x, y, sem = data
    assert fit_surrogate(x, y, sem, 0).hyperparameters.variance == 1.0
    learnt = fit_surrogate(x, y, sem, 0, priors=replace(PRIORS, variance=LogNormal(0.0, 0.5)))
    assert learnt.hyperparameters.variance != 1.0


def test_same_data_and_seed_give_the_same_surrogate(data):
    a, b = fit_surrogate(*data, seed=3), fit_surrogate(*data, seed=3)
    np.testing.assert_array_equal(a.lengthscales, b.lengthscales)
    assert (a.extra_noise, a.signal) == (b.extra_noise, b.signal)
