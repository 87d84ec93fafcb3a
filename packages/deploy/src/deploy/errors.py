"""Errors that a user can act on; every message names the file or element and the way out."""

from __future__ import annotations


class DeployError(Exception):
    """Base of all errors raised on purpose by this package."""


class BundleError(DeployError):
    """The bundle is missing, altered, inconsistent or does not reproduce its golden trace."""


class RobotError(DeployError):
    """The robot (or the simulated one) does not fit the bundle."""


class LogError(DeployError):
    """A log cannot be written, or is torn or lacks what the report needs."""
