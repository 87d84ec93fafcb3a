"""Finished runs side by side: a page, and a table for the terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from deploy import LogError
from deploy.measure.account import account
from deploy.page.figures import compared_power
from deploy.page.style import BEST, INK, OTHERS, figure, label
from locorl.config import from_dict, leaves
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from morphgen import BodyFactory
from morphgen.views.drawing import draw_bodies
from rich.table import Table

from legged_codesign.choice import Choice
from legged_codesign.objective import physical
from legged_codesign.report.bodies import length_rows
from legged_codesign.report.confirmation import confirmed_rows
from legged_codesign.report.data import RunData, read_run
from legged_codesign.report.page import Picture, number, render
from legged_codesign.robots import BodyConfig, body_factory
from legged_codesign.stages import RunError, write_text

COLOURS = (BEST, *OTHERS)


@dataclass(frozen=True)
class Run:
    """One of the runs that are compared.

    Attributes:
        name: that tells it from the others.
        data: what it left on disk.
        choice: the body that it settled on.
        rows: nominal and confirmed bodies (see `confirmed_rows`).
    """

    name: str
    data: RunData
    choice: Choice
    rows: Sequence[Mapping[str, Any]]

    @property
    def objective(self) -> Any:
        """What its bodies were scored by."""
        return self.data.settings["objective"]

    def row(self, trial: int) -> Mapping[str, Any]:
        """The confirmed body of a trial."""
        return next(row for row in self.rows if row["trial"] == trial)


def read_runs(folders: Sequence[Path]) -> list[Run]:
    """Read the runs to compare.

    Raises:
        RunError: there are fewer than two, a folder is given twice or holds no run that has chosen a body.
    """
    if len(folders) < 2:
        raise RunError("a comparison needs at least two run folders: codesign compare RUN RUN")
    twice = [str(folder) for folder, count in Counter(f.resolve() for f in folders).items() if count > 1]
    if twice:
        raise RunError(f"{twice[0]} is given twice; give two different run folders")
    runs = []
    for folder, name in zip(folders, _names(folders), strict=True):
        data = read_run(folder)
        if data.choice is None or not data.gains:
            raise RunError(
                f"{folder} has not chosen a body yet (choice.json or its study is missing); finish it with its command"
                + (f": {data.command}" if data.command else "")
            )
        runs.append(Run(name, data, data.choice, confirmed_rows(data, data.settings["objective"])))
    return runs


def _names(folders: Sequence[Path]) -> list[str]:
    """The last parts of the paths that tell them apart."""
    paths = [folder.resolve().parts for folder in folders]
    for count in range(1, max(map(len, paths)) + 1):
        names = ["/".join(parts[-count:]) for parts in paths]
        if len(set(names)) == len(names):
            return names
    return [str(folder) for folder in folders]


def summary_table(runs: Sequence[Run]) -> Table:
    """For the terminal: what each run chose, how much better it is, and what stands beside the score."""
    table = Table(title="chosen against nominal, means over the fresh seeds")
    table.add_column("")
    for run in runs:
        table.add_column(run.name, justify="right", overflow="fold")
    for name, *values in summary_rows(runs):
        table.add_row(name, *values)
    return table


def summary_rows(runs: Sequence[Run]) -> list[list[str]]:
    """Rows of words, a column for each run, for the terminal and the page."""

    def each(words: str, value: Any) -> list[str]:
        return [words, *(value(run) for run in runs)]

    def extra(name: str, form: str) -> Any:
        def value(run: Run) -> str:
            both = (run.row(trial)["extras"].get(name) for trial in (0, run.choice.trial))
            return " → ".join(number(fact, form) for fact in both)

        return value

    def score(run: Run) -> str:
        both = (physical(mean, run.objective) for mean in (run.choice.nominal, run.choice.mean))
        return " → ".join(number(value, "%.4g") for value in both)

    def share(name: str) -> Any:
        def value(run: Run) -> str:
            rows = [run.row(trial) for trial in (0, run.choice.trial)]
            if any(np.isnan(row[name]) for row in rows):
                return "–"
            return " → ".join(f"{row[name]:.0f}/{row['robots']}" for row in rows)

        return value

    return [
        each("robot", lambda run: Path(run.data.settings["robot"]).stem),
        each("task", lambda run: str(run.data.settings.get("task", "–"))),
        each("objective", lambda run: run.objective),
        each("bodies in the search", lambda run: str(len(run.data.trials))),
        each("chosen body", _design),
        each("score", score),
        each("gain of the best searched body", _gain),
        each("fresh seeds", lambda run: str(run.choice.seeds)),
        each("return", extra("return", "%.2f")),
        each("energy, J", extra("energy", "%.0f")),
        each("cost of transport", extra("cost_of_transport", "%.3f")),
        each("tracking error, m/s", extra("tracking_error", "%.3f")),
        each("survived", share("survived")),
        each("through the course", share("succeeded")),
        each("minutes", lambda run: number(sum(run.data.stages.values()) / 60, "%.1f") if run.data.stages else "–"),
    ]


def _design(run: Run) -> str:
    if run.choice.trial == 0:
        return "the nominal one"
    return " ".join(f"{value:.2f}" for value in run.choice.params.values())


def _gain(run: Run) -> str:
    middle, low, high = (number(100 * value, "%+.1f") for value in (run.choice.gain, run.choice.low, run.choice.high))
    return f"{middle} % ({low} to {high})"


def differing(runs: Sequence[Run]) -> list[tuple[str, list[str]]]:
    """Settings that are not the same in all runs: name, and the value in each."""
    flat = [dict(leaves(run.data.settings)) for run in runs]
    names = sorted({name for settings in flat for name in settings})
    rows = [(name, [str(settings.get(name, "–")) for settings in flat]) for name in names]
    return [(name, values) for name, values in rows if len(set(values)) > 1]


def convergence(runs: Sequence[Run]) -> Figure:
    """Best score so far of each search, as the gain over its own nominal body's score in the search."""
    made, (ax,) = figure(9.2, 3.6)
    for run, colour in zip(runs, _colours(len(runs)), strict=True):
        numbers, gains = best_so_far(run.data)
        ax.step(numbers, 100 * gains, where="post", color=colour, linewidth=1.8, label=run.name)
    ax.axhline(0.0, color=INK, linewidth=1)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    label(ax, "trial", "best so far over nominal, %")
    made.legend(frameon=False, fontsize=9, ncols=min(len(runs), 3), loc="outside upper left")
    return made


def best_so_far(data: RunData) -> tuple[np.ndarray, np.ndarray]:
    """Trials with a score, and the best score up to each as a gain relative to trial 0; empty if that one failed."""
    scored = [(t.trial, t.result.mean) for t in data.trials if t.ok and t.result is not None]
    if not scored or scored[0][0] != 0 or scored[0][1] == 0.0:
        return np.array([]), np.array([])
    numbers, scores = (np.array(column) for column in zip(*scored, strict=True))
    return numbers, (np.maximum.accumulate(scores) - scores[0]) / abs(scores[0])


def gains(runs: Sequence[Run]) -> Figure:
    """Gain of each run's best searched body on fresh seeds, with its 95 % interval."""
    made, (ax,) = figure(9.2, 0.5 * len(runs) + 1.2)
    for y, (run, colour) in enumerate(zip(runs, _colours(len(runs)), strict=True)):
        middle, low, high = (100 * value for value in (run.choice.gain, run.choice.low, run.choice.high))
        ax.errorbar(
            middle, y, xerr=[[middle - low], [high - middle]], fmt="o", color=colour, capsize=4, linewidth=2, ms=7
        )
        ax.annotate(f"{middle:+.1f} %", (middle, y), (0, 8), textcoords="offset points", ha="center", fontsize=9)
    ax.axvline(0.0, color=INK, linewidth=1)
    ax.set_yticks(range(len(runs)), [run.name for run in runs], fontsize=9)
    ax.set_ylim(len(runs) - 0.5, -0.7)
    label(ax, "gain over the nominal body, %", "")
    return made


def power(runs: Sequence[Run]) -> Picture:
    """Power of the students over time (Fig. 9), of the runs whose log tells it."""
    accounts, names, colours, missing = [], [], [], []
    for run, colour in zip(runs, _colours(len(runs)), strict=True):
        try:
            if run.data.log is None:
                raise LogError(run.data.log_problem)
            accounts.append(account(run.data.log))
        except LogError as error:
            missing.append(f"{run.name}: {error}")
            continue
        names.append(run.name)
        colours.append(colour)
    words = f"Not shown: {'; '.join(missing)}." if missing else ""
    return Picture.of(compared_power(accounts, names, colours), words) if accounts else Picture("", words)


def _colours(count: int) -> list[str]:
    return [COLOURS[i % len(COLOURS)] for i in range(count)]


def _drawings(runs: Sequence[Run]) -> tuple[list[Picture], list[Mapping[str, Any]]]:
    """Chosen bodies of equal robots in one drawing at one scale; the dimensions of all in one table."""
    robots: dict[tuple[str, BodyConfig], list[Run]] = {}
    for run in runs:
        robots.setdefault(_robot(run), []).append(run)
    pictures, tables = [], []
    for (robot, rule), same in robots.items():
        factory = body_factory(robot, rule)
        bodies = np.array([_nominal(factory), *(run.choice.design(factory.space.names) for run in same)])
        titles = [f"nominal {factory.name}", *(run.name for run in same)]
        pictures.append(Picture.of(draw_bodies(factory, bodies, titles)))
        tables.append({"titles": titles, "rows": length_rows(factory, bodies)})
    return pictures, tables


def _robot(run: Run) -> tuple[str, BodyConfig]:
    settings = run.data.settings
    return settings["robot"], from_dict(BodyConfig, settings.get("bodies", {}))


def _nominal(factory: BodyFactory) -> np.ndarray:
    return np.asarray(factory.space.nominal, dtype=float)


def write_comparison(runs: Sequence[Run], out: Path) -> Path:
    """Write the page.

    Returns:
        Its path.
    """
    drawings, dimensions = _drawings(runs)
    objectives = {run.objective for run in runs}
    page = render(
        "compare.html.j2",
        runs=runs,
        summary=summary_rows(runs),
        sentences=[(run.name, run.choice.sentence(run.objective)) for run in runs],
        same_objective=len(objectives) == 1,
        differences=differing(runs),
        drawings=drawings,
        dimensions=dimensions,
        gains=Picture.of(gains(runs), "Gain of the best searched body on fresh seeds, with its 95 % interval."),
        convergence=Picture.of(convergence(runs), _convergence_words(runs)),
        power=power(runs),
    )
    write_text(out, page)
    return out


def _convergence_words(runs: Sequence[Run]) -> str:
    empty = [run.name for run in runs if not len(best_so_far(run.data)[0])]
    words = (
        "Best single score up to each trial, lucky noise included, over the score of the same search's nominal body; "
        "what counts is the gain on fresh seeds"
    )
    return words + (f". Not shown, as the nominal body has no score: {', '.join(empty)}." if empty else ".")
