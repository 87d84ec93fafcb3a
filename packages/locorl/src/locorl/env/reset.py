"""Where and how a robot starts an episode."""

from __future__ import annotations

import torch
from torch import Tensor

from locorl.env.kinematics import yaw_quat
from locorl.env.randomisation import RandomisationConfig
from locorl.terrain.heights import HeightGrid

_CORNER = torch.tensor((-0.3, 0.0, 0.3))
_FOOTPRINT = torch.cartesian_prod(_CORNER, _CORNER)
"""Points of the square that a standing robot covers, (9, 2), m."""


def start_state(
    stance: Tensor, origin: Tensor, ground: HeightGrid | None, random: RandomisationConfig, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Stances at `origin`, varied as `random` says.

    Args:
        stance: the robots' stances at the world's origin, (m, 19).
        origin: where they start, (m, 3), m.
        ground: heights; None for level ground at z = 0.
        random: half-widths of the variation.
        generator: of the variation; it is not touched if there is none.

    Returns:
        qpos (m, 19) and qvel (m, 18), double precision, standing on the highest ground under the robot.
    """
    qpos = stance.clone()
    qvel = torch.zeros(len(stance), 18, dtype=qpos.dtype, device=qpos.device)

    def draw(columns: int) -> Tensor:
        numbers = torch.rand(len(stance), columns, generator=generator, device=generator.device)
        return numbers.to(qpos.dtype) * 2 - 1

    if random.reset_joint > 0.0 or random.reset_velocity > 0.0:
        white = draw(19)
        qpos[:, 7:] += random.reset_joint * white[:, :12]
        qpos[:, 3:7] = yaw_quat(random.reset_yaw * white[:, 12])
        qvel[:, :6] = random.reset_velocity * white[:, 13:]
        # a deviating leg may reach lower than the stance
        qpos[:, 2] += 0.3 * random.reset_joint * stance[:, 2]
    qpos[:, :2] += origin[:, :2]
    if random.reset_position > 0.0:
        qpos[:, :2] += random.reset_position * draw(2)
    if ground is not None:
        around = qpos[:, None, :2].float() + _FOOTPRINT.to(qpos.device)
        qpos[:, 2] += ground.at(around).amax(dim=1)
    return qpos, qvel
