"""Left and right: which joints, feet and design parameters of a robot are each other's mirror images."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from locorl.interfaces import Array, BodyBatch, BodyFactory, Layout
from locorl.simulation.fields import batch_of

Index = NDArray[np.int64]

_POLAR = np.array([1.0, -1.0, 1.0])
"""Mirror image of a place or a velocity, seen from the base: y is to the left."""
_AXIAL = -_POLAR
"""Mirror image of an axis of rotation, which is a pseudo-vector."""
_PLACE = 0.01
"""Distance of a joint or a foot from where the image has it, in stance heights."""
_BALANCE = 0.01
"""Difference of mass times place of a link, in masses times stance heights of the robot."""
_MASS, _DRIVE = 0.05, 0.02
"""Relative differences of links' masses, and of joints' gains, torque limits, armature, damping and friction."""
_ANGLE = 0.03
"""Difference of axes, of joint ranges and servo targets about the stance, rad."""
_EFFECT = 0.2
"""Relative difference of what two design parameters do to the body."""


@dataclass(frozen=True)
class MirrorPairs:
    """The left-right mirror image of a robot: part i of the image is part `index[i]` of the original.

    Attributes:
        joint: index of the joints, (12,).
        joint_sign: of their angles and velocities, (12,).
        foot: index of the feet, (4,).
        design: index of the design parameters, (d,).
    """

    joint: Index
    joint_sign: Array
    foot: Index
    design: Index


@dataclass(frozen=True)
class _Parts:
    """One body with its base level and its joints as in the nominal stance; base frame, stance heights, robot masses.

    Links are those that the 12 joints move, with all that is fixed to them, then the base.
    """

    joint: Array
    """Anchors, (12, 3)."""
    axis: Array
    """(12, 3)."""
    foot: Array
    """(4, 3)."""
    mass: Array
    """(13,)."""
    balance: Array
    """Mass times centre of mass, (13, 3)."""
    drive: Array
    """Gains kp and kd, torque limit, armature, damping and friction of the joints, (12, 6)."""
    span: Array
    """Joint ranges about the stance, zeros where there are none, (12, 2), rad."""
    target: Array
    """Servo targets that hold the stance, about the stance, (12,), rad."""

    def image(self, pairs: MirrorPairs) -> _Parts:
        """The mirror image."""
        joint, sign = pairs.joint, pairs.joint_sign
        link, span = np.append(joint, len(joint)), self.span[joint]
        return _Parts(
            joint=self.joint[joint] * _POLAR,
            axis=self.axis[joint] * _AXIAL * sign[:, None],
            foot=self.foot[pairs.foot] * _POLAR,
            mass=self.mass[link],
            balance=self.balance[link] * _POLAR,
            drive=self.drive[joint],
            span=np.where(sign[:, None] > 0, span, -span[:, ::-1]),
            target=self.target[joint] * sign,
        )

    def numbers(self, drive: Array) -> Array:
        """What design parameters change, in one row; the drive in units of `drive` (12, 6)."""
        relative = self.drive / np.where(drive > 0, drive, 1.0)
        parts = (self.joint, self.axis, self.foot, self.mass, self.balance, relative)
        return np.concatenate([part.ravel() for part in parts])


def mirror_pairs(factory: BodyFactory) -> MirrorPairs:
    """Find the mirror image of every part of a robot by its place in the nominal stance, whatever it is called.

    Joints and feet are paired by where they are; joint axes decide about signs. Design parameters are paired by what
    they do: longer left thighs are the image of longer right ones, and longer front thighs of themselves.

    Raises:
        ValueError: left and right differ, or a design parameter acts on one side alone; the message names it.
    """
    space, layout = factory.space, factory.layout
    bounds = np.array([space.low, space.high, space.nominal], dtype=np.float64)
    low, high, nominal = bounds
    room = np.where(high > nominal, high - nominal, low - nominal)
    bodies = factory.batch(np.vstack((nominal, nominal + np.diag(room / 2))))
    if not bodies.feasible[0]:
        raise ValueError(f"{layout.robot}: the nominal body has no stance in which left and right can be compared")
    parts = _measure(bodies, layout)
    whole = parts[0]
    joint, sign = _pair_joints(whole, layout)
    foot = _nearest(_distance(whole.foot), layout.feet, layout.robot)
    pairs = MirrorPairs(joint, sign, foot, np.arange(len(nominal)))
    _compare(whole, whole.image(pairs), pairs, bodies.model, layout)
    effect = np.array([body.numbers(whole.drive) for body in parts])
    image = np.array([body.image(pairs).numbers(whole.drive) for body in parts])
    design = _pair_designs(effect[1:] - effect[0], image[1:] - image[0], bounds, space.names, layout.robot)
    return replace(pairs, design=design)


def _measure(bodies: BodyBatch, layout: Layout) -> list[_Parts]:
    """The parts of each body, all of them in the stance of the first."""
    count, stance = len(bodies.designs), np.array(bodies.stance_qpos[0])
    height, total = stance[2], bodies.total_mass[0]
    pose = np.concatenate(([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], stance[7:]))
    batch = batch_of(bodies.model, count, 1, bodies.fields)
    measured = []
    for row in range(count):
        model = batch.get_model(row)
        data = mujoco.MjData(model)
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        joints = [model.joint(name).id for name in layout.joints]
        dofs = model.jnt_dofadr[joints]
        links = [*model.jnt_bodyid[joints], model.body(layout.base).id]
        mass = np.array([model.body_mass[model.body_weldid == link].sum() for link in links])
        moment = model.body_mass[:, None] * data.xipos
        balance = np.array([moment[model.body_weldid == link].sum(axis=0) for link in links])
        motor = (bodies.kp[row], bodies.kd[row], bodies.torque_limit[row])
        passive = (model.dof_armature[dofs], model.dof_damping[dofs], model.dof_frictionloss[dofs])
        span = model.jnt_range[joints] - stance[7:, None]
        measured.append(
            _Parts(
                joint=data.xanchor[joints] / height,
                axis=data.xaxis[joints].copy(),
                foot=np.array([data.site(name).xpos for name in layout.feet]) / height,
                mass=mass / total,
                balance=balance / (total * height),
                drive=np.stack((*motor, *passive), axis=1),
                span=span * model.jnt_limited[joints, None],
                target=bodies.stance_ctrl[row] - bodies.stance_qpos[row][7:],
            )
        )
    return measured


def _distance(points: Array) -> Array:
    """How far each point (n, 3) is from the mirror image of every other, (n, n)."""
    return np.linalg.norm(points[:, None] - points[None] * _POLAR, axis=-1)


def _pair_joints(parts: _Parts, layout: Layout) -> tuple[Index, Array]:
    cosine = parts.axis @ (parts.axis * _AXIAL).T
    # joints may share an anchor; their axes differ then
    joint = _nearest(_distance(parts.joint) + 1.0 - np.abs(cosine), layout.joints, layout.robot)
    return joint, np.sign(cosine[np.arange(len(joint)), joint])


def _nearest(distance: Array, names: Sequence[str], robot: str) -> Index:
    """The part whose mirror image is nearest to each, (n,), by their distances (n, n)."""
    index = distance.argmin(axis=1)
    for part, other in enumerate(index):
        if index[other] != part:
            raise ValueError(
                f"{robot}: left and right differ: the mirror image of '{names[other]}' is nearest to '{names[part]}', "
                f"but that of '{names[part]}' is nearest to '{names[index[other]]}'"
            )
    return index


def _compare(own: _Parts, image: _Parts, pairs: MirrorPairs, model: mujoco.MjModel, layout: Layout) -> None:
    """Refuse a robot that differs from its mirror image."""
    joints = [model.joint(name).id for name in layout.joints]
    links = (*(model.body(model.jnt_bodyid[joint]).name for joint in joints), layout.base)
    link = np.append(pairs.joint, len(pairs.joint))

    def off(name: str) -> Array:
        difference = getattr(own, name) - getattr(image, name)
        return np.abs(difference) if difference.ndim == 1 else np.linalg.norm(difference, axis=1)

    def relative(name: str) -> Array:
        a, b = getattr(own, name), getattr(image, name)
        share = np.abs(a - b) / np.maximum(np.maximum(a, b), 1e-12)
        return share if share.ndim == 1 else share.max(axis=1)

    height, share, angle = "of the stance height", "of the larger one", "rad"
    for what, names, partner, gap, limit, unit in (
        ("axis of joint", layout.joints, pairs.joint, off("axis"), _ANGLE, angle),
        ("place of joint", layout.joints, pairs.joint, off("joint"), _PLACE, height),
        ("place of foot", layout.feet, pairs.foot, off("foot"), _PLACE, height),
        ("mass of link", links, link, relative("mass"), _MASS, share),
        ("centre of mass of link", links, link, off("balance"), _BALANCE, "of the robot's mass times stance height"),
        ("drive of joint", layout.joints, pairs.joint, relative("drive"), _DRIVE, share),
        ("range about the stance of joint", layout.joints, pairs.joint, off("span"), _ANGLE, angle),
        ("servo target in the stance of joint", layout.joints, pairs.joint, off("target"), _ANGLE, angle),
    ):
        if not (gap <= limit).all():
            # parts stand from the trunk outwards: the first is the cause
            part = int(np.argmin(gap <= limit))
            raise ValueError(
                f"{layout.robot}: left and right differ: {what} '{names[part]}' and of the mirror image of "
                f"'{names[partner[part]]}' are {gap[part]:.3g} {unit} apart, more than {limit:g}"
            )


def _pair_designs(effect: Array, image: Array, bounds: Array, names: Sequence[str], robot: str) -> Index:
    """The design parameter whose `effect` is the mirror `image` of that of each, (d,); both (d, numbers of a body)."""
    distance = np.linalg.norm(effect[:, None] - image[None], axis=-1)
    near = distance <= _EFFECT * np.linalg.norm(effect, axis=1)[:, None] + 1e-9
    # one without effect, or with the same on both sides, is its own image
    index = np.where(near.diagonal(), np.arange(len(names)), distance.argmin(axis=1))
    for part, other in enumerate(index):
        if not near[part, other] or index[other] != part:
            raise ValueError(
                f"{robot}: design parameter '{names[part]}' acts on left and right differently, and no other is its "
                "mirror image; add the one of the other side, with the same bounds"
            )
        if not np.allclose(bounds[:, part], bounds[:, other]):
            raise ValueError(
                f"{robot}: design parameters '{names[part]}' and '{names[other]}' are mirror images, but their bounds "
                "or nominal values differ"
            )
    return index
