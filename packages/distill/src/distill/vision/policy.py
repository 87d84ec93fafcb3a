"""The seeing student as a policy with a memory, to be rolled out like its teacher."""

from __future__ import annotations

import torch
from torch import Tensor

from distill.errors import InterfaceError
from distill.history import HistoryBuffer
from distill.interfaces import Observation, VisionEnv
from distill.vision.perception import Perception
from distill.vision.student import VisionStudent


class VisionPolicy:
    """Acts for the N robots of an environment on depth and proprioception; the oracle headings are not read.

    Call `reset(done)` after every `env.step`, so that a new episode starts with an empty memory.

    Args:
        student: the network.
        env: whose camera it looks through.

    Attributes:
        velocity: (N, 3) base velocity estimated by the last `act`, base frame, m/s.
        heading: (N, K) headings used by the last `act`, rad.
    """

    def __init__(self, student: VisionStudent, env: VisionEnv) -> None:
        check_camera(student, env)
        self._student, self._env = student.eval(), env
        self._history = HistoryBuffer(env.num_envs, student.history, student.proprio, env.device)
        self._perception = Perception(student, env.num_envs, env.device)
        self.velocity = torch.zeros(env.num_envs, 3, device=env.device)
        self.heading = torch.zeros(env.num_envs, student.headings, device=env.device)

    def reset(self, done: Tensor | None = None) -> None:
        """Forget what the robots in `done` ((N,) bool) know; all of them, when the environment is reset."""
        self._history.reset(done)
        self._perception.reset(done)

    @torch.no_grad()
    def act(self, obs: Observation) -> Tensor:
        """Action (N, 12) for the group "proprio" of `obs` and the environment's images; nothing else is read."""
        features = self._student.features(self._env.depth) if self._perception.due else None
        percept = self._perception.step(features, obs["proprio"])
        self.heading = percept.heading
        action, self.velocity, history = self._student(
            obs["proprio"], percept.terrain, percept.heading, self._history.frames
        )
        self._history.update(history)
        return action


def check_camera(student: VisionStudent, env: VisionEnv) -> None:
    """Check that the student fits the camera and the observation of an environment.

    Raises:
        InterfaceError: naming what differs.
    """
    here = {
        "proprio": env.group_dims["proprio"],
        "depth_shape": tuple(env.depth_shape),
        "depth_period": env.depth_period,
        "heading": env.heading,
    }
    for name, found in here.items():
        if found != (wanted := getattr(student, name)):
            raise InterfaceError(f"the student was made for {name} {wanted}, this environment has {found}")
