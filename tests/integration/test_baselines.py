"""Searches by other optimisers: durable, feasible, resumed as they were."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from codesign_bo import BoxSpace, EvalRequest, EvalResult, Study
from codesign_bo.baselines import RandomSearch

from legged_codesign.baselines import run_baseline
from legged_codesign.config import SearchConfig
from legged_codesign.stages import RunError

SPACE = BoxSpace.box(["a", "b"], 0.0, 1.0, 0.5)


def low(params: Mapping[str, object]) -> bool:
    """Whether a design lies below the diagonal."""
    return float(params["a"]) + float(params["b"]) < 1.2  # pyright: ignore[reportArgumentType]


def score(request: EvalRequest) -> EvalResult:
    point = np.array([request.params["a"], request.params["b"]], dtype=float)
    return EvalResult(-float(((point - 0.3) ** 2).sum()), 0.01)


def trials(path: Path, method: str, total: int, batch: int = 1, seed: int = 3) -> list[dict[str, object]]:
    with Study(SPACE, path, seed=seed) as study:
        run_baseline(study, method, total, batch, low, lambda until: study.run(score, until=until, progress=False))
        return [dict(trial.params) for trial in study.trials()]


@pytest.mark.parametrize("method", ["random", "sobol", "optuna-tpe", "cma-es"])
def test_a_killed_search_goes_on_with_the_same_proposals(method: str, tmp_path: Path) -> None:
    whole = trials(tmp_path / "whole.sqlite", method, 9)
    for total in (1, 4, 5, 9):
        parts = trials(tmp_path / "parts.sqlite", method, total)
    assert parts == whole
    assert whole[0] == {"a": 0.5, "b": 0.5}
    assert all(map(low, whole))
    assert len({tuple(design.values()) for design in whole}) == 9


def test_random_is_random_search(tmp_path: Path) -> None:
    """The designs are those of the optimiser itself, infeasible ones left out."""
    optimiser = RandomSearch(SPACE, 3)
    drawn = [optimiser.ask() for _ in range(40)]
    expected = [dict(design) for design in drawn if low(design)][:5]
    assert trials(tmp_path / "study.sqlite", "random", 6)[1:] == expected


def test_batches(tmp_path: Path) -> None:
    in_threes = trials(tmp_path / "threes.sqlite", "random", 8, batch=3)
    assert in_threes == trials(tmp_path / "ones.sqlite", "random", 8)
    with Study(SPACE, tmp_path / "one.sqlite", seed=3) as study:
        asked: list[int] = []
        run_baseline(
            study,
            "random",
            8,
            3,
            low,
            lambda until: (asked.append(until), study.run(score, until=until, progress=False)),
        )
    assert asked == [1, 4, 7, 8]


def test_killed_within_a_batch(tmp_path: Path) -> None:
    """Trials that are queued or begun are finished before the optimiser is asked again."""
    path = tmp_path / "study.sqlite"
    with Study(SPACE, path, seed=3) as study, pytest.raises(KeyboardInterrupt):
        run_baseline(study, "random", 8, 3, low, interrupted(study, after=3))
    assert trials(path, "random", 8, batch=3) == trials(tmp_path / "whole.sqlite", "random", 8, batch=3)


def interrupted(study: Study, after: int) -> Callable[[int], object]:
    done = 0

    def once(request: EvalRequest) -> EvalResult:
        nonlocal done
        done += 1
        if done > after:
            raise KeyboardInterrupt
        return score(request)

    return lambda until: study.run(once, until=until, progress=False)


def test_trials_of_another_search_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "study.sqlite"
    trials(path, "sobol", 4)
    with pytest.raises(RunError, match=r"random.*proposes"):
        trials(path, "random", 6)


def test_a_baseline_knows_one_objective() -> None:
    with pytest.raises(ValueError, match="one objective"):
        SearchConfig(method="random", pareto=True)
