"""The robots that a run can start from."""

from __future__ import annotations

from locorl.providers import find_factory
from morphgen import BodyFactory


def body_factory(robot: str) -> BodyFactory:
    """The factory of an installed robot (entry point group `legged.bodies`).

    Raises:
        LookupError: no installed package knows the robot, or its factory cannot write URDFs.
    """
    factory = find_factory(robot)
    if not isinstance(factory, BodyFactory):
        raise LookupError(
            f"robot '{robot}' comes from {type(factory).__module__}, which is no morphgen.BodyFactory: "
            "a run needs one to write URDFs, drawings and bundles"
        )
    return factory
