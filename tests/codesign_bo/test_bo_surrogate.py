import numpy as np
import pytest
from codesign_bo import surrogate as module
from codesign_bo.surrogate import fit_surrogate, leave_one_out, slices
from scipy import stats


def matern(a, b, lengthscales):
    r = np.sqrt((((a[:, None] - b[None]) / lengthscales) ** 2).sum(-1))
    return (1 + np.sqrt(5) * r + 5 * r**2 / 3) * np.exp(-np.sqrt(5) * r)


class DenseGP:
    """Textbook Gaussian process with the hyperparameters of a fitted surrogate."""

    def __init__(self, s):
        self.x, self.l = s.x, s.lengthscales
        self.mu = s.shift + s.scale * s.gp.mean.constant.item()
        self.y = s.y - self.mu
        self.amplitude = s.scale**2
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


def test_hyperparameters_are_a_maximum_of_the_log_posterior(data):
    x, y, sem = data
    s = fit_surrogate(x, y, sem, seed=0)

    def log_posterior(log_l, log_noise, constant):
        z, v = (y - y.mean()) / y.std(ddof=1), (sem / y.std(ddof=1)) ** 2
        cov = matern(x, x, np.exp(log_l)) + np.diag(v + np.exp(log_noise))
        prior_l = stats.lognorm(np.sqrt(3), scale=np.exp(np.sqrt(2) + 0.5 * np.log(3)))
        prior_noise = stats.lognorm(1.0, scale=np.exp(-4))
        return (
            stats.multivariate_normal(np.full(14, constant), cov).logpdf(z)
            + prior_l.logpdf(np.exp(log_l)).sum()
            + prior_noise.logpdf(np.exp(log_noise))
        )

    at = [np.log(s.lengthscales), np.log(s.extra_noise**2 / s.scale**2), s.gp.mean.constant.item()]
    top = log_posterior(*at)
    rng = np.random.default_rng(2)
    for size in (0.02, 0.1, 0.5):
        for _ in range(50):
            step = size * rng.normal(size=5)
            assert log_posterior(at[0] + step[:3], at[1] + step[3], at[2] + step[4]) <= top + 1e-3


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
            raise RuntimeError("matrix not positive definite")
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
