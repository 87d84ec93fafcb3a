"""How good is a design found with 30 evaluations? codesign_bo against other optimisers, on known functions.

Every method sees the same problems, seeds and noise. Finished runs are kept in runs/bo, so a killed command goes on
where it stopped, and a change of the code runs again what it concerns. Prints a table and whether it is as good as
asked. With all methods and problems and at least 20 seeds the report is written to results/bo, otherwise beside the
runs.

    pip install -e "packages/codesign_bo[baselines]"
    python benchmarks/bo.py --quick
    python benchmarks/bo.py --workers 2 4 --suggest-time
"""

from __future__ import annotations

import logging
import os
import shlex
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
# not the folder of this file: it has a morphgen.py, which `import morphgen` would find
sys.path[0] = str(ROOT)
# runs go side by side, one thread each; read when numpy and torch are loaded, also by the processes started here
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import numpy as np
import tyro
from codesign_bo.baselines import OPTIMISERS
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from benchmarks.bo_problems import PROBLEMS
from benchmarks.bo_runs import Job, Records, run_all, suggestion_times
from benchmarks.bo_statistics import OURS, PEER, Results, bars

RUNS, RESULTS = ROOT / "runs" / "bo", ROOT / "results" / "bo"
FULL_SEEDS = 20


@dataclass(frozen=True)
class Benchmark:
    """Options."""

    seeds: int = FULL_SEEDS
    """Seeds 0 to this, less one."""
    quick: bool = False
    """5 seeds; within 10 minutes on 2 cores."""
    evaluations: int = 30
    methods: tuple[str, ...] = ("all",)
    """Names of optimisers, or `all`."""
    problems: tuple[str, ...] = ("all",)
    """Names of problems, or `all`."""
    workers: tuple[int, ...] = ()
    """Also codesign-bo and Optuna's GPSampler with so many simulated workers, such as `2 4`."""
    suggest_time: bool = False
    """Also the time of a suggestion at 100 trials on one core, of the same two."""
    processes: int = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    """Runs at a time."""
    folder: Path = RUNS
    """Where finished runs are kept, and the report if it is not a full one."""

    def jobs(self) -> list[Job]:
        """All runs, seed by seed.

        Raises:
            ValueError: A method or problem is unknown, or a number is out of range.
        """
        methods = _chosen("method", self.methods, OPTIMISERS)
        problems = _chosen("problem", self.problems, PROBLEMS)
        seeds = 5 if self.quick else self.seeds
        if min(seeds, self.evaluations, self.processes, *(n - 1 for n in self.workers)) < 1:
            raise ValueError("seeds, evaluations and processes must be at least 1, workers at least 2")
        kinds = [(method, 1) for method in methods]
        kinds += [(method, n) for n in dict.fromkeys(self.workers) for method in (OURS, PEER) if method in methods]
        return [
            Job(method, problem, seed, self.evaluations, workers)
            for seed in range(seeds)
            for problem in problems
            for method, workers in kinds
        ]

    @property
    def report(self) -> Path:
        """Where the report goes: to the results if nothing was left out."""
        everything = self.methods == ("all",) and self.problems == ("all",)
        full = everything and not self.quick and self.seeds >= FULL_SEEDS and self.evaluations == 30
        return RESULTS if full else self.folder


def _chosen(kind: str, names: tuple[str, ...], known: Mapping[str, object]) -> list[str]:
    if names == ("all",):
        return list(known)
    unknown = [name for name in names if name not in known]
    if unknown or not names:
        raise ValueError(f"unknown {kind} {unknown}; choose `all` or from {', '.join(known)}")
    return list(dict.fromkeys(names))


def execute(jobs: list[Job], options: Benchmark, console: Console) -> Results:
    """All runs, those on record included, with progress on the console."""
    columns = (TextColumn("{task.description:36}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    records = Records(options.folder / "records.jsonl")
    with Progress(*columns, TextColumn("left"), TimeRemainingColumn(), console=console) as progress:
        task = progress.add_task("runs", total=len(jobs))

        def finished(job: Job) -> None:
            progress.update(task, advance=1, description=f"{job.problem}, {job.method}, seed {job.seed}")

        try:
            traces = run_all(jobs, records, options.processes, finished)
        except KeyboardInterrupt:
            sys.exit(f"interrupted; finished runs are in {records.path}, and the same command goes on")
    return Results({job: traces[job] for job in jobs})


def time_asks(results: Results, console: Console) -> dict[tuple[str, str], float]:
    """Median seconds of a suggestion at 100 trials, by method and problem, of codesign-bo and its peer."""
    methods = [method for method in (OURS, PEER) if method in results.methods]
    problems = [problem for problem in ("noisy-hartmann4", "hartmann6") if problem in results.problems]
    with console.status("time of a suggestion at 100 trials"):
        return {(m, p): float(np.median(seconds)) for m, p, seconds in suggestion_times(methods, problems)}


def main() -> None:
    """Run, print and write."""
    options, console = tyro.cli(Benchmark, description=__doc__), Console()
    if not console.is_terminal:
        console.width = 150
    logging.disable(logging.INFO)  # Optuna tells of each study
    try:
        jobs = options.jobs()
        for method in dict.fromkeys(job.method for job in jobs):
            OPTIMISERS[method](PROBLEMS["ackley4"].space(0), 0)
    except (ValueError, ImportError) as error:
        sys.exit(str(error))
    results = execute(jobs, options, console)
    seconds = time_asks(results, console) if options.suggest_time else {}

    # only here, for the processes that run the optimisers import this file, too
    from benchmarks.bo_report import bar_lines, slowdown_lines, suggestion_lines, table, write

    found = bars(results, {problem: value for (method, problem), value in seconds.items() if method == OURS})
    console.print(table(results))
    for line in (*slowdown_lines(results), *suggestion_lines(seconds), *bar_lines(found)):
        console.print(line, markup=False, highlight=False)
    write(options.report, results, found, seconds, shlex.join(["python", "benchmarks/bo.py", *sys.argv[1:]]))
    console.print(f"report in {options.report}", markup=False, highlight=False)


if __name__ == "__main__":
    main()
