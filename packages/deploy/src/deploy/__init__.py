"""Run an exported legged-robot policy at 50 Hz, log it as MCAP and measure its energy."""

from deploy.bundles.golden import check_golden
from deploy.bundles.loading import load_bundle
from deploy.bundles.manifest import Bundle
from deploy.bundles.recording import record_golden
from deploy.comparison import ReplayResult, replay
from deploy.control.controller import Controller, ControllerConfig, Mode
from deploy.control.guards import GuardLimits
from deploy.control.operator import Keyboard, Operator, Unattended
from deploy.doctor import Diagnosis, examine
from deploy.errors import BundleError, DeployError, LogError, RobotError
from deploy.measure.summary import RunSummary
from deploy.policy.onnx_runtime import OnnxRuntime
from deploy.policy.torchscript_runtime import TorchScriptRuntime
from deploy.robots.disturbances import Disturbances, Fault
from deploy.session import report, run

__all__ = [
    "Bundle",
    "BundleError",
    "Controller",
    "ControllerConfig",
    "DeployError",
    "Diagnosis",
    "Disturbances",
    "Fault",
    "GuardLimits",
    "Keyboard",
    "LogError",
    "Mode",
    "OnnxRuntime",
    "Operator",
    "ReplayResult",
    "RobotError",
    "RunSummary",
    "TorchScriptRuntime",
    "Unattended",
    "check_golden",
    "examine",
    "load_bundle",
    "record_golden",
    "replay",
    "report",
    "run",
]
