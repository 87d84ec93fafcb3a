"""The table, the picture and the folder that `benchmarks/bo.py` makes of its runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from deploy.page.style import BEST, INK, MUTED, figure, label
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from rich.box import SIMPLE
from rich.table import Table

from benchmarks.bo_runs import library_versions, record_line
from benchmarks.bo_statistics import OURS, PAPER, PEER, Bar, Results, Row, number
from legged_codesign.provenance import described

COLUMNS = (
    "problem",
    "method",
    "median regret",
    "quartiles",
    "best visited",
    f"better than {PAPER}",
    f"minus {PEER}",
    "CPU s/evaluation",
)
LOOKS: dict[str, tuple[str, str]] = {
    OURS: (BEST, "-"),
    "random": (MUTED, ":"),
    "sobol": (MUTED, "--"),
    PAPER: ("#d1495b", "-"),
    "optuna-tpe": ("#e8a317", "-"),
    PEER: ("#3b5fc0", "-"),
    "cma-es": ("#8d5a97", "--"),
}
"""Colour and dashes of each method."""


def cells(row: Row) -> list[str]:
    """A row of the table as text."""
    return [
        row.problem,
        row.method,
        str(row.median),
        f"{row.quartiles[0]:.3g} to {row.quartiles[1]:.3g}",
        number(row.visited),
        "-" if row.beats_paper is None else f"{row.beats_paper:.0%}",
        "-" if row.to_peer is None else str(row.to_peer),
        number(row.seconds, 2),
    ]


def table(results: Results) -> Table:
    """The table for a terminal."""
    made = Table(
        box=SIMPLE, title=f"{len(results.seeds)} seeds; [ ] are 90 % bootstrap intervals", title_justify="left"
    )
    for column in COLUMNS:
        made.add_column(column, no_wrap=column in COLUMNS[:2])
    last = ""
    for row in results.rows():
        if last and row.problem != last:
            made.add_section()
        last = row.problem
        # rich would take [0.1, 0.2] for a style
        made.add_row(*(cell.replace("[", r"\[") for cell in cells(row)), style="bold" if row.method == OURS else "")
    return made


def slowdown_lines(results: Results) -> list[str]:
    """Sentences on regret with several workers, one for each method and number of workers."""
    lines = []
    for method in results.methods:
        for workers in results.workers:
            ratios = results.slowdown(method, workers) if workers > 1 else {}
            if ratios:
                each = ", ".join(f"{name} {ratio}" for name, ratio in ratios.items())
                lines.append(f"{method}, {workers} workers, regret over that of one: {each}")
    return lines


def suggestion_lines(seconds: Mapping[tuple[str, str], float]) -> list[str]:
    """One line for each method and problem."""
    return [f"{m} on {p}: {value:.2f} s for a suggestion at 100 trials" for (m, p), value in seconds.items()]


def bar_lines(bars: Sequence[Bar]) -> list[str]:
    """One line for each bar."""
    return [f"{'met   ' if bar.met else 'MISSED'} {bar.text}: {bar.measured}" for bar in bars]


def curves(results: Results) -> Figure:
    """Median regret against evaluations on each problem, with the quartiles of codesign-bo."""
    columns = min(3, len(results.problems) + 1)
    rows = -(-(len(results.problems) + 1) // columns)
    made, axes = figure(3.7 * columns, 3.1 * rows, rows, columns)
    for ax, problem in zip(axes, results.problems, strict=False):
        _curves_on(ax, results, problem)
    for ax in axes[len(results.problems) :]:
        ax.axis("off")
    handles, labels = axes[0].get_legend_handles_labels()
    axes[len(results.problems)].legend(handles, labels, loc="center left", frameon=False, fontsize=10, labelcolor=INK)
    return made


def _curves_on(ax: Axes, results: Results, problem: str) -> None:
    for method in results.methods:
        if not results.of(method, problem):
            continue
        low, middle, high = results.curve(method, problem)
        x = np.arange(1, len(middle) + 1)
        colour, dashes = LOOKS.get(method, (INK, "-."))
        own = method == OURS
        ax.plot(x, middle, dashes, color=colour, linewidth=2.4 if own else 1.5, label=method, zorder=3 if own else 2)
        if own:
            ax.fill_between(x, low, high, where=np.isfinite(high).tolist(), color=colour, alpha=0.13, linewidth=0)
    ax.set_yscale("log")
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    ax.yaxis.set_minor_formatter(NullFormatter())
    label(ax, "evaluations", "median regret", problem)


def write(
    folder: Path,
    results: Results,
    bars: Sequence[Bar],
    seconds: Mapping[tuple[str, str], float],
    command: str,
) -> None:
    """Write README.md, runs.jsonl and regret.png.

    Args:
        folder: Made if it is not there.
        results: Of the runs.
        bars: Of which the README tells.
        seconds: Of a suggestion at 100 trials, by method and problem.
        command: That makes it again.
    """
    folder.mkdir(parents=True, exist_ok=True)
    evaluations = len(next(iter(results.traces.values())).regret)
    lines = [
        "# bo",
        "",
        f"Regret of the design recommended after {evaluations} evaluations, {len(results.seeds)} seeds, the same noise "
        "for all methods; formulas are in `benchmarks/bo_problems.py`. [ ] are 90 % bootstrap intervals.",
        "",
        *(f"- {line}" for line in bar_lines(bars)),
        "",
        *_markdown([COLUMNS, *(cells(row) for row in results.rows())]),
        "",
        f"*Best visited* is the median of the lowest regret among the designs that were evaluated; *minus {PEER}* the "
        f"median over seeds of the difference in regret. {OURS} recommends the evaluated design with the best "
        "posterior mean, the others, Optuna's Gaussian process too, the best observed one. A failure counts as the "
        "worst score so far for those that know no failures. CPU seconds are of ask, tell and recommend together.",
        "",
        "![median regret against evaluations](regret.png)",
        "",
        *(f"- {line}" for line in slowdown_lines(results)),
        *(f"- {line}" for line in suggestion_lines(seconds)),
        *described(command, f"{results.seeds[0]} to {results.seeds[-1]}"),
        "- libraries: " + ", ".join(f"{name} {text}" for name, text in library_versions().items()),
    ]
    (folder / "README.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    text = "".join(record_line(job, trace) for job, trace in results.traces.items())
    (folder / "runs.jsonl").write_text(text, encoding="utf-8")
    curves(results).savefig(folder / "regret.png", dpi=150)


def _markdown(rows: Sequence[Sequence[str]]) -> list[str]:
    head, *body = rows
    return [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *body)]
