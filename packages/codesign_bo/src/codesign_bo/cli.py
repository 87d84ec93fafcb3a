"""`codesign_bo`: look at a study, draw it, go on with it, write it to JSON, read it back."""

from __future__ import annotations

import importlib
import math
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from codesign_bo.errors import StudyError
from codesign_bo.exchange import export_study, import_study
from codesign_bo.executors.local import LocalExecutor
from codesign_bo.records import TrialRecord
from codesign_bo.running.evaluation import InProcess
from codesign_bo.running.progress import design, duration
from codesign_bo.seeing import plot, print_health
from codesign_bo.study import Study
from codesign_bo.view import StudyView, open_study


def status(study: tyro.conf.Positional[Path]) -> None:
    """Print the trials, the best design, its gain over the nominal one, and the study's health.

    Args:
        study: The SQLite file of a study, which may be running.
    """
    console = Console()
    with open_study(study) as view:
        console.print(_trial_table(view))
        _print_counts(view, console)
        if any(t.ok for t in view.trials()):
            _print_best(view, console)
        print_health(view, console)


def export(study: tyro.conf.Positional[Path], out: tyro.conf.Positional[Path]) -> None:
    """Write a study to a JSON file.

    Args:
        study: The SQLite file.
        out: The JSON file; replaced if it exists.
    """
    with open_study(study) as view:
        export_study(view, out)


def import_(source: tyro.conf.Positional[Path], study: tyro.conf.Positional[Path]) -> None:
    """Make a study file from an exported JSON file, also of an older version.

    Args:
        source: The JSON file.
        study: The SQLite file, which must not exist.
    """
    import_study(source, study)


def resume(
    study: tyro.conf.Positional[Path],
    callback: tyro.conf.Positional[str],
    until: int = 30,
    slots: int = 1,
    timeout: float | None = None,
    memory_gb: float | None = None,
    gpus: tuple[str, ...] = (),
    feasible: str | None = None,
    workdir: Path | None = None,
    retry_failed: bool = False,
) -> None:
    """Go on with a study: its space and settings are in the file, functions are not.

    Stop it with Ctrl-C; the same command goes on again.

    Args:
        study: The SQLite file.
        callback: What evaluates a design, as `package.module:function`; also found in the present folder.
        until: Total number of finished trials.
        slots: Evaluations at once, each in a process of its own; 0 evaluates in this process.
        timeout: Longest time (s) of one evaluation, with slots.
        memory_gb: Most memory (GB) of one evaluation with all that it starts, with slots.
        gpus: GPUs of each slot, such as `--gpus 0 1` or `--gpus 0,1 2,3`; more slots than entries share them.
        feasible: The feasibility predicate, as `package.module:function`, if the study was made with one.
        workdir: Folder for evaluations, if not `trials` beside the file.
        retry_failed: Try failed trials again first.
    """
    evaluate = _load(callback)
    predicate = None if feasible is None else _load(feasible)
    memory = None if memory_gb is None else round(1e9 * memory_gb)
    before = signal.signal(signal.SIGTERM, _interrupt)  # what clusters send before they kill
    try:
        with (
            Study.resume(study, predicate, workdir) as opened,
            LocalExecutor(slots, timeout, memory, gpus) if slots else InProcess() as executor,
        ):
            if retry_failed:
                opened.retry_failed()
            opened.run(evaluate, until, executor, progress=True)
    except KeyboardInterrupt:
        print("stopped; the same command goes on from here", file=sys.stderr)
        raise SystemExit(130) from None
    finally:
        signal.signal(signal.SIGTERM, before)
    status(study)


def main(args: Sequence[str] | None = None) -> None:
    """Run the command line."""
    try:
        tyro.extras.subcommand_cli_from_dict(
            {"status": status, "show": status, "plot": plot, "export": export, "import": import_, "resume": resume},
            prog="codesign_bo",
            description="Durable Bayesian optimisation studies.",
            args=args,
        )
    except StudyError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(1) from error


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt


def _load(name: str) -> Callable[..., Any]:
    """Return what `package.module:function` names.

    Raises:
        StudyError: There is no such thing.
    """
    module, _, attribute = name.partition(":")
    if not module or not attribute:
        raise StudyError(f"{name!r} names no function; write package.module:function")
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        found: Any = importlib.import_module(module)
        for part in attribute.split("."):
            found = getattr(found, part)
    except (ImportError, AttributeError) as error:
        raise StudyError(f"cannot load {name} ({error}); start where its module can be imported") from error
    if not callable(found):
        raise StudyError(f"{name} is a {type(found).__name__}, not a function")
    return found


def _trial_table(view: StudyView) -> Table:
    objectives = ", ".join(f"{name} ({way})" for name, way in view.objectives.items())
    also = f", also {escape(objectives)}" if objectives else ""
    table = Table(title=f"{view.path} (seed {view.seed}, {'max' if view.maximize else 'min'}imise{also})")
    for name in ("trial", "origin", *view.space.names, "mean", "sem", "n", *view.objectives, "status", "time"):
        table.add_column(escape(name), justify="left" if name in ("origin", "status") else "right")
    for t in view.trials():
        values = [_cell(v) for v in t.params.values()]
        further = [_cell(t.result.extras[name]) if t.result and t.ok else "-" for name in view.objectives]
        seconds = "-" if t.seconds is None else duration(t.seconds)
        table.add_row(str(t.trial), t.origin, *values, *_score(t), *further, t.status, seconds)
    return table


def _cell(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else escape(str(value))


def _score(trial: TrialRecord) -> tuple[str, str, str]:
    result = trial.result
    if result is None or not result.ok:
        return ("-", "-", "-")
    return (f"{result.mean:.4g}", "-" if result.sem is None else f"{result.sem:.2g}", str(result.n))


def _print_counts(view: StudyView, console: Console) -> None:
    trials = view.trials()
    words = [f"{sum(t.result is not None for t in trials)} trials finished"]
    failed = sum(t.failed for t in trials)
    unfinished = sum(t.result is None for t in trials)
    words += [f"{failed} of them failed"] if failed else []
    words += [f"{unfinished} unfinished"] if unfinished else []
    imported = len(view.history())
    words += [f"{imported} imported from other studies"] if imported else []
    savings = view.savings()
    if savings.stopped:
        words.append(f"{savings.stopped} stopped early, which saved {savings.share:.0%} of the cost")
    console.print(", ".join(words), highlight=False)


def _print_best(view: StudyView, console: Console) -> None:
    ranking = view.ranking()
    best = ranking[0]
    console.print(f"best of the search: trial {best.trial} ({escape(design(best.params))})")
    console.print(f"  posterior mean {best.mean:.4g} ± {best.std:.2g}")
    nominal = next((e for e in ranking if e.trial == 0), None)
    if nominal is not None:
        console.print(f"  nominal design: posterior mean {nominal.mean:.4g} ± {nominal.std:.2g}")
    confirmation = view.confirmation()
    for gain in confirmation.gains:
        share, low, high = gain.relative
        odds = "" if math.isnan(gain.probability) else f", better with probability {gain.probability:.1%}"
        console.print(
            f"trial {gain.trial} on {gain.repeats} fresh seeds: gain over nominal {gain.gain:.4g} "
            f"\\[{gain.low:.4g}, {gain.high:.4g}], {share:+.1%} \\[{low:+.1%}, {high:+.1%}]"
            f" at {confirmation.level:.0%}{odds}"
        )
    if not confirmation.gains:
        console.print("gain over nominal: not confirmed on fresh seeds yet")
    if confirmation.failed:
        console.print(f"failed or unfinished confirmation: trials {list(confirmation.failed)}")
    console.print(escape(view.recommend().sentence()))
