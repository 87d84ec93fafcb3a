"""Ask/tell Bayesian optimisation for tens of expensive, noisy, killable evaluations."""

from codesign_bo.confirm import Confirmation, Gain
from codesign_bo.errors import StudyError
from codesign_bo.interfaces import Callback, EvalRequest, EvalResult
from codesign_bo.records import ConfirmationRecord, QueuedRecord, ScreeningRecord, TrialRecord
from codesign_bo.space import BoxSpace, Feasible, Parameter, sobol_designs
from codesign_bo.study import Study
from codesign_bo.view import Estimate, Slice, StudyView, open_study

__all__ = [
    "BoxSpace",
    "Callback",
    "Confirmation",
    "ConfirmationRecord",
    "Estimate",
    "EvalRequest",
    "EvalResult",
    "Feasible",
    "Gain",
    "Parameter",
    "QueuedRecord",
    "ScreeningRecord",
    "Slice",
    "Study",
    "StudyError",
    "StudyView",
    "TrialRecord",
    "open_study",
    "sobol_designs",
]
