"""LeggedEnv with cameras as an environment for the training of a seeing student."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

from torch import Tensor

from locorl.adapters.student import StudentEnv
from locorl.env.depth_camera import DepthConfig
from locorl.env.legged_env import LeggedEnv
from locorl.tasks.task import TaskConfig

_HEADINGS = ("heading_error", "next_heading_error")


def with_camera(task: TaskConfig, camera: DepthConfig | None = None, history: int = 0) -> TaskConfig:
    """A task whose robots have a camera without latency, and remember `history` past frames of proprioception.

    Args:
        task: the task.
        camera: optics, mount, period and noise; its latency is set to 0. By default that of `DepthConfig.small`.
        history: frames of the observation group `history`, which estimators and history encoders read.
    """
    camera = replace(camera or DepthConfig.small(), latency=0.0)
    return replace(task, camera=camera, observation=replace(task.observation, history=history))


class VisionEnv(StudentEnv):
    """N robots with depth cameras and a way to go.

    Images are handed out the moment they are taken: the latency between an image and its use is part of the student,
    which has the same in training and on a robot.

    Args:
        env: the robots; the adapter steps and resets it. `with_camera` makes a task for it.
        spread: see `StudentEnv`.

    Attributes:
        env: the same robots.
        heading: columns of the headings to the next waypoints in the group `proprio`.
        depth_shape: rows and columns of an image, px.
        depth_period: control steps between two images.

    Raises:
        ValueError: the task has no camera, a late one, or no heading among its observations.
    """

    def __init__(self, env: LeggedEnv, spread: bool = True) -> None:
        camera = env.task.camera
        if camera is None or camera.latency != 0.0:
            late = "no camera" if camera is None else f"a camera that is {camera.latency} s late"
            raise ValueError(f"the robots of task '{env.task.name}' have {late}; make the task with `with_camera`")
        terms = [term.name for term in env.layout.proprio]
        ways = [env.layout.column("proprio", name) for name in _HEADINGS if name in terms]
        if not ways or any(way.start != before.stop for before, way in pairwise(ways)):
            raise ValueError(
                f"task '{env.task.name}' observes {terms}: a seeing student needs {_HEADINGS[0]} among them, "
                f"and {_HEADINGS[1]}, if it is there, right after it"
            )
        super().__init__(env, spread)
        self.heading = slice(ways[0].start, ways[-1].stop)
        self.depth_shape = (camera.rows, camera.columns)
        self.depth_period = max(1, round(camera.period / env.dt))

    @property
    def depth(self) -> Tensor:
        """The images taken last, (N, rows, columns), from -0.5 (near) to 0.5 (far, or nothing)."""
        return self.env.depth
