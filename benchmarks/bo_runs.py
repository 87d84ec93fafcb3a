"""One run of an optimiser on a problem with simulated workers, and many runs at once that may be killed."""

from __future__ import annotations

import functools
import hashlib
import heapq
import inspect
import json
import logging
import math
import multiprocessing
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import codesign_bo
import numpy as np
from codesign_bo.baselines import OPTIMISERS, Baseline, Optimiser, StudyOptimiser, make_optimiser
from codesign_bo.space import BoxSpace, Value, sobol_points

from benchmarks import bo_problems
from benchmarks.bo_problems import PROBLEMS, Problem

LIBRARIES = ("numpy", "scipy", "torch", "gpytorch", "botorch", "hyperopt", "optuna", "cma")
"""Distributions on which a run depends."""


@dataclass(frozen=True)
class Job:
    """One run.

    Attributes:
        method: Name of the optimiser.
        problem: Name of the problem.
        seed: Of the optimiser, of the noise and of the evaluation times.
        evaluations: How many designs are evaluated.
        workers: How many are evaluated at a time.
    """

    method: str
    problem: str
    seed: int
    evaluations: int = 30
    workers: int = 1


@dataclass(frozen=True)
class Trace:
    """What happened, after each of n evaluations.

    Attributes:
        regret: True regret of the design recommended then (n,), infinite while there is none.
        visited: True regret of the design evaluated (n,), infinite where the evaluation failed.
        seconds: Mean processor time (s) that the optimiser takes for an evaluation: ask, tell and recommend.
    """

    regret: tuple[float, ...]
    visited: tuple[float, ...]
    seconds: float


def simulate(optimiser: Optimiser, problem: Problem, seed: int, evaluations: int, workers: int = 1) -> Trace:
    """Let workers evaluate what `optimiser` asks for, in simulated time.

    The k-th design asked for takes the k-th evaluation time of this seed and, for its noise, the k-th standard normal
    number, whoever asks. With one worker, evaluations follow one another.

    Args:
        optimiser: A new one.
        problem: To be maximised.
        seed: Of noise and evaluation times, which are log-normal with a spread of 0.5.
        evaluations: How many designs are evaluated in all.
        workers: How many are evaluated at a time.
    """
    draws = np.random.default_rng((seed, 0)).standard_normal(evaluations)
    durations = np.random.default_rng((seed, 2)).lognormal(0.0, 0.5, evaluations)
    busy: list[tuple[float, int, Mapping[str, Value]]] = []
    regret: list[float] = []
    visited: list[float] = []
    asked, now, spent = 0, 0.0, 0.0
    while len(regret) < evaluations:
        started = time.process_time()
        while asked < evaluations and len(busy) < workers:
            heapq.heappush(busy, (now + durations[asked], asked, optimiser.ask()))
            asked += 1
        spent += time.process_time() - started
        now, number, params = heapq.heappop(busy)
        score = problem.evaluate(params, draws[number])
        started = time.process_time()
        optimiser.tell(params, score.mean, score.sem)
        try:
            recommended = optimiser.recommend()
        except LookupError:
            recommended = None
        spent += time.process_time() - started
        regret.append(math.inf if recommended is None else problem.regret(recommended))
        visited.append(problem.regret(params))
    return Trace(tuple(regret), tuple(visited), spent / evaluations)


def run(job: Job) -> Trace:
    """Run one job."""
    problem = PROBLEMS[job.problem]
    optimiser = make_optimiser(job.method, problem.space(job.seed), job.seed)
    return simulate(optimiser, problem, job.seed, job.evaluations, job.workers)


def time_suggestions(method: str, problem: str, trials: int = 100, repeats: int = 5) -> list[float]:
    """Processor time (s) of each of `repeats` asks in turns with tells, once `trials` designs are told."""
    function, draws = PROBLEMS[problem], np.random.default_rng(0).standard_normal(trials + repeats)
    optimiser = make_optimiser(method, function.space(0), 0)
    seconds = []
    for draw in draws:
        started = time.process_time()
        params = optimiser.ask()
        seconds.append(time.process_time() - started)
        optimiser.tell(params, *function.evaluate(params, draw))
    return seconds[trials:]


def library_versions() -> dict[str, str]:
    """Versions of the libraries on which a run depends, of those that are installed."""
    found = {}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


@functools.cache
def fingerprint(method: str) -> str:
    """Digest of the code that a run of `method` depends on, and of the libraries' versions."""
    factory = OPTIMISERS[method]
    if factory is StudyOptimiser:
        files = {*Path(inspect.getfile(codesign_bo)).parent.rglob("*.py")}
    else:
        files = {Path(inspect.getfile(part)) for part in (factory, Baseline, BoxSpace, sobol_points)}
    digest = hashlib.sha256(json.dumps(library_versions()).encode())
    for file in sorted(files | {Path(__file__), Path(bo_problems.__file__)}):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


class Records:
    """Finished runs, one JSON object a line; a line that was cut short by a kill is passed over.

    Args:
        path: Of the file; made, with its folder, when the first run is added.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def load(self, jobs: Iterable[Job]) -> dict[Job, Trace]:
        """The finished ones of `jobs`, if the code of their method is still the same."""
        wanted = set(jobs)
        valid = {method: fingerprint(method) for method in {job.method for job in wanted}}
        found = {}
        for line in self.path.read_text(encoding="utf-8").splitlines() if self.path.is_file() else ():
            try:
                row = json.loads(line)
            except ValueError:
                continue
            job, trace = Job(**row["job"]), row["trace"]
            if job in wanted and row["fingerprint"] == valid[job.method]:
                regret, visited = ([math.inf if r is None else r for r in trace[key]] for key in ("regret", "visited"))
                found[job] = Trace(tuple(regret), tuple(visited), trace["seconds"])
        return found

    def add(self, job: Job, trace: Trace) -> None:
        """Append a run."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a+b") as file:
            if file.tell() and not _ends_a_line(file.name):
                file.write(b"\n")
            file.write(record_line(job, trace).encode())


def record_line(job: Job, trace: Trace) -> str:
    """One line of the file of records; no regret is null."""
    regret, visited = ([None if math.isinf(r) else round(r, 9) for r in row] for row in (trace.regret, trace.visited))
    row = {
        "job": asdict(job),
        "fingerprint": fingerprint(job.method),
        "trace": {"regret": regret, "visited": visited, "seconds": round(trace.seconds, 5)},
    }
    return json.dumps(row, allow_nan=False) + "\n"


def _ends_a_line(path: str) -> bool:
    with open(path, "rb") as file:
        file.seek(-1, 2)
        return file.read(1) == b"\n"


def run_all(jobs: Sequence[Job], records: Records, processes: int, finished: Callable[[Job], None]) -> dict[Job, Trace]:
    """Run what is not on record, each in a process with one thread, and put it on record at once.

    Args:
        jobs: All runs that are wanted.
        records: Of earlier ones.
        processes: How many run at a time.
        finished: Called with each as it finishes, those on record first.
    """
    traces = records.load(jobs)
    for job in traces:
        finished(job)
    missing = [job for job in jobs if job not in traces]
    with _pool(min(processes, max(1, len(missing)))) as pool:
        futures = {pool.submit(run, job): job for job in missing}
        try:
            for future in as_completed(futures):
                job = futures[future]
                try:
                    traces[job] = future.result()
                except Exception as error:
                    error.add_note(f"in {job}; all finished runs are in {records.path}")
                    raise
                records.add(job, traces[job])
                finished(job)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return traces


def suggestion_times(methods: Sequence[str], problems: Sequence[str]) -> Iterator[tuple[str, str, list[float]]]:
    """Method, problem and `time_suggestions` of each pair, one after the other in a process with one thread."""
    with _pool(1) as pool:
        for problem in problems:
            for method in methods:
                yield method, problem, pool.submit(time_suggestions, method, problem).result()


def _pool(processes: int) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(processes, multiprocessing.get_context("spawn"), _prepare)


def _prepare() -> None:
    import torch

    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    logging.disable(logging.WARNING)
