"""Run an exported legged-robot policy at 50 Hz, log it as MCAP and measure its energy."""

from deploy.bundle import load_bundle
from deploy.controller import Controller, ControllerConfig
from deploy.errors import BundleError, DeployError, LogError, RobotError
from deploy.golden import check_golden
from deploy.guards import GuardLimits
from deploy.manifest import Bundle
from deploy.runtime import OnnxRuntime
from deploy.session import report, run
from deploy.summary import RunSummary

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
