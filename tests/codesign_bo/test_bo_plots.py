"""What is drawn: the data in the axes against values computed by hand."""

import itertools
import re

import matplotlib.colors
import numpy as np
import pytest
from codesign_bo import BoxSpace, Categorical, Continuous, EvalResult, Integer, LinearConstraint, Study
from codesign_bo.models.surrogate import LeaveOneOut
from codesign_bo.plots import (
    Labels,
    NothingToShowError,
    plot_calibration,
    plot_convergence,
    plot_landscape,
    plot_pairs,
    plot_pareto,
    plot_sensitivity,
    plot_slices,
    plot_timeline,
)
from codesign_bo.plots.calibration import Calibration
from codesign_bo.plots.convergence import Convergence
from codesign_bo.plots.landscape import Landscape
from codesign_bo.plots.pairs import Pairs
from codesign_bo.plots.pareto import Front
from codesign_bo.plots.sensitivity import Importance
from codesign_bo.plots.slices import Slices
from codesign_bo.plots.style import OUTCOMES, Z95, levels, value_text
from codesign_bo.plots.timeline import Timeline
from codesign_bo.records import AttemptRecord
from codesign_bo.sensitivity import Effect
from matplotlib.collections import QuadMesh

SQUARE = BoxSpace.box(["a", "b"], 0.0, 1.0, 0.5)


@pytest.fixture
def told(tmp_path):
    """Makes a study of given results: the nominal design's first, then those of the designs."""
    opened = []

    def make(space, designs, results, **settings):
        study = Study(space, tmp_path / f"{len(opened)}.sqlite", n_init=1000, **settings)
        opened.append(study)
        study.enqueue(designs)
        for result in results:
            (request,) = study.ask()
            study.tell(request.trial, result, request.token)
        return study

    yield make
    for study in opened:
        study.close()


def grid(n, names=("a", "b")):
    """All designs of an n x n grid over the unit square, but the middle one."""
    ticks = [round(float(v), 6) for v in np.linspace(0, 1, n)]
    return [dict(zip(names, p, strict=True)) for p in itertools.product(ticks, ticks) if p != (0.5, 0.5)]


@pytest.fixture
def plane(told):
    """2 a - b, measured nearly without noise on a grid of 5 x 5."""
    designs = grid(5)
    results = [EvalResult(2 * p["a"] - p["b"], 1e-3) for p in [SQUARE.nominal, *designs]]
    return told(SQUARE, designs, results)


def line(ax, label):
    return next(each for each in ax.get_lines() if each.get_label().startswith(label))


def texts(ax):
    return {(t.get_position(), t.get_text()) for t in ax.texts}


# --- convergence --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("maximize", "best"), [(True, [1, 3, 3, 5]), (False, [1, 1, 1, 1])])
def test_convergence_draws_the_best_score_so_far(told, maximize, best):
    designs = [{"a": v, "b": 0.5} for v in (0.1, 0.2, 0.3)]
    study = told(SQUARE, designs, [EvalResult(v, 0.5) for v in (1.0, 3.0, 2.0, 5.0)], maximize=maximize)
    (ax,) = plot_convergence(study).axes
    drawn = line(ax, "best score so far")
    assert drawn.get_xdata().tolist() == [0, 1, 2, 3, 3.5]
    assert drawn.get_ydata().tolist() == [*best, best[-1]]
    bars = next(c for c in ax.containers if c.get_label().startswith("score"))
    ends = np.array([segment[:, 1] for segment in bars[2][0].get_segments()])
    np.testing.assert_allclose(ends, [[v - 0.5 * 1.959964, v + 0.5 * 1.959964] for v in (1, 3, 2, 5)], rtol=1e-5)
    assert ("higher" if maximize else "lower") in ax.get_ylabel()


def test_convergence_marks_failures_and_trials_keep_their_numbers(told):
    designs = [{"a": v, "b": 0.5} for v in (0.1, 0.2, 0.3, 0.4)]
    results = [EvalResult(1.0), EvalResult.failure("crash", "x"), EvalResult(2.0), EvalResult.failure("timeout", "y")]
    study = told(SQUARE, designs, [*results, EvalResult.failure("crash", "z")])
    (ax,) = plot_convergence(study).axes
    assert line(ax, "crash").get_xdata().tolist() == [1, 4]
    assert line(ax, "timeout").get_xdata().tolist() == [3]
    assert line(ax, "best score so far").get_xdata().tolist() == [0, 2, 4.5]
    assert {line(ax, kind).get_marker() for kind in ("crash", "timeout")} == {"X", "s"}
    assert "3 of 5 trials have no score" in Convergence.of(study).sentence(Labels())


def test_convergence_recommends_what_was_best_then(told):
    """After each trial: what a study that ended there says."""
    designs = [{"a": v, "b": w} for v, w in ((0.1, 0.2), (0.8, 0.3), (0.9, 0.9), (0.75, 0.4))]
    results = [EvalResult(v, 0.3) for v in (0.0, -1.0, 1.5, -0.5, 1.2)]
    whole = Convergence.of(told(SQUARE, designs, results))
    assert whole.at.tolist() == [0, 1, 2, 3, 4]
    for ended in (1, 3, 5):
        best = told(SQUARE, designs, results[:ended]).best()
        assert whole.designs[ended - 1] == best.trial
        assert (whole.recommended[ended - 1], whole.spread[ended - 1]) == pytest.approx((best.mean, best.std))
    ax = whole.figure(Labels()).axes[0]
    np.testing.assert_allclose(line(ax, "recommended so far").get_ydata()[:-1], whole.recommended)
    band = next(c for c in ax.collections if c.get_label().startswith("95 %")).get_paths()[0].vertices
    assert band[:, 1].max() == pytest.approx((whole.recommended + Z95 * whole.spread).max())


def test_convergence_asks_the_surrogate_a_limited_number_of_times(told, monkeypatch):
    monkeypatch.setattr("codesign_bo.plots.convergence._FITS", 3)
    designs = [{"a": v, "b": 0.5} for v in (0.0, 0.1, 0.2, 0.3)]
    assert Convergence.of(told(SQUARE, designs, [EvalResult(0.0, 0.1)] * 5)).at.tolist() == [0, 2, 4]


# --- slices -------------------------------------------------------------------------------------------


def test_slices_follow_the_function_and_hold_the_others(plane):
    """2 a - b is best at a = 1, b = 0; along a it is 2 a there, along b it is 2 - b."""
    figure = plot_slices(plane, Labels("return", {"b": "m"}))
    for ax, truth in zip(figure.axes[:2], (lambda u: 2 * u, lambda u: 2 - u), strict=True):
        curve = ax.get_lines()[0]
        np.testing.assert_allclose(curve.get_ydata(), truth(curve.get_xdata()), atol=0.03)
        assert curve.get_xdata()[[0, -1]].tolist() == [0, 1]
    assert [ax.get_xlabel() for ax in figure.axes[:2]] == ["a", "b (m)"]
    assert figure.axes[0].get_ylabel() == "return"
    assert figure.axes[0].get_ylim() == figure.axes[1].get_ylim()
    found = Slices.of(plane)
    assert [one.here for one in found.lines] == [1.0, 0.0]
    assert [one.nominal for one in found.lines] == [0.5, 0.5]
    assert "a moves the posterior mean most: by 2" in found.sentence(Labels())


def test_slices_of_every_kind_of_parameter(told):
    space = BoxSpace(
        (
            Categorical("foot", ("ball", "flat", "claw"), "ball"),
            Integer("teeth", 8, 11, 9),
            Continuous("stiffness", 1.0, 100.0, 10.0, log=True),
            Continuous("held", 0.0, 1.0, 0.5, fixed=True),
        )
    )
    designs = [
        {"foot": f, "teeth": t, "stiffness": s, "held": 0.5} for f, t, s in (("flat", 8, 1.0), ("claw", 11, 100.0))
    ]
    study = told(space, designs, [EvalResult(0.0, 0.1), EvalResult(1.0, 0.1), EvalResult.failure("crash", "x")])
    figure = plot_slices(study)
    foot, teeth, stiffness = figure.axes[:3]
    assert [t.get_text() for t in foot.get_xticklabels()] == ["ball", "flat", "claw"]
    np.testing.assert_allclose(foot.get_xticks(), [1 / 6, 3 / 6, 5 / 6])
    assert [t.get_text() for t in teeth.get_xticklabels()] == ["8", "9", "10", "11"]
    assert [len(one.at) for one in Slices.of(study).lines[:2]] == [3, 4]
    ticks = dict(zip((t.get_text() for t in stiffness.get_xticklabels()), stiffness.get_xticks(), strict=True))
    assert ticks["10"] == pytest.approx(0.5)  # halfway on a logarithmic axis
    failed = Slices.of(study).lines
    assert [one.failed.tolist() for one in failed] == [[pytest.approx(5 / 6)], [pytest.approx(7 / 8)], [1.0]]


def test_slices_hatch_what_constraints_rule_out(told):
    space = SQUARE.with_constraints(LinearConstraint({"a": 1.0, "b": 1.0}, high=1.2))
    study = told(space, [{"a": 0.6, "b": 0.6}], [EvalResult(0.0, 0.01), EvalResult(1.0, 0.01)])
    for one in Slices.of(study).lines:
        np.testing.assert_array_equal(one.allowed, one.at + 0.6 <= 1.2 + 1e-9)
    assert "ruled out" in {t.get_text()[:9] for t in plot_slices(study).legends[0].get_texts()}


# --- landscapes ---------------------------------------------------------------------------------------


def test_the_landscape_has_blocks_with_their_values(plane):
    figure = plot_landscape(plane, labels=Labels("return"))
    left = figure.axes[0]
    block = {t.get_position(): t.get_text() for t in left.texts}
    means = {(x, round(y)): float(w.replace("−", "-")) for (x, y), w in block.items() if not w.startswith("±")}
    assert set(means) == set(itertools.product(range(5), range(5)))
    for (column, row), value in means.items():
        assert value == pytest.approx(2 * column / 4 - row / 4, abs=0.02)
    mesh = next(c for c in left.collections if isinstance(c, QuadMesh))
    np.testing.assert_allclose(
        np.asarray(mesh.get_array()).reshape(5, 5), [[2 * c / 4 - r / 4 for c in range(5)] for r in range(5)], atol=0.02
    )
    frames = {p.get_label(): p.get_xy() for p in left.patches if p.get_label() in ("recommended", "nominal")}
    assert frames == {"recommended": (4 - 0.46, 0 - 0.46), "nominal": (2 - 0.46, 2 - 0.46)}
    assert [t.get_text() for t in left.get_xticklabels()] == ["0", "0.25", "0.5", "0.75", "1"]
    assert (left.get_xlabel(), left.get_ylabel()) == ("a", "b")
    assert re.search(r"ranges from -(1|0\.99\d) to (2|1\.99), more than", Landscape.of(plane).sentence(Labels()))


def test_the_landscape_of_chosen_parameters(plane):
    swapped, usual = Landscape.of(plane, ("b", "a")), Landscape.of(plane)
    np.testing.assert_allclose(swapped.blocks.mean, usual.blocks.mean.T)
    for names in (("a", "c"), ("a", "a")):
        with pytest.raises(ValueError, match="no two different free parameters; choose from"):
            plot_landscape(plane, names)


def test_the_landscape_leaves_out_what_constraints_rule_out(told):
    space = SQUARE.with_constraints(LinearConstraint({"a": 1.0, "b": 1.0}, high=1.0))
    study = told(space, [{"a": 0.1, "b": 0.1}], [EvalResult(0.0, 0.1), EvalResult(1.0, 0.1)])
    left = plot_landscape(study).axes[0]
    places = {(round(x), round(y)) for (x, y), _ in texts(left)}
    assert places == {(x, y) for x in range(5) for y in range(5) if x + y <= 4}


def test_the_landscape_shows_where_it_is_uncertain(told):
    study = told(SQUARE, [{"a": 0.1, "b": 0.1}], [EvalResult(0.0, 0.01), EvalResult(1.0, 0.01)])
    right = plot_landscape(study).axes[1]
    mesh = next(c for c in right.collections if isinstance(c, QuadMesh))
    spread = np.asarray(mesh.get_array()).reshape(41, 41)
    assert spread[-1, 0] > 2 * spread[20, 20]  # the corner (0, 1) is far from both trials, the middle is one
    tried = next(each for each in right.get_lines() if each.get_marker() == "o")
    assert {tuple(p) for p in tried.get_xydata().tolist()} == {(0.5, 0.5), (0.1, 0.1)}


def test_pairs_have_means_below_and_deviations_above_the_diagonal(told):
    space = BoxSpace.box(["a", "b", "c"], 0.0, 1.0, 0.5)
    rng = np.random.default_rng(0)
    designs = [dict(zip("abc", row, strict=True)) for row in rng.random((26, 3)).tolist()]
    value = lambda p: 3 * p["a"] + p["b"]  # noqa: E731
    study = told(space, designs, [EvalResult(value(p), 1e-3) for p in [space.nominal, *designs]])
    found = Pairs.of(study)
    axes = np.array(plot_pairs(study).axes[:9]).reshape(3, 3)

    def mesh(ax):
        (drawn,) = [c for c in ax.collections if isinstance(c, QuadMesh)]
        return np.asarray(drawn.get_array()).reshape(41, 41)

    here = study.recommend().params
    below = mesh(axes[1, 0])  # a across, b upwards
    ticks = np.linspace(0, 1, 41)
    np.testing.assert_allclose(below, 3 * ticks[None, :] + ticks[:, None], atol=0.25)
    np.testing.assert_allclose(mesh(axes[2, 0])[:, 20], 1.5 + here["b"], atol=0.25)  # c does nothing
    np.testing.assert_allclose(mesh(axes[0, 1]), found.planes[0, 1].std.T)  # b across, a upwards
    np.testing.assert_allclose(mesh(axes[0, 2]), found.planes[0, 2].std.T)
    assert [axes[2, i].get_xlabel() for i in range(2)] == ["a", "b"]
    assert [axes[i, 0].get_ylabel() for i in (1, 2)] == ["b", "c"]
    assert found.sentence(Labels()).startswith("Of all pairs, a and b change the posterior mean most")


# --- sensitivity, calibration ---------------------------------------------------------------------------


def test_sensitivity_draws_indices_and_says_what_is_not_identifiable():
    effects = [Effect("weak", 40.0, 0.01, 0.03, 0.2, False), Effect("strong", 0.3, 0.8, 0.95, 30.0, True)]
    figure = Importance.sorted(effects).figure(Labels(units={"strong": "m"}))
    left, right = figure.axes
    widths = {bar.get_width() for bar in left.patches}
    assert widths == {0.01, 0.03, 0.8, 0.95}
    assert [t.get_text() for t in left.get_yticklabels()] == ["strong (m)", "weak"]
    ((place, words),) = texts(left)
    assert (place[1], words) == (1, "not identifiable")
    dots = {tuple(each.get_xydata()[0].tolist()) for each in right.get_lines() if each.get_marker() == "o"}
    assert dots == {(0.3, 0), (40.0, 1)}
    sentence = Importance.sorted(effects).sentence(Labels())
    assert "strong (95%)" in sentence
    assert "without it: weak." in sentence


def test_calibration_marks_scores_outside_their_interval():
    y, mean = np.array([0.0, 1.0, 2.0, 9.0]), np.array([0.5, 1.0, 2.5, 3.0])
    picture = Calibration(LeaveOneOut(y, mean, np.array([1.0, 0.5, 1.0, 1.5])), ("0", "1", "2", "7"))
    left, right = picture.figure(Labels("return")).axes
    r2 = 1 - (0.25 + 0 + 0.25 + 36.0) / np.sum((y - 3.0) ** 2)
    assert f"r² = {r2:.2f}" in left.get_title(loc="left")
    assert right.get_title(loc="left") == "3 of 4 in the 95 % band"
    points = np.concatenate([c[0].get_xydata() for c in left.containers])
    assert {tuple(p) for p in points.tolist()} == set(zip(mean.tolist(), y.tolist(), strict=True))
    marks = [each for each in right.get_lines() if each.get_marker() == "D"]
    assert [m.get_xydata().tolist() for m in marks] == [[[3, 4.0]]]  # (9 - 3) / 1.5
    assert {t.get_text() for t in left.texts} == {"7"}
    assert "outside: trials 7" in picture.sentence(Labels())
    assert picture.left.coverage == 0.75


def test_calibration_names_trials_of_the_study(plane):
    assert Calibration.of(plane).names == tuple(str(i) for i in range(25))
    assert plot_calibration(plane).axes[1].get_xlabel() == "trial"


# --- Pareto front ---------------------------------------------------------------------------------------


def test_the_front_by_hand(told):
    """More return and less energy: (3, 5) is beaten by (4, 4); (4, 4), (1, 1) and (5, 9) are not."""
    designs = [{"a": v, "b": 0.5} for v in (0.1, 0.2, 0.3)]
    pairs = [(3.0, 5.0), (4.0, 4.0), (1.0, 1.0), (5.0, 9.0)]
    results = [EvalResult(r, 0.1, extras={"energy": e, "energy_sem": 0.5}) for r, e in pairs]
    study = told(SQUARE, designs, results, objectives={"energy": "minimize"})
    assert Front.of(study).efficient.tolist() == [False, True, True, True]
    (ax,) = plot_pareto(study, Labels("return", {"energy": "J"})).axes
    on = next(c for c in ax.containers if c.get_label() == "on the front")[0].get_xydata()
    assert {tuple(p) for p in on.tolist()} == {(4, 4), (1, 1), (5, 9)}
    stairs = next(each for each in ax.get_lines() if len(each.get_xdata()) == 5)
    assert stairs.get_xydata().tolist() == [[1, 1], [1, 4], [4, 4], [4, 9], [5, 9]]
    assert ax.get_xlabel() == "return (higher is better)"
    assert ax.get_ylabel() == "energy (J) (lower is better)"
    sentence = Front.of(study).sentence(Labels())
    assert "3 of 4 results are beaten by no other" in sentence
    assert "the nominal design is beaten" in sentence


# --- time line ------------------------------------------------------------------------------------------


def attempt(trial, status, started, ended, seconds=None, number=1, repeat=None):
    token = f"{trial}-{number}"
    return AttemptRecord(token, trial, repeat, number, status, started, ended, seconds, None, "", None, True, True)


def test_the_time_line_puts_overlapping_attempts_into_slots():
    attempts = [
        attempt(0, "ok", 1000.0, 1010.0),
        attempt(1, "crash", 1002.0, 1006.0),
        attempt(2, "ok", 1007.0, 1012.0),
        attempt(3, "running", 1010.0, None),
    ]
    found = Timeline.from_attempts(attempts)
    assert [(b.trial, b.slot, b.start) for b in found.bars] == [(0, 0, 0.0), (1, 1, 2.0), (2, 1, 7.0), (3, 0, 10.0)]
    # what runs reaches to the last known moment, but at least as far as the median of the others (5 s)
    assert found.bars[3].seconds == 5.0
    assert found.busy == pytest.approx((10 + 4 + 5 + 5) / (2 * 15))
    (ax,) = found.figure(Labels()).axes
    bars = {(b.get_x(), b.get_y() + b.get_height() / 2, b.get_width()): b.get_facecolor() for b in ax.patches}
    assert bars[2.0, 1, 4.0][:3] == matplotlib.colors.to_rgb(OUTCOMES["crash"].colour)
    assert set(bars) == {(0.0, 0, 10.0), (2.0, 1, 4.0), (7.0, 1, 5.0), (10.0, 0, 5.0)}
    assert "(s)" in ax.get_xlabel()
    assert {t.get_text() for t in ax.figure.legends[0].get_texts()} == {
        "ok", "crash", "running, or its coordinator died",
    }  # fmt: skip


def test_the_time_line_leaves_out_nights_and_believes_the_steady_clock():
    night = 36_000.0
    attempts = [
        attempt(0, "ok", 0.0, 9_999.0, seconds=100.0),  # the machine's clock was set
        attempt(1, "interrupted", 100.0, 200.0),
        attempt(1, "ok", 200.0 + night, 300.0 + night, number=2),
    ]
    found = Timeline.from_attempts(attempts)
    assert [b.start for b in found.bars] == [0.0, 100.0, pytest.approx(200.0 + 0.03 * 300.0)]
    ((at, length),) = found.breaks
    assert length == night
    assert 200.0 < at < found.bars[2].start
    (ax,) = found.figure(Labels()).axes
    assert "pause 10:00:00" in {t.get_text() for t in ax.texts}
    assert "33% of that went into attempts without a score" in found.sentence(Labels())


def test_the_time_line_of_a_study(told):
    study = told(SQUARE, [], [EvalResult(1.0)])
    (bar,) = Timeline.of(study).bars
    assert (bar.trial, bar.attempt, bar.status, bar.repeat) == (0, 1, "ok", None)
    assert len(plot_timeline(study).axes[0].patches) == 1


# --- what cannot be drawn, and style --------------------------------------------------------------------


def test_what_is_missing_is_said(told):
    empty = told(SQUARE, [], [])
    failed = told(SQUARE, [], [EvalResult.failure("crash", "x")])
    line_space = BoxSpace.box(["a"], 0.0, 1.0, 0.5)
    single = told(line_space, [{"a": 0.1}], [EvalResult(1.0), EvalResult(2.0)])
    for plot, study, words in (
        (plot_convergence, empty, "no trial is finished"),
        (plot_timeline, empty, "no evaluation has begun"),
        (plot_slices, failed, "no trial has a score"),
        (plot_landscape, failed, "fewer than 2 trials"),
        (plot_landscape, single, "only one free parameter"),
        (plot_pairs, told(SQUARE, [{"a": 0.1, "b": 0.1}], [EvalResult(1.0), EvalResult(2.0)]), "landscape shows both"),
        (plot_sensitivity, single, "fewer than 3 trials"),
        (plot_calibration, single, "fewer than 3 trials"),
        (plot_pareto, single, "one objective"),
    ):
        with pytest.raises(NothingToShowError, match=words):
            plot(study)
    assert line(plot_convergence(failed).axes[0], "crash").get_xdata().tolist() == [0]


def test_levels_and_their_words():
    teeth = Integer("teeth", 0, 100, 50)
    np.testing.assert_allclose(levels(teeth, 5), (np.array([0, 25, 50, 75, 100]) + 0.5) / 101)
    assert [value_text(teeth, u) for u in levels(teeth, 5)] == ["0", "25", "50", "75", "100"]
    assert value_text(Categorical("foot", ("x" * 30, "y"), "y"), 0.1) == "x" * 13 + "…"
    assert value_text(Continuous("k", 1.0, 1000.0, 1.0, log=True), 1 / 3) == "10"


# Machado et al. 2009, full severity: what people without one kind of cone see (linear RGB).
_BLIND = {
    "none": np.eye(3),
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}


def _lab(rgb):
    """CIE L*a*b* of linear sRGB under D65."""
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ rgb
    f = np.cbrt(np.maximum(xyz / [0.9505, 1.0, 1.089], 0.008856))
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("kind", list(_BLIND))
def test_outcomes_can_be_told_apart_with_any_colour_vision(kind):
    seen = {}
    for status, look in OUTCOMES.items():
        srgb = np.array(matplotlib.colors.to_rgb(look.colour))
        linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
        seen[status] = _lab(np.clip(np.array(_BLIND[kind]) @ linear, 0, 1))
    for a, b in itertools.combinations(seen, 2):
        if OUTCOMES[a].hatch == OUTCOMES[b].hatch:
            assert np.linalg.norm(seen[a] - seen[b]) > 10, (a, b)
