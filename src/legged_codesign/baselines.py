"""Searches by other optimisers, to compare with: the same trials in the same storage, other proposals."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from codesign_bo import Study
from codesign_bo.baselines import make_optimiser
from codesign_bo.space import Value

from legged_codesign.stages import RunError

Params = dict[str, Value]
_TRIES = 10_000


def run_baseline(
    study: Study,
    method: str,
    total: int,
    batch: int,
    feasible: Callable[[Mapping[str, Value]], bool],
    run: Callable[[int], object],
) -> None:
    """Let another optimiser propose the trials of `study` after the nominal one, `batch` at a time.

    The optimiser is not stored. It is told again what the study knows, and proposes the same with the same seed.

    Args:
        study: keeps the trials.
        method: name of the optimiser, see `codesign_bo.baselines`.
        total: trials in all.
        batch: proposals before it hears of their scores.
        feasible: whether the design with these parameters has a stance.
        run: evaluates queued designs until so many trials are finished.

    Raises:
        RunError: the optimiser's library is not installed, or the study's trials are not its proposals.
    """
    run(1)
    while (finished := study.finished()) < total:
        begun = len(study.trials()) + sum(queued.trial is None for queued in study.queue())
        if begun == finished:
            fresh = propose(study, method, batch, feasible)[: total - begun]
            study.enqueue(fresh)
            begun += len(fresh)
        run(min(begun, total))


def propose(study: Study, method: str, batch: int, feasible: Callable[[Mapping[str, Value]], bool]) -> list[Params]:
    """What `method` proposes next, knowing all trials of `study` after the nominal one.

    Raises:
        RunError: its library is not installed, or the study's trials are not its proposals.
    """
    try:
        optimiser = make_optimiser(method, study.space, study.seed, study.maximize)
    except ImportError as error:
        raise RunError(f"the search method '{method}' is not installed: {error}") from error

    def ask() -> Params:
        for _ in range(_TRIES):
            proposed = optimiser.ask()
            if feasible(proposed):
                return dict(proposed)
            optimiser.tell(proposed, float("nan"), None)
        raise RunError(f"'{method}' proposed {_TRIES} bodies without a stance in a row; narrow --bounds")

    trials = study.trials()[1:]
    for start in range(0, len(trials), batch):
        for proposed, trial in zip([ask() for _ in range(batch)], trials[start : start + batch], strict=False):
            if proposed != dict(trial.params):
                raise RunError(
                    f"trial {trial.trial} of {study.path} is {dict(trial.params)}, but '{method}' proposes {proposed}: "
                    "go on with as many --workers and the library version of before, or choose another --folder"
                )
            scored = trial.result is not None and trial.result.ok
            optimiser.tell(proposed, trial.result.mean if scored and trial.result else float("nan"), None)
    return [ask() for _ in range(batch)]
