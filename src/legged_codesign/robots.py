"""The robots that a run can start from."""

from __future__ import annotations

import hashlib
from pathlib import Path

from locorl.providers import find_factory, is_file
from morphgen import BodyFactory


def body_factory(robot: str) -> BodyFactory:
    """The factory of an installed robot (entry point group `legged.bodies`), or of the URDF at a path.

    Raises:
        LookupError: no installed package knows the robot, or its factory cannot write URDFs.
        FileNotFoundError: there is no such file.
    """
    factory = find_factory(robot)
    if not isinstance(factory, BodyFactory):
        raise LookupError(
            f"robot '{robot}' comes from {type(factory).__module__}, which is no morphgen.BodyFactory: "
            "a run needs one to write URDFs, drawings and bundles"
        )
    return factory


def absolute(robot: str) -> str:
    """The robot as a run keeps it: a name as it is, a path so that it means the same file from everywhere."""
    return str(Path(robot).resolve()) if is_file(robot) else robot


def short_name(robot: str) -> str:
    """The robot in the name of a run folder: a path's last part, without `.urdf`."""
    return Path(robot).stem if is_file(robot) else robot


def file_hash(robot: str) -> str | None:
    """SHA-256 of the robot's file; None for an installed robot.

    Raises:
        FileNotFoundError: there is no such file.
    """
    return hashlib.sha256(Path(robot).read_bytes()).hexdigest() if is_file(robot) else None
