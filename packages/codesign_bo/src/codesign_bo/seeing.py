"""What the command line shows of a study beyond its tables: pictures and health."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro
from rich.console import Console
from rich.markup import escape

from codesign_bo.errors import StudyError
from codesign_bo.view import StudyView, open_study

if TYPE_CHECKING:  # models and pictures are imported where they are used: they take seconds
    from codesign_bo.health import Check, Severity

PictureName = Literal["convergence", "slices", "landscape", "pairs", "sensitivity", "calibration", "pareto", "timeline"]

_STYLES: dict[Severity, str] = {"error": "bold red", "warning": "yellow", "info": "blue", "ok": "green"}


def plot(
    study: tyro.conf.Positional[Path],
    out: Path | None = None,
    only: tuple[PictureName, ...] = (),
    objective: str = "objective",
    unit: tuple[str, ...] = (),
) -> None:
    """Draw a study: PNG files, and one page that shows them all with its health.

    Args:
        study: The SQLite file of a study, which may be running.
        out: Folder for the pictures and `index.html`; by default `<study>-plots` beside the file.
        only: Pictures to draw; all by default.
        objective: Name of the objective on the axes, with its unit.
        unit: Units of parameters and further objectives, such as `thigh=m`.
    """
    units = {name: word for name, _, word in (part.partition("=") for part in unit)}
    if not all(units.values()):
        raise StudyError(f"--unit {' '.join(unit)}: write name=unit, such as thigh=m")
    try:
        from codesign_bo.plots import Labels, write_report
    except ImportError as error:
        raise StudyError(str(error)) from error
    console = Console()
    with open_study(study) as view:
        unknown = [n for n in units if n not in (*view.space.names, *view.objectives)]
        if unknown:
            known = [*view.space.names, *view.objectives]
            raise StudyError(f"--unit names {unknown}, which {study} does not have; it has {known}")
        folder = view.path.with_name(f"{view.path.stem}-plots") if out is None else out
        report = write_report(view, folder, only, Labels(objective, units))
    for name, sentence in report.sentences.items():
        console.print(f"[bold]{name}[/bold]: {escape(sentence)}", highlight=False)
    for name, reason in report.missing.items():
        console.print(f"[dim]{name}: not drawn, {escape(reason)}[/dim]", highlight=False)
    console.print(f"wrote {report.page}", markup=False, highlight=False, soft_wrap=True)


def print_health(view: StudyView, console: Console) -> None:
    """Print what is not right with a study, the worst first, and how many checks passed."""
    from codesign_bo.health import health

    checks = health(view)
    for check in checks:
        if check.severity != "ok":
            console.print(_line(check), highlight=False)
    passed = sum(c.severity == "ok" for c in checks)
    console.print(f"health: {passed} of {len(checks)} checks without a finding", highlight=False)


def _line(check: Check) -> str:
    style = _STYLES[check.severity]
    way = f" [dim]{escape(check.way_out)}[/dim]" if check.way_out else ""
    return f"[{style}]{check.severity}[/{style}] {escape(check.name)}: {escape(check.sentence)}{way}"
