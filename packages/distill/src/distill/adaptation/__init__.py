"""What the student knows of body and motion without privileged state: estimator and history encoder."""

from distill.adaptation.estimation import VelocityEstimation
from distill.adaptation.fitting import FitConfig
from distill.adaptation.identification import Identification, identify, linear_probe
from distill.adaptation.modules import (
    AdaptationConfig,
    AdaptationModule,
    AdaptedTeacher,
    build_adaptation,
    load_adaptation,
    save_adaptation,
)
from distill.adaptation.roa import RegularisedAdaptation
from distill.adaptation.schedule import RoaSchedule

__all__ = [
    "AdaptationConfig",
    "AdaptationModule",
    "AdaptedTeacher",
    "FitConfig",
    "Identification",
    "RegularisedAdaptation",
    "RoaSchedule",
    "VelocityEstimation",
    "build_adaptation",
    "identify",
    "linear_probe",
    "load_adaptation",
    "save_adaptation",
]
