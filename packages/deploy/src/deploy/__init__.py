"""Run an exported legged-robot policy at 50 Hz, log it as MCAP and measure its energy."""

from deploy.bundles.golden import check_golden
from deploy.bundles.loading import load_bundle
from deploy.bundles.manifest import Bundle
from deploy.control.controller import Controller, ControllerConfig
from deploy.control.guards import GuardLimits
from deploy.errors import BundleError, DeployError, LogError, RobotError
from deploy.measure.summary import RunSummary
from deploy.policy.onnx_runtime import OnnxRuntime
from deploy.session import report, run

__all__ = [
    "Bundle",
    "BundleError",
    "Controller",
    "ControllerConfig",
    "DeployError",
    "GuardLimits",
    "LogError",
    "OnnxRuntime",
    "RobotError",
    "RunSummary",
    "check_golden",
    "load_bundle",
    "report",
    "run",
]
