"""Scores of several policies side by side: as tables for people, and as data."""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Console
from rich.table import Table

from distill.evaluate import Score


def table_of(scores: Mapping[str, Score]) -> dict[str, object]:
    """Policy -> "all" and each thing that robots differ in -> means, as JSON data."""
    return {
        name: {"all": score.summary(), **{what: score.by(what) for what in score.groups}}
        for name, score in scores.items()
    }


def print_scores(console: Console, scores: Mapping[str, Score]) -> None:
    """Print the means of policies over all robots, then by terrain, body and so on."""
    console.print(_table("all robots", {name: {"": score.summary()} for name, score in scores.items()}))
    first = next(iter(scores.values()))
    for what, groups in first.groups.items():
        if len(set(groups)) > 1:
            console.print(_table(f"by {what}", {name: score.by(what) for name, score in scores.items()}))


_FORMATS = {
    "robots": ("robots", "{:.0f}", 1.0),
    "return": ("return", "{:.3f}", 1.0),
    "tracking_error": ("tracking error, m/s", "{:.3f}", 1.0),
    "succeeded": ("succeeded", "{:.1f} %", 100.0),
    "survived": ("survived", "{:.1f} %", 100.0),
    "velocity_error": ("error of estimated velocity, m/s", "{:.3f}", 1.0),
}


def _table(title: str, rows: Mapping[str, Mapping[str, Mapping[str, float]]]) -> Table:
    """Policy -> group -> means, with the policies of a group below each other."""
    known = {key for groups in rows.values() for means in groups.values() for key in means}
    columns = [key for key in _FORMATS if key in known]
    grouped = any(group for groups in rows.values() for group in groups)
    table = Table(*(("group",) if grouped else ()), "policy", *(_FORMATS[key][0] for key in columns), title=title)
    for group in next(iter(rows.values())):
        for policy, groups in rows.items():
            means = groups[group]
            cells = [_FORMATS[key][1].format(means[key] * _FORMATS[key][2]) if key in means else "" for key in columns]
            table.add_row(*((group,) if grouped else ()), policy, *cells)
    return table
