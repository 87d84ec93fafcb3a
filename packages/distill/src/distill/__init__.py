"""Distil a privileged legged-robot policy into a student on onboard sensing, exported as a bundle."""

from distill.checkpoint import load_student
from distill.errors import (
    BundleError,
    CheckpointError,
    DistillError,
    InterfaceError,
    ProviderError,
    TrainingDiverged,
)
from distill.export import export_bundle
from distill.golden import RawStates
from distill.imitation import LossWeights
from distill.interfaces import PrivilegedTeacher, StudentEnv, Teacher
from distill.policy import StudentPolicy
from distill.spec import BundleSpec, JointSpec, ObservationTerm
from distill.student import Student, StudentConfig, build_student
from distill.train import TrainConfig, train
from distill.verify import Verification, verify_bundle

__all__ = [
    "BundleError",
    "BundleSpec",
    "CheckpointError",
    "DistillError",
    "InterfaceError",
    "JointSpec",
    "LossWeights",
    "ObservationTerm",
    "PrivilegedTeacher",
    "ProviderError",
    "RawStates",
    "Student",
    "StudentConfig",
    "StudentEnv",
    "StudentPolicy",
    "Teacher",
    "TrainConfig",
    "TrainingDiverged",
    "Verification",
    "build_student",
    "export_bundle",
    "load_student",
    "train",
    "verify_bundle",
]
