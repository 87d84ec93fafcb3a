"""The recommendation and its gain over the nominal design."""

import math

import numpy as np
import pytest
from codesign_bo import BoxSpace, EvalResult, Study
from codesign_bo.confirm import analyse
from codesign_bo.models.surrogate import fit_surrogate
from codesign_bo.recommend import posterior_gain
from codesign_bo.records import ConfirmationRecord
from scipy import stats

SPACE = BoxSpace.box(["a"], 0.0, 1.0, 0.5)
BEST = {"a": 0.8}


def dense_posterior(surrogate, points):
    """Mean and covariance of the noise-free function at `points`, by the textbook formulas in numpy."""

    def matern(p, q):
        r = np.sqrt((((p[:, None] - q[None]) / surrogate.lengthscales) ** 2).sum(-1)) * math.sqrt(5)
        return (surrogate.signal / surrogate.scale) ** 2 * (1 + r + r**2 / 3) * np.exp(-r)

    y = (surrogate.y - surrogate.shift) / surrogate.scale
    known = np.maximum((surrogate.sem / surrogate.scale) ** 2, 1e-6)
    noise = np.diag(known + (surrogate.extra_noise / surrogate.scale) ** 2)
    gram = np.linalg.inv(matern(surrogate.x, surrogate.x) + noise)
    cross = matern(points, surrogate.x)
    constant = surrogate.gp.mean.constant.item()
    mean = constant + cross @ gram @ (y - constant)
    covariance = matern(points, points) - cross @ gram @ cross.T
    return surrogate.shift + surrogate.scale * mean, surrogate.scale**2 * covariance


def test_the_gain_by_the_posterior_is_that_of_two_correlated_normals():
    rng = np.random.default_rng(0)
    x = rng.uniform(size=(9, 2))
    surrogate = fit_surrogate(x, 10 * np.sin(4 * x[:, 0]) + rng.normal(size=9), np.full(9, 0.5), seed=1)
    point, base = np.array([0.4, 0.5]), np.array([0.55, 0.5])
    mean, covariance = dense_posterior(surrogate, np.stack([point, base]))
    gain = mean[0] - mean[1]
    std = math.sqrt(covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1])
    found = posterior_gain(surrogate, point, base, maximize=True, level=0.9)
    half = 1.6448536 * std
    assert found == pytest.approx((gain, gain - half, gain + half, stats.norm.sf(0, gain, std)), rel=1e-4)
    assert std < 0.9 * math.sqrt(covariance[0, 0] + covariance[1, 1])  # the correlation matters
    down = posterior_gain(surrogate, point, base, maximize=False, level=0.9)
    assert down == pytest.approx((-gain, -gain - half, -gain + half, stats.norm.cdf(0, gain, std)), rel=1e-4)


def test_the_probability_after_confirmation_is_students():
    nominal, best = [1.0, 2.5, 2.0, 4.0], [1.6, 2.9, 3.1, 4.2]
    records = [
        ConfirmationRecord(t, r, r, EvalResult(v)) for t, row in ((0, nominal), (3, best)) for r, v in enumerate(row)
    ]
    params = {0: {"a": 0.5}, 3: BEST}
    one_sided = stats.ttest_rel(best, nominal, alternative="greater").pvalue
    assert analyse(records, params).best.probability == pytest.approx(1 - one_sided)
    assert analyse(records, params, maximize=False).best.probability == pytest.approx(one_sided)
    single = [r for r in records if r.repeat == 0]
    assert math.isnan(analyse(single, params).best.probability)  # one seed says nothing of the noise
    same = [ConfirmationRecord(t, r, r, EvalResult(1.0 + t)) for t in (0, 3) for r in range(3)]
    assert analyse(same, params).best.probability == 1.0


@pytest.fixture
def study(tmp_path):
    with Study(SPACE, tmp_path / "s.sqlite", n_init=100) as study:
        study.enqueue([BEST, {"a": 0.2}, {"a": 0.65}])
        yield study


def rising(request):
    return EvalResult(request.params["a"] + 1e-3 * (request.seed % 7), 0.01, 4)


def test_before_confirmation_the_posterior_speaks(study):
    study.run(rising, until=4)
    found = study.recommend(level=0.9)
    assert (found.trial, dict(found.params), found.source, found.level) == (1, BEST, "posterior", 0.9)
    assert found.low < found.gain < found.high
    assert found.gain == pytest.approx(0.3, abs=0.05)
    assert found.probability > 0.99
    assert "a=0.8" in found.sentence()
    assert f"better with probability {found.probability:.1%}" in found.sentence()


def test_after_confirmation_the_fresh_seeds_do(study):
    study.run(rising, until=4)
    best = study.confirm(rising, top_k=2, repeats=3).best
    found = study.recommend()
    assert (found.source, found.trial) == ("confirmation", best.trial)
    assert (found.gain, found.low, found.high) == (best.gain, best.low, best.high)
    assert found.probability == best.probability > 0.95


def test_a_single_fresh_seed_decides_nothing(study):
    study.run(rising, until=4)
    believed = study.recommend()
    study.confirm(rising, top_k=1, repeats=1)
    assert study.recommend() == believed
    assert believed.source == "posterior"


def test_where_nothing_is_better_the_nominal_design_is_recommended(tmp_path):
    def peak(request):
        return EvalResult(-abs(request.params["a"] - 0.5), 0.01, 4)

    with Study(SPACE, tmp_path / "s.sqlite", n_init=100) as study:
        study.enqueue([{"a": 0.1}, {"a": 0.9}])
        study.run(peak, until=3)
        for source in ("posterior", "confirmation"):
            found = study.recommend()
            assert (found.trial, dict(found.params), found.gain, found.source) == (0, {"a": 0.5}, 0.0, source)
            assert "no other is expected to be better" in found.sentence()
            study.confirm(peak, top_k=1, repeats=2)
