"""Distil a privileged legged-robot policy into a student on onboard sensing, exported as a bundle."""

from distill.adaptation import (
    AdaptationConfig,
    AdaptationModule,
    AdaptedTeacher,
    Identification,
    RegularisedAdaptation,
    RoaSchedule,
    VelocityEstimation,
    build_adaptation,
    identify,
    load_adaptation,
    save_adaptation,
)
from distill.errors import (
    BundleError,
    CheckpointError,
    DistillError,
    InterfaceError,
    ProviderError,
    TrainingDiverged,
)
from distill.evaluate import Score, evaluate
from distill.export import export_bundle
from distill.golden import RawStates
from distill.imitation import LossWeights
from distill.interfaces import PrivilegedTeacher, ScanTeacher, StudentEnv, Teacher, VisionEnv
from distill.policy import StudentPolicy
from distill.spec import BundleSpec, CameraSpec, JointSpec, ObservationTerm
from distill.spec_file import read_spec, write_spec
from distill.student import Student, StudentConfig, build_student, load_student
from distill.train import TrainConfig, train
from distill.verify import Verification, verify_bundle
from distill.vision import (
    DepthEncoderConfig,
    VisionPolicy,
    VisionStudent,
    VisionStudentConfig,
    VisionTrainConfig,
    build_vision_student,
    load_vision_student,
    train_vision,
)
from distill.vision.export import export_vision_bundle

__all__ = [
    "AdaptationConfig",
    "AdaptationModule",
    "AdaptedTeacher",
    "BundleError",
    "BundleSpec",
    "CameraSpec",
    "CheckpointError",
    "DepthEncoderConfig",
    "DistillError",
    "Identification",
    "InterfaceError",
    "JointSpec",
    "LossWeights",
    "ObservationTerm",
    "PrivilegedTeacher",
    "ProviderError",
    "RawStates",
    "RegularisedAdaptation",
    "RoaSchedule",
    "ScanTeacher",
    "Score",
    "Student",
    "StudentConfig",
    "StudentEnv",
    "StudentPolicy",
    "Teacher",
    "TrainConfig",
    "TrainingDiverged",
    "VelocityEstimation",
    "Verification",
    "VisionEnv",
    "VisionPolicy",
    "VisionStudent",
    "VisionStudentConfig",
    "VisionTrainConfig",
    "build_adaptation",
    "build_student",
    "build_vision_student",
    "evaluate",
    "export_bundle",
    "export_vision_bundle",
    "identify",
    "load_adaptation",
    "load_student",
    "load_vision_student",
    "read_spec",
    "save_adaptation",
    "train",
    "train_vision",
    "verify_bundle",
    "write_spec",
]
