"""A student that sees: depth encoder, training with MTS, and its use as a policy."""

from distill.vision.config import Convolution, DepthEncoderConfig, VisionStudentConfig, VisionTrainConfig
from distill.vision.depth_encoder import DepthEncoder
from distill.vision.perception import Percept, Perception
from distill.vision.policy import VisionPolicy
from distill.vision.student import VisionStudent, build_vision_student, load_vision_student
from distill.vision.train import train_vision

__all__ = [
    "Convolution",
    "DepthEncoder",
    "DepthEncoderConfig",
    "Percept",
    "Perception",
    "VisionPolicy",
    "VisionStudent",
    "VisionStudentConfig",
    "VisionTrainConfig",
    "build_vision_student",
    "load_vision_student",
    "train_vision",
]
