"""`codesign_bo`: look at a study, write it to JSON, read it back."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from codesign_bo.errors import StudyError
from codesign_bo.exchange import export_study, import_study
from codesign_bo.interfaces import EvalResult
from codesign_bo.view import StudyView, open_study


def show(study: tyro.conf.Positional[Path]) -> None:
    """Print the trials, the best design and its gain over the nominal one.

    Args:
        study: The SQLite file of a study, which may be running.
    """
    console = Console()
    with open_study(study) as view:
        console.print(_trial_table(view))
        if any(t.ok for t in view.trials()):
            _print_best(view, console)


def export(study: tyro.conf.Positional[Path], out: tyro.conf.Positional[Path]) -> None:
    """Write a study to a JSON file.

    Args:
        study: The SQLite file.
        out: The JSON file; replaced if it exists.
    """
    with open_study(study) as view:
        export_study(view, out)


def import_(source: tyro.conf.Positional[Path], study: tyro.conf.Positional[Path]) -> None:
    """Make a study file from an exported JSON file.

    Args:
        source: The JSON file.
        study: The SQLite file, which must not exist.
    """
    import_study(source, study)


def main(args: Sequence[str] | None = None) -> None:
    """Run the command line."""
    try:
        tyro.extras.subcommand_cli_from_dict(
            {"show": show, "export": export, "import": import_},
            prog="codesign_bo",
            description="Durable Bayesian optimisation studies.",
            args=args,
        )
    except StudyError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(1) from error


def _trial_table(view: StudyView) -> Table:
    table = Table(title=f"{view.path} (seed {view.seed}, {'max' if view.maximize else 'min'}imise)")
    for name in ("trial", "origin", *view.space.names, "mean", "sem", "n", "status"):
        table.add_column(name, justify="left" if name in ("origin", "status") else "right")
    for t in view.trials():
        values = [f"{v:.4g}" for v in t.params.values()]
        table.add_row(str(t.trial), t.origin, *values, *_score(t.result), t.status)
    return table


def _score(result: EvalResult | None) -> tuple[str, str, str]:
    if result is None or not result.ok:
        return ("-", "-", "-")
    return (f"{result.mean:.4g}", "-" if result.sem is None else f"{result.sem:.2g}", str(result.n))


def _print_best(view: StudyView, console: Console) -> None:
    ranking = view.ranking()
    best = ranking[0]
    design = ", ".join(f"{name}={value:.4g}" for name, value in best.params.items())
    console.print(f"best of the search: trial {best.trial} ({escape(design)})")
    console.print(f"  posterior mean {best.mean:.4g} ± {best.std:.2g}")
    nominal = next((e for e in ranking if e.trial == 0), None)
    if nominal is not None:
        console.print(f"  nominal design: posterior mean {nominal.mean:.4g} ± {nominal.std:.2g}")
    confirmation = view.confirmation()
    for gain in confirmation.gains:
        share, low, high = gain.relative
        console.print(
            f"trial {gain.trial} on {gain.repeats} fresh seeds: gain over nominal {gain.gain:.4g} "
            f"\\[{gain.low:.4g}, {gain.high:.4g}], {share:+.1%} \\[{low:+.1%}, {high:+.1%}]"
            f" at {confirmation.level:.0%}"
        )
    if not confirmation.gains:
        console.print("gain over nominal: not confirmed on fresh seeds yet")
    if confirmation.failed:
        console.print(f"failed or unfinished confirmation: trials {list(confirmation.failed)}")
