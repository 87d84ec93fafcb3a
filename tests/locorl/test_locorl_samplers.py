"""Morphology samplers: who gets which body, and when it changes."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from locorl.bodies.designs import sobol_designs
from locorl.bodies.samplers import FixedSampler, MorphologyConfig, MorphologySampler, make_sampler
from locorl.config import from_dict, to_dict
from locorl_box import Space

KINDS = ("spatial", "temporal", "none", "grid", "sobol", "adaptive")
GRID = set(itertools.product((0.6, 1.0, 1.4), repeat=4))


class Points:
    """A factory whose bodies are their designs; `stands` says which of them have a stance."""

    name = "points"
    space = Space()

    def __init__(self, stands: Callable[[np.ndarray], np.ndarray] = lambda x: np.full(len(x), True)) -> None:
        self.stands = stands

    def batch(self, designs: np.ndarray, scene: object = None) -> SimpleNamespace:
        return SimpleNamespace(designs=designs, feasible=self.stands(designs))


def sampler(kind: str, n: int, iterations: int = 100, seed: int = 3, factory=None, **options) -> MorphologySampler:
    return make_sampler(MorphologyConfig(kind=kind, **options), factory or Points(), n, iterations, seed)  # pyright: ignore


def rows(designs: np.ndarray) -> list[tuple[float, ...]]:
    return [tuple(row) for row in designs.round(9).tolist()]


def unit(designs: np.ndarray) -> np.ndarray:
    return (designs - 0.6) / 0.8


def assert_uniform(designs: np.ndarray) -> None:
    """Chi-square of each parameter in 8 bins, and correlation of each pair; each fails once in 1000 good draws."""
    n = len(designs)
    for column in unit(designs).T:
        counts, _ = np.histogram(column, bins=8, range=(0, 1))
        assert counts.sum() == n
        assert ((counts - n / 8) ** 2 / (n / 8)).sum() < 24.32  # 7 degrees of freedom
    correlation = np.corrcoef(designs.T)[np.triu_indices(4, 1)]
    assert np.abs(correlation).max() < 3.29 / np.sqrt(n)


def l2_star_discrepancy(points: np.ndarray) -> float:
    """Root mean square, over all boxes from the origin, of (share of points inside - volume): Warnock's formula."""
    n, d = points.shape
    pairs = np.prod(1 - np.maximum(points[:, None], points[None]), axis=2).sum() / n**2
    return float(np.sqrt(3.0**-d - 2 ** (1 - d) / n * np.prod(1 - points**2, axis=1).sum() + pairs))


def drive(s: MorphologySampler, iterations: range, score: Callable[[np.ndarray], np.ndarray]) -> list[int]:
    """Ask before each iteration as a training does; the iterations at which the bodies changed."""
    changed = []
    for iteration in iterations:
        before = s.designs
        after = s.next(iteration, torch.from_numpy(score(before)))
        if after is None:
            np.testing.assert_array_equal(s.designs, before)
        else:
            np.testing.assert_array_equal(s.designs, after)
            changed.append(iteration)
    return changed


def short_front(designs: np.ndarray) -> np.ndarray:
    """A policy that does badly with short front thighs: 1 at the lower bound, 0 at the upper."""
    return 1.0 - unit(designs)[:, 0]


@pytest.mark.parametrize("kind", KINDS)
def test_the_seed_decides_the_bodies(kind):
    def course(seed: int) -> np.ndarray:
        s = sampler(kind, 40, seed=seed, bodies=10, every=5)
        stages = [s.designs]
        for iteration in range(100):
            designs = s.next(iteration, torch.from_numpy(short_front(s.designs)))
            stages += [] if designs is None else [designs]
        return np.stack(stages)

    torch.manual_seed(1)
    first = course(0)
    torch.manual_seed(2)  # global streams are nobody's business
    np.testing.assert_array_equal(course(0), first)
    assert first.dtype == np.float64
    assert len(first) == {"temporal": 10, "adaptive": 20}.get(kind, 1)
    assert (kind == "none") == np.array_equal(course(1), first)


@pytest.mark.parametrize("kind", KINDS)
def test_bodies_without_a_stance_are_never_dealt(kind):
    def stands(designs: np.ndarray) -> np.ndarray:
        return designs[:, 0] + designs[:, 1] > 1.9  # the nominal body stands, about 1 in 3 does not

    s = sampler(kind, 60, factory=Points(stands), bodies=20, every=3, spread=0.4)
    for iteration in range(100):
        assert s.designs.shape == (60, 4)
        assert stands(s.designs).all()
        assert ((s.designs >= 0.6) & (s.designs <= 1.4)).all()
        s.next(iteration, torch.from_numpy(1 / (s.designs[:, 0] + s.designs[:, 1])))  # the worst are at the edge


def test_spatial_draws_each_robot_a_body_uniformly():
    n = 4000
    designs = sampler("spatial", n).designs
    assert len(set(rows(designs))) == n
    assert_uniform(designs)
    # trainings of before repeat themselves
    np.testing.assert_array_equal(designs, np.random.default_rng(3).uniform(0.6, 1.4, size=(n, 4)))


def test_none_is_the_nominal_body():
    assert rows(sampler("none", 5).designs) == [(1.0, 1.0, 1.0, 1.0)] * 5


@pytest.mark.parametrize("n", [81, 200, 1024])
def test_grid_deals_all_81_bodies_in_equal_numbers(n):
    dealt = rows(sampler("grid", n).designs)
    counts = [dealt.count(body) for body in GRID]
    assert sum(counts) == n
    assert max(counts) - min(counts) <= 1


def test_grid_with_few_robots_or_few_bodies():
    few = rows(sampler("grid", 30).designs)
    assert len(set(few)) == 30
    assert set(few) < GRID
    assert all(len(set(values)) == 3 for values in zip(*few, strict=True))  # not the first 30
    low = sampler("grid", 100, factory=Points(lambda x: x.sum(axis=1) < 3.0)).designs
    assert set(rows(low)) == {body for body in GRID if sum(body) < 3.0}
    assert set(rows(sampler("grid", 16, levels=2).designs)) == set(itertools.product((0.6, 1.4), repeat=4))
    with pytest.raises(ValueError, match="no body of the grid of 'points' has a stance"):
        sampler("grid", 10, factory=Points(lambda x: np.full(len(x), False)))


@pytest.mark.parametrize("kind", ["grid", "sobol", "adaptive"])
def test_bodies_have_nothing_to_do_with_the_robots_number(kind):
    # terrain may go by it: every 8th or 9th robot, or a block of robots
    s = sampler(kind, 1152, every=1)
    drive(s, range(3), short_front)
    designs = unit(s.designs)
    parts = *(designs[k::8] for k in range(8)), *(designs[k::9] for k in range(9)), *np.split(designs, 8)
    for part in parts:
        error = designs.std(axis=0) / np.sqrt(len(part))
        assert (np.abs(part.mean(axis=0) - designs.mean(axis=0)) < 4 * error).all()
        assert (np.abs(part.std(axis=0) / designs.std(axis=0) - 1) < 0.3).all()


def test_sobol_is_a_net():
    points = unit(sobol_designs(Points(), 256, seed=5))  # pyright: ignore
    for column in points.T:  # one point in each of 256 strata
        assert sorted((column * 256).astype(int)) == list(range(256))
    # in 4 dimensions the sequence has t = 3: as many points in each elementary box of volume 2^-4, here orthants
    orthants = (points > 0.5) @ (1, 2, 4, 8)
    assert np.bincount(orthants, minlength=16).tolist() == [16] * 16
    uniform = [l2_star_discrepancy(np.random.default_rng(seed).random((256, 4))) for seed in range(20)]
    sobol = [l2_star_discrepancy(unit(sobol_designs(Points(), 256, seed))) for seed in range(20)]  # pyright: ignore
    assert max(sobol) < 0.5 * min(uniform)


def test_discrepancy_by_hand():
    # one point x in 1-D: integral of (1[t > x] - t)^2 = (x^3 + (1 - x)^3) / 3
    assert l2_star_discrepancy(np.array([[0.3]])) == pytest.approx(np.sqrt((0.027 + 0.343) / 3))


def test_sobol_deals_the_feasible_part_of_the_sequence():
    def stands(designs: np.ndarray) -> np.ndarray:
        return designs[:, 2] < 1.0

    whole = sobol_designs(Points(), 512, seed=4)  # pyright: ignore
    part = sobol_designs(Points(stands), 200, seed=4)  # pyright: ignore
    np.testing.assert_array_equal(part, whole[stands(whole)][:200])
    dealt = sampler("sobol", 200, seed=4, factory=Points(stands)).designs
    assert sorted(rows(dealt)) == sorted(rows(part))
    with pytest.raises(ValueError, match="only 0 of 200 random designs of 'points' have a stance"):
        sobol_designs(Points(lambda x: np.full(len(x), False)), 10, seed=0)  # pyright: ignore


def test_temporal_gives_all_robots_one_body_at_a_time_in_equal_shares():
    s = sampler("temporal", 4, iterations=24, bodies=7)
    seen = []
    for iteration in range(24):
        changed = s.next(iteration, torch.zeros(4)) is not None
        # 24 / 7 iterations each: body k starts with the first iteration that begins at 24 k / 7 or later
        assert changed == (iteration in (4, 7, 11, 14, 18, 21))
        assert len(set(rows(s.designs))) == 1
        seen += rows(s.designs)[:1]
    turns = [len(list(group)) for _, group in itertools.groupby(seen)]
    assert turns == [4, 3, 4, 3, 4, 3, 3]
    assert len(set(seen)) == 7  # none comes back


def test_temporal_bodies_are_drawn_uniformly_or_from_the_grid():
    def visited(iterations: int, **options) -> np.ndarray:
        s = sampler("temporal", 2, iterations, **options)
        return np.stack([s.designs[0] for i in range(iterations) if i == 0 or s.next(i, torch.zeros(2)) is not None])

    assert_uniform(visited(2000, bodies=2000))
    assert len(visited(100)) == 81  # the paper's number
    grid = visited(162, bodies=None)
    assert len(grid) == 81
    assert set(rows(grid)) == GRID
    assert rows(grid) != sorted(rows(grid))  # long legs do not all come last
    with pytest.raises(ValueError, match="81 bodies cannot take turns in 80 iterations: train longer"):
        sampler("temporal", 2, iterations=80)


def test_adaptive_starts_uniform_and_changes_when_it_says():
    s = sampler("adaptive", 500, every=7)
    np.testing.assert_array_equal(s.designs, sampler("spatial", 500).designs)
    assert drive(s, range(30), short_front) == [7, 14, 21, 28]


def test_adaptive_moves_to_the_bad_bodies_and_keeps_the_others():
    n = 2000
    s = sampler("adaptive", n, every=2)
    bad = [float((unit(s.designs)[:, 0] < 0.1).mean())]
    for iteration in range(7):
        if s.next(iteration, torch.from_numpy(short_front(s.designs))) is not None:
            bad.append(float((unit(s.designs)[:, 0] < 0.1).mean()))
    assert bad[0] == pytest.approx(0.1, abs=0.03)
    # half of them stay uniform: 0.05; the other half is around the worst tenth, which lies below 0.1, within 0.1
    assert 0.05 + 0.25 < bad[1] < 0.05 + 0.5
    assert min(bad[2:]) > 0.05 + 0.4
    # what is not bad is what is left of the uniform half, and as uniform
    good = s.designs[unit(s.designs)[:, 0] > 0.2]
    assert len(good) == pytest.approx(n * 0.5 * 0.8, rel=0.1)
    moved = np.concatenate((0.6 + (good[:, :1] - 0.76) / 0.8, good[:, 1:]), axis=1)
    assert_uniform(moved)
    # and not a pile on the bound
    assert (s.designs[:, 0] == 0.6).sum() == 0


def test_adaptive_leaves_bodies_that_have_become_good():
    s = sampler("adaptive", 1000, every=1)
    drive(s, range(5), short_front)
    assert (unit(s.designs)[:, 0] < 0.1).mean() > 0.4
    drive(s, range(5, 9), lambda designs: unit(designs)[:, 0])
    assert (unit(s.designs)[:, 0] < 0.1).mean() < 0.1
    assert (unit(s.designs)[:, 0] > 0.9).mean() > 0.4


def test_adaptive_hears_the_neighbours_above_the_luck_of_one():
    def bad(neighbours: int) -> float:
        luck = np.random.default_rng(0)
        s = sampler("adaptive", 1000, every=1, neighbours=neighbours)
        drive(s, range(6), lambda designs: short_front(designs) + luck.normal(size=len(designs)))
        return float((unit(s.designs)[:, 0] < 0.25).mean())

    assert bad(16) > bad(1) + 0.05


@pytest.mark.parametrize("stop", [1, 10, 11, 13])
@pytest.mark.parametrize("kind", ["temporal", "adaptive"])
def test_a_saved_sampler_goes_on_as_if_nothing_had_happened(kind, stop, tmp_path):
    def make() -> MorphologySampler:
        return sampler(kind, 50, iterations=30, bodies=9, every=5)

    whole = make()
    drive(whole, range(30), short_front)
    first = make()
    drive(first, range(stop), short_front)
    torch.save(first.state_dict(), tmp_path / "state.pt")
    saved = first.designs.copy()
    drive(first, range(stop, 30), short_front)  # the saved state is a copy
    second = make()
    second.load_state_dict(torch.load(tmp_path / "state.pt", weights_only=True))
    np.testing.assert_array_equal(second.designs, saved)
    drive(second, range(stop, 30), short_front)
    np.testing.assert_array_equal(second.designs, whole.designs)
    assert not np.array_equal(saved, make().designs) or stop == 1


def test_fixed_bodies_stay():
    designs = np.random.default_rng(0).random((3, 4))
    s = FixedSampler(designs)
    assert drive(s, range(50), short_front) == []
    np.testing.assert_array_equal(s.designs, designs)
    assert s.state_dict() == {}


def test_configuration_is_json_and_refuses_nonsense():
    config = MorphologyConfig(kind="temporal", bodies=None, spread=0.3)
    assert from_dict(MorphologyConfig, to_dict(config)) == config
    with pytest.raises(ValueError, match="no kind 'random'; there are spatial, temporal, none, grid, sobol, adaptive"):
        MorphologyConfig(kind="random")  # pyright: ignore
    for wrong in ({"bodies": 0}, {"every": 0}, {"levels": 0}, {"neighbours": 0}):
        with pytest.raises(ValueError, match=f"{next(iter(wrong))} must be at least 1, got 0"):
            replace(config, **wrong)
    for wrong in ({"uniform": 0.0}, {"worst": 1.5}, {"spread": -0.1}):
        with pytest.raises(ValueError, match=rf"{next(iter(wrong))} must be in \(0, 1\]"):
            replace(config, **wrong)
    with pytest.raises(ValueError, match="at least 2 robots"):
        sampler("adaptive", 1)
