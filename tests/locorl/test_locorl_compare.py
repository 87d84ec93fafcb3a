"""`locorl compare`: groups, equal samples, tables and pictures."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import locorl.commands.compare
import numpy as np
import pytest
import tyro
from locorl import EvalConfig, Trainer
from locorl.cli import Command
from locorl.commands.compare import Compare
from locorl.commands.evaluate import Evaluate
from locorl.evaluation.compare import (
    Curve,
    common_samples,
    final_values,
    mean_curve,
    read_curve,
    read_group,
    read_scores,
)
from scipy import stats


def write_run(folder: Path, rewards: list[float], step: int = 100) -> Path:
    folder.mkdir(parents=True)
    rows = [
        {"iteration": k + 1, "samples": (k + 1) * step, "reward": value, "tracking_error": 0.1}
        for k, value in enumerate(rewards)
    ]
    (folder / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return folder


@pytest.fixture
def runs(tmp_path, monkeypatch) -> Path:
    """Two groups: three runs of four iterations, and two of six half as long ones with a seventh to come."""
    for seed, end in enumerate((4.0, 5.0, 6.0)):
        write_run(tmp_path / f"a-{seed}", [1.0, 2.0, end - 1, end + 1])
    for seed, end in enumerate((7.0, 9.0)):
        write_run(tmp_path / "b" / f"{seed}", [0.0] * 6 + [end, end, 99.0], step=50)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    return tmp_path


def table(text: str) -> dict[str, list[str]]:
    """Cells of a printed table by its first column."""
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in text.splitlines() if "│" in line]
    return {row[0]: row[1:] for row in rows}


def test_groups_are_folders_lists_and_patterns(runs):
    names = [f"a-{seed}" for seed in range(3)]
    assert [path.name for path in read_group("a-*").paths] == names
    assert read_group("a-*").name == "a-*"
    assert [path.name for path in read_group(str(runs / "a-*")).paths] == names
    group = read_group("ours=a-0,b")
    assert group.name == "ours"
    assert group.paths == (Path("a-0"), Path("b/0"), Path("b/1"))
    assert read_group("b").name == "b"
    with pytest.raises(FileNotFoundError, match="nowhere: neither a run folder"):
        read_group("nowhere")


def test_finals_are_taken_at_equal_samples(runs):
    a, b = ([read_curve(path, "reward") for path in read_group(text).paths] for text in ("a-*", "b"))
    # a has 400 steps, b 450, of which the last row is beyond what a has
    assert common_samples([a, b]) == 400
    np.testing.assert_array_equal(final_values(a, 400, last=2), [4.0, 5.0, 6.0])
    np.testing.assert_array_equal(final_values(b, 400, last=2), [7.0, 9.0])
    np.testing.assert_array_equal(final_values(b, 400, last=4), [3.5, 4.5])
    with pytest.raises(ValueError, match="within the 50 environment steps"):
        final_values(a, 50, last=1)
    with pytest.raises(ValueError, match="at least 1"):
        final_values(a, 400, last=0)


def test_a_mean_curve_by_hand():
    curves = [Curve(np.array([0.0, 10.0]), np.array([0.0, 10.0])), Curve(np.array([2.0, 8.0]), np.array([6.0, 6.0]))]
    grid, mean, deviation = mean_curve(curves, 8.0, points=3)
    np.testing.assert_allclose(grid, [2, 5, 8])
    np.testing.assert_allclose(mean, [4, 5.5, 7])
    np.testing.assert_allclose(deviation, [np.sqrt(8), np.sqrt(0.5), np.sqrt(2)])
    np.testing.assert_array_equal(mean_curve(curves[:1], 8.0)[2], 0.0)


def test_metrics_that_are_not_there_are_named(runs):
    with pytest.raises(ValueError, match=r"no metric 'grace'; it has: reward, tracking_error"):
        read_curve(runs / "a-0", "grace")
    (runs / "a-0" / "metrics.jsonl").write_text("")
    with pytest.raises(ValueError, match="is empty"):
        read_curve(runs / "a-0", "reward")


def test_the_table_of_two_groups(runs, capsys):
    Compare(("old=a-*", "new=b"), last=2).run()
    out = capsys.readouterr().out
    assert "until 0.0004 M environment steps" in out
    cells = table(out)
    assert cells["old"][:3] == ["3", "5", "1"]
    test = stats.ttest_ind([7.0, 9.0], [4.0, 5.0, 6.0], equal_var=False)
    low, high = test.confidence_interval()
    assert cells["new"] == ["2", "8", "1.414", "+3", f"{low:+.4g} to {high:+.4g}", f"{test.pvalue:.3g}"]


def test_single_runs_are_shown_without_a_test(runs, capsys):
    Compare(("a-0", "a-1"), last=1).run()
    out = capsys.readouterr().out
    assert table(out)["a-1"][:4] == ["1", "6", "-", "+1"]
    assert "two runs or more" in out


def test_learning_curves_are_drawn(runs):
    Compare(("old=a-*", "new=b"), plot=Path("curves.png")).run()
    assert Path("curves.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ValueError, match=r"a picture is a \.png file"):
        Compare(("old=a-*", "new=b"), plot=Path("curves.pdf")).run()


@pytest.mark.parametrize(
    ("groups", "message"),
    [
        (("a-*",), "two groups or more"),
        (("a=a-0", "a=a-1"), "different names"),
        (("a-0", "eval.json"), "cannot be compared with evaluations"),
        (("x=eval.json,a-0", "a-1"), "not both"),
    ],
)
def test_comparisons_without_sense_are_refused(runs, groups, message):
    (runs / "eval.json").write_text("{}")
    with pytest.raises(ValueError, match=message):
        Compare(groups).run()


@pytest.fixture
def trained(factory, tiny, runs, monkeypatch) -> Path:
    """Runs `u-0`, `u-1` and `v-0` of the box quadruped, and the command finding that robot."""
    for name, seed, iterations in (("u-0", 0, 1), ("u-1", 1, 1), ("v-0", 2, 2)):
        Trainer(factory, replace(tiny, seed=seed, iterations=iterations), runs / name, threads=1).run(quiet=True)
    for module in (locorl.commands.compare, locorl.commands.evaluate):
        monkeypatch.setattr(module, "find_factory", lambda name: factory)
    return runs


PROTOCOL = EvalConfig(seconds=0.4, settle=0.1, robots_per_body=2, reset_joint=0.05)


def test_policies_are_compared_on_common_random_numbers(trained, capsys):
    Compare(("u=u-0", "v=v-0"), evaluate=True, bodies=6, evaluation=PROTOCOL).run()
    fresh = capsys.readouterr().out
    assert "different numbers of environment steps: 4.8e-05 M, 9.6e-05 M" in " ".join(fresh.split())
    # the same from files
    for name in ("u-0", "v-0"):
        Evaluate(trained / name / "policy.pt", bodies=6, evaluation=PROTOCOL, json=True).run()
        (trained / f"{name}.json").write_text(capsys.readouterr().out)
    Compare(("u=u-0.json", "v=v-0.json")).run()
    assert table(capsys.readouterr().out) == table(fresh)
    cells = table(fresh)
    assert cells["u"][0] == cells["v"][0] == "6"  # bodies
    u, v = (read_scores(trained / f"{name}.json", "returns").values for name in ("u-0", "v-0"))
    assert cells["v"][-1] == f"{stats.ttest_ind(u, v, equal_var=False).pvalue:.3g}"

    Compare(("u=u-*", "w=u-1,v-0"), evaluate=True, bodies=3, evaluation=PROTOCOL).run()
    assert table(capsys.readouterr().out)["w"][0] == "2"  # runs


def test_evaluations_of_different_bodies_or_protocols_are_refused(trained, capsys):
    protocols = {"a": PROTOCOL, "b": replace(PROTOCOL, seed=1), "c": replace(PROTOCOL, settle=0.2)}
    for name, protocol in protocols.items():
        Evaluate(trained / "u-0" / "policy.pt", bodies=2, evaluation=protocol, json=True).run()
        (trained / f"{name}.json").write_text(capsys.readouterr().out)
    with pytest.raises(ValueError, match=r"different protocols:\n  seed: 0 -> 1"):
        Compare(("a.json", "b.json")).run()
    with pytest.raises(ValueError, match=r"settle: 0\.1 -> 0\.2"):
        Compare(("a.json", "c.json")).run()
    other = json.loads((trained / "a.json").read_text())
    other["robots"][0]["design"][0] += 0.1
    (trained / "d.json").write_text(json.dumps(other))
    with pytest.raises(ValueError, match="different bodies"):
        Compare(("a.json", "d.json")).run()
    with pytest.raises(ValueError, match="no measure 'grace'"):
        Compare(("a.json", "d.json"), measure="grace").run()
    with pytest.raises(ValueError, match="on 2 of 2 bodies the measure is not finite"):  # nobody gets anywhere
        Compare(("a.json", "d.json"), measure="cost_of_transport").run()
    (trained / "e.json").write_text("[]")
    with pytest.raises(ValueError, match="was not written by `locorl evaluate --json`"):
        Compare(("a.json", "e.json")).run()


def test_the_command_line(runs):
    command = tyro.cli(Command, args=["compare", "old=a-*", "new=b", "--last", "3", "--evaluate"])
    assert isinstance(command, Compare)
    assert (command.groups, command.last, command.evaluate) == (("old=a-*", "new=b"), 3, True)
