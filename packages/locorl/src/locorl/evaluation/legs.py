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
        legs: number of legs.
    """

    def __init__(self, model: mujoco.MjModel, joints: Sequence[str], legs: int = 4) -> None:
        ids = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) for name in joints]
        shape = (legs, len(joints) // legs)
        self._shape = shape
        self._zero = torch.tensor([model.qpos0[model.jnt_qposadr[j]] for j in ids]).view(shape)
        self._axis = torch.from_numpy(model.jnt_axis[ids].copy()).view(*shape, 3)
        # how each link is mounted on the one before
        mounted = torch.from_numpy(model.body_quat[model.jnt_bodyid[ids]].copy())
        self._mounted = rotation(mounted).view(*shape, 3, 3)
        x, y, z = self._axis.unbind(dim=-1)
        nothing = torch.zeros_like(x)
        self._cross = torch.stack((nothing, -z, y, z, nothing, -x, -y, x, nothing), dim=-1).view(*shape, 3, 3)

    def foot_rate(self, qpos: Tensor, qvel: Tensor) -> Tensor:
        """Angular velocity of each foot, world axes, (N, legs, 3), rad/s, from qpos (N, 19) and qvel (N, 18)."""
        angle = qpos[:, 7:].double().view(-1, *self._shape) - self._zero
        speed = qvel[:, 6:].double().view(-1, *self._shape)
        base = rotation(qpos[:, 3:7].double())
        rate = qvel[:, None, 3:6].double().expand(-1, self._shape[0], 3)
        link = torch.eye(3, dtype=torch.float64)
        for joint in range(self._shape[1]):
            link = link @ self._mounted[:, joint]
            rate = rate + (link @ self._axis[:, joint, :, None]).squeeze(-1) * speed[:, :, joint, None]
            sin, cos = (f(angle[:, :, joint, None, None]) for f in (torch.sin, torch.cos))
            cross = self._cross[:, joint]
            link = link @ (torch.eye(3, dtype=torch.float64) + sin * cross + (1 - cos) * (cross @ cross))
        return (base[:, None] @ rate[..., None]).squeeze(-1)
