"""Left-right mirror images of observations and actions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from locorl.bodies.pairs import MirrorPairs, mirror_pairs
from locorl.env.legged_env import LeggedEnv, Obs
from locorl.env.observation import ObsTerm
from locorl.env.scan import HeightScan

_POLAR, _AXIAL = (1.0, -1.0, 1.0), (-1.0, 1.0, -1.0)
_SIGNS: Mapping[str, tuple[float, ...]] = {
    "base_angular_velocity": _AXIAL,
    "projected_gravity": _POLAR,
    "roll_pitch": (-1.0, 1.0),
    "heading_error": (-1.0,),
    "next_heading_error": (-1.0,),
    "command": (1.0, -1.0, -1.0),
    "commanded_speed": (1.0,),
    "base_linear_velocity": _POLAR,
    "mass_ratio": (1.0,),
    "centre_of_mass": _POLAR,
    "stance_height": (1.0,),
    "friction": (1.0,),
    "joint_damping": (1.0,),
    "payload": (1.0,),
}
"""Signs of the terms whose columns stay where they are."""

Columns = tuple[NDArray[np.int64], NDArray[np.float64]]
"""Where each column of the image comes from, and its sign."""


@dataclass(frozen=True)
class ColumnMirror:
    """Column j of the image is `sign[j]` times column `index[j]`.

    Attributes:
        index: (dim,) long.
        sign: (dim,), +1 or -1.
    """

    index: Tensor
    sign: Tensor

    @classmethod
    def of(cls, columns: Columns, device: torch.device) -> ColumnMirror:
        """The tensors of `columns` on `device`."""
        index, sign = (torch.from_numpy(values).to(device) for values in columns)
        return cls(index, sign.float())

    def __call__(self, values: Tensor) -> Tensor:
        """The image of `values` (..., dim), a tensor of its own."""
        return values.index_select(-1, self.index).mul_(self.sign)


@dataclass(frozen=True)
class Symmetry:
    """What a robot would observe and do in the mirror.

    Bodies, ground, commands and randomness are mirrored too: the image of an observation is what the image of the
    robot observes on the image of the ground.

    Attributes:
        groups: image of each observation group, by name.
        joints: image of an action.
    """

    groups: Mapping[str, ColumnMirror]
    joints: ColumnMirror

    @classmethod
    def of(cls, env: LeggedEnv) -> Symmetry:
        """The symmetry of the robots and the observations of `env`.

        Raises:
            ValueError: left and right of the robot, of its design space or of the height scan differ, or there is no
                rule for a term; the message names what it is.
        """
        pairs, layout = mirror_pairs(env.factory), env.layout
        rules = _rules(pairs, env.observer.scanner)
        groups = {group: terms for group, terms in layout.groups.items() if group != "history"}
        columns = {group: _join([_rule(rules, term) for term in terms]) for group, terms in groups.items()}
        if layout.history:
            columns["history"] = _join([columns["proprio"]] * len(layout.history))
        return cls(
            groups={group: ColumnMirror.of(each, env.device) for group, each in columns.items()},
            joints=ColumnMirror.of((pairs.joint, pairs.joint_sign), env.device),
        )

    def observation(self, obs: Mapping[str, Tensor]) -> Obs:
        """The mirror image of an observation or a part of its groups, group -> (..., dim)."""
        return {group: self.groups[group](values) for group, values in obs.items()}

    def action(self, action: Tensor) -> Tensor:
        """The mirror image of actions (..., 12), or of anything else by joint with a direction."""
        return self.joints(action)


def _rules(pairs: MirrorPairs, scanner: HeightScan | None) -> dict[str, Columns]:
    """The columns of every term by name."""
    signed, joints, feet = (pairs.joint, pairs.joint_sign), _unsigned(pairs.joint), _unsigned(pairs.foot)
    rules = {name: (np.arange(len(sign)), np.array(sign)) for name, sign in _SIGNS.items()}
    rules |= dict.fromkeys(("joint_position_error", "joint_velocity", "last_action"), signed)
    rules |= dict.fromkeys(("motor_strength", "motor_damping"), joints)
    rules |= {"foot_contact": feet, "design": _unsigned(pairs.design)}
    if scanner is not None:
        rules["heights"] = _unsigned(_scan_points(scanner))
    return rules


def _rule(rules: Mapping[str, Columns], term: ObsTerm) -> Columns:
    if term.name not in rules or len(rules[term.name][0]) != term.size:
        raise ValueError(f"locorl.env.symmetry has no mirror image for the {term.size} columns of term '{term.name}'")
    return rules[term.name]


def _join(blocks: Sequence[Columns]) -> Columns:
    """Columns of blocks side by side."""
    start = np.cumsum([0, *(len(index) for index, _ in blocks)])
    index = [first + block for first, (block, _) in zip(start, blocks, strict=False)]
    return np.concatenate(index), np.concatenate([sign for _, sign in blocks])


def _unsigned(index: NDArray[np.int64]) -> Columns:
    return index, np.ones(len(index))


def _scan_points(scanner: HeightScan) -> NDArray[np.int64]:
    """Which point lies across from each, (P,)."""
    points, config = scanner.offsets.double().cpu(), scanner.config
    distance, across = torch.cdist(points, points * torch.tensor((1.0, -1.0))).min(dim=1)
    if bool((distance > 1e-3 * config.spacing).any()):
        raise ValueError(
            f"ScanConfig: sideways {config.sideways} every {config.spacing} m is not the same to the left and to the "
            "right; make it (-w, w) with w a multiple of half the spacing"
        )
    return across.numpy()
