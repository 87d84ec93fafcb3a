"""legged_codesign: from a quadruped's URDF and a task to the leg lengths and the controller that do it best."""

import os

# as `locorl` does, for a command that loads torch before locorl
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from legged_codesign.config import RunConfig
from legged_codesign.pipeline import run
from legged_codesign.presets import preset

__all__ = ["RunConfig", "preset", "run"]
