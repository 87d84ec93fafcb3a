"""Ask/tell Bayesian optimisation for tens of expensive, noisy, killable evaluations."""

import importlib
from typing import TYPE_CHECKING, Any

from codesign_bo.errors import DivergedError, ExecutorError, StudyError
from codesign_bo.interfaces import Callback, EvalRequest, EvalResult, Score

if TYPE_CHECKING:
    from codesign_bo.acquisition.pareto import ParetoFront
    from codesign_bo.confirm import Confirmation, Gain
    from codesign_bo.data import Observations, Viability
    from codesign_bo.history import Imported
    from codesign_bo.models.fidelity import Verdict
    from codesign_bo.recommend import Recommendation
    from codesign_bo.records import (
        AttemptRecord,
        ConfirmationRecord,
        HistoryRecord,
        QueuedRecord,
        ScoreRecord,
        ScreeningRecord,
        Told,
        TrialRecord,
    )
    from codesign_bo.space import (
        BoxSpace,
        Categorical,
        Continuous,
        Feasible,
        Integer,
        LinearConstraint,
        Parameter,
        Value,
        sobol_designs,
    )
    from codesign_bo.stopping import MedianStopping, Savings
    from codesign_bo.study import Study
    from codesign_bo.view import Estimate, Slice, StudyView, open_study

__all__ = [
    "AttemptRecord",
    "BoxSpace",
    "Callback",
    "Categorical",
    "Confirmation",
    "ConfirmationRecord",
    "Continuous",
    "DivergedError",
    "Estimate",
    "EvalRequest",
    "EvalResult",
    "ExecutorError",
    "Feasible",
    "Gain",
    "HistoryRecord",
    "Imported",
    "Integer",
    "LinearConstraint",
    "MedianStopping",
    "Observations",
    "Parameter",
    "ParetoFront",
    "QueuedRecord",
    "Recommendation",
    "Savings",
    "Score",
    "ScoreRecord",
    "ScreeningRecord",
    "Slice",
    "Study",
    "StudyError",
    "StudyView",
    "Told",
    "TrialRecord",
    "Value",
    "Verdict",
    "Viability",
    "open_study",
    "sobol_designs",
]

# Imported on first use: the process of an evaluation needs none of these, and torch takes seconds and 300 MB.
_LAZY = {
    "acquisition.pareto": ("ParetoFront",),
    "confirm": ("Confirmation", "Gain"),
    "data": ("Observations", "Viability"),
    "history": ("Imported",),
    "models.fidelity": ("Verdict",),
    "recommend": ("Recommendation",),
    "records": (
        "AttemptRecord",
        "ConfirmationRecord",
        "HistoryRecord",
        "QueuedRecord",
        "ScoreRecord",
        "ScreeningRecord",
        "Told",
        "TrialRecord",
    ),
    "space": (
        "BoxSpace",
        "Categorical",
        "Continuous",
        "Feasible",
        "Integer",
        "LinearConstraint",
        "Parameter",
        "Value",
        "sobol_designs",
    ),
    "stopping": ("MedianStopping", "Savings"),
    "study": ("Study",),
    "view": ("Estimate", "Slice", "StudyView", "open_study"),
}
_MODULES = {name: module for module, names in _LAZY.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
