"""Teachers of another library: an rsl_rl policy, adapted in a few lines, is imitated blind and seeing."""

from __future__ import annotations

import json
from collections.abc import Mapping

import pytest
import torch
from distill import (
    DepthEncoderConfig,
    StudentConfig,
    TrainConfig,
    VisionStudentConfig,
    VisionTrainConfig,
    train,
    train_vision,
)
from distill.vision import Convolution
from torch import Tensor
from vision_toy import WIDTH, VisionToy

pytest.importorskip("rsl_rl")
from rsl_rl.models import MLPModel
from tensordict import TensorDict

GROUPS = ["proprio", "implicit", "scan"]


class RslRlTeacher:
    """What `OnPolicyRunner.get_inference_policy` gives, as a teacher."""

    def __init__(self, policy: MLPModel) -> None:
        self._policy = policy.eval()

    @torch.no_grad()
    def act(self, obs: Mapping[str, Tensor]) -> Tensor:
        return self._policy(TensorDict(dict(obs), batch_size=[len(obs["proprio"])]))


@pytest.fixture
def teacher() -> RslRlTeacher:
    env = VisionToy(4)
    torch.manual_seed(0)
    example = TensorDict(env.reset(seed=0), batch_size=[4])
    return RslRlTeacher(MLPModel(example, {"actor": GROUPS}, "actor", WIDTH, hidden_dims=[16], activation="elu"))


def fall(folder) -> float:
    rows = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    return rows[-1]["action_loss"] / rows[0]["action_loss"]


def test_it_is_imitated_blind(teacher, tmp_path):
    config = TrainConfig(iterations=8, rollout_steps=10, segment=8, updates=8, batch=64, beta_iterations=0)
    train(VisionToy(16), teacher, tmp_path, config, StudentConfig(history=3), progress=False)
    assert fall(tmp_path) < 0.5


def test_it_is_imitated_seeing(teacher, tmp_path):
    config = VisionTrainConfig(iterations=8, rollout_steps=10, segment=8, updates=8, batch=16, roa=False)
    depth = DepthEncoderConfig((Convolution(4, 3, 2),), image_hidden=8, image_features=4, fusion=(8,), memory=8)
    small = VisionStudentConfig(depth=depth)
    train_vision(VisionToy(16), teacher, tmp_path, config, small, progress=False)
    assert fall(tmp_path) < 0.5
