"""Four workers optimise a noisy function. Kill this whenever you like, by kill -9 too, and start it again."""

import time

import numpy as np
from codesign_bo import BoxSpace, EvalRequest, EvalResult, Study
from codesign_bo.executors import LocalExecutor


def evaluate(request: EvalRequest) -> EvalResult:
    """Score a design: mean and standard error of 16 noisy episodes."""
    time.sleep(1.0)
    x = np.array(list(request.params.values()))
    if x.sum() > 2.7:
        return EvalResult.failure("infeasible", "the robot hits the ceiling")
    returns = np.random.default_rng((request.seed, request.trial)).normal(10.0 - 25.0 * np.sum((x - 1.2) ** 2), 1.0, 16)
    return EvalResult(mean=returns.mean(), sem=returns.std(ddof=1) / 4.0, n=16)


if __name__ == "__main__":
    from codesign_bo.plots import write_report  # not above: each worker imports this file, and draws nothing

    space = BoxSpace.box(["thigh", "shank"], low=0.6, high=1.4, nominal=1.0)
    with Study(space, "four_workers/study.sqlite", seed=1) as study, LocalExecutor(slots=4, timeout=600) as executor:
        study.run(evaluate, until=20, executor=executor, progress=True)  # a total: started again, it does the rest
        study.confirm(evaluate, top_k=1, repeats=3, executor=executor)
        print(study.recommend().sentence())
        print(write_report(study, "four_workers/plots").page)
