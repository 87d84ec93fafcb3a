"""How fast the feet turn, from the joints alone."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

from collections.abc import Sequence

import mujoco
import torch
from torch import Tensor

from locorl.env.kinematics import rotation


class Legs:
    """Kinematics of the legs of N robots whose links hang alike: every body may have other lengths.

    Args:
        model: any of the robots.
        joints: names of the joints leg by leg, from the hip outwards.
        device: of the robots' state.
        legs: number of legs.
    """

    def __init__(
        self, model: mujoco.MjModel, joints: Sequence[str], device: torch.device | str = "cpu", legs: int = 4
    ) -> None:
        ids = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) for name in joints]
        shape = (legs, len(joints) // legs)
        self._shape = shape
        self._zero = torch.tensor([model.qpos0[model.jnt_qposadr[j]] for j in ids]).view(shape)
        self._axis = torch.from_numpy(model.jnt_axis[ids].copy()).view(*shape, 3)
        # how each link is mounted on the one before
        mounted = torch.from_numpy(model.body_quat[model.jnt_bodyid[ids]].copy())
        self._mounted = rotation(mounted).view(*shape, 3, 3)
        # MuJoCo's numbers come from the host
        self._tilted = [bool((self._mounted[:, joint] != torch.eye(3)).any()) for joint in range(shape[1])]
        self._zero, self._axis, self._mounted = (each.to(device) for each in (self._zero, self._axis, self._mounted))

    def foot_rate(self, qpos: Tensor, qvel: Tensor) -> Tensor:
        """Angular velocity of each foot, world axes, (N, legs, 3), rad/s, from qpos (N, 19) and qvel (N, 18)."""
        qpos, qvel = qpos.double(), qvel.double()  # a GPU's simulator has single precision
        angle = qpos[:, 7:].view(-1, *self._shape) - self._zero
        sin, cos = angle.sin()[..., None], angle.cos()[..., None]
        turning = qvel[:, 6:].view(-1, *self._shape)[..., None] * self._axis
        # from the foot inwards: what turns beyond a joint turns with it
        rate = torch.zeros_like(turning[:, :, 0])
        for joint in reversed(range(self._shape[1])):
            axis = self._axis[:, joint].expand_as(rate)
            if joint + 1 < self._shape[1]:  # Rodrigues
                along = axis * (axis * rate).sum(dim=-1, keepdim=True)
                around = torch.linalg.cross(axis, rate)
                rate = along + cos[:, :, joint] * (rate - along) + sin[:, :, joint] * around
            rate = rate + turning[:, :, joint]
            if self._tilted[joint]:
                rate = (self._mounted[:, joint] @ rate[..., None]).squeeze(-1)
        base = rotation(qpos[:, 3:7])
        return (rate + qvel[:, None, 3:6]) @ base.transpose(1, 2)
