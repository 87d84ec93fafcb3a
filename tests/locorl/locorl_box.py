"""A quadruped of boxes as BodyFactory: compiles one model per design, so its fields are the compiler's own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np

LEGS = ("FL", "FR", "RL", "RR")
FIELDS = ("body_mass", "body_inertia", "body_pos", "body_ipos", "geom_size", "geom_pos", "site_pos")
LINK, RADIUS, KP, KD, TORQUE = 0.2, 0.02, 40.0, 0.7, 25.0


def hip_position(leg: int) -> np.ndarray:
    return np.array([0.18 if leg < 2 else -0.18, 0.1 if leg % 2 == 0 else -0.1, 0.0])


@dataclass(frozen=True)
class Space:
    names: tuple[str, ...] = ("front_thigh", "front_shank", "hind_thigh", "hind_shank")
    low: np.ndarray = field(default_factory=lambda: np.full(4, 0.6))
    high: np.ndarray = field(default_factory=lambda: np.full(4, 1.4))
    nominal: np.ndarray = field(default_factory=lambda: np.ones(4))


@dataclass(frozen=True)
class BoxLayout:
    robot: str = "box"
    base: str = "base"
    joints: tuple[str, ...] = tuple(f"{leg}_{part}_joint" for leg in LEGS for part in ("hip", "thigh", "calf"))
    feet: tuple[str, ...] = tuple(f"{leg}_foot" for leg in LEGS)
    foot_contact: tuple[str, ...] = tuple(f"{leg}_foot_contact" for leg in LEGS)
    link_contact: tuple[str, ...] = (
        "base_contact",
        *(f"{leg}_{part}_contact" for leg in LEGS for part in ("hip", "thigh", "calf")),
    )


@dataclass(frozen=True)
class Bodies:
    designs: np.ndarray
    model: mujoco.MjModel
    fields: Mapping[str, np.ndarray]
    stance_qpos: np.ndarray
    stance_ctrl: np.ndarray
    feasible: np.ndarray
    kp: np.ndarray
    kd: np.ndarray
    torque_limit: np.ndarray
    total_mass: np.ndarray


def box_spec(design: np.ndarray, scene: mujoco.MjSpec | None = None) -> mujoco.MjSpec:
    """One robot in a copy of `scene`, or on a floor of its own."""
    if scene is None:
        spec = mujoco.MjSpec()
        spec.option.timestep = 0.005
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], contype=0, conaffinity=1)
    else:
        spec = scene.copy()

    def link(parent, name: str, pos, axis, half_size, centre, mass: float):
        body = parent.add_body(name=name, pos=pos)
        if axis is None:
            body.add_freejoint()
        else:
            body.add_joint(name=f"{name}_joint", axis=axis, armature=0.01, damping=[0.1, 0, 0], frictionloss=0.1)
        shape = mujoco.mjtGeom.mjGEOM_BOX
        body.add_geom(name=name, type=shape, size=half_size, pos=centre, mass=mass, contype=1, conaffinity=0)
        return body

    base = link(spec.worldbody, "base", [0, 0, 0.5], None, [0.2, 0.08, 0.05], [0.01, 0, 0], 7.0)
    base.add_site(name="imu")
    for leg, prefix in enumerate(LEGS):
        thigh_scale, shank_scale = design[:2] if leg < 2 else design[2:]
        side = 1.0 if leg % 2 == 0 else -1.0
        thigh_length, shank_length = LINK * thigh_scale, LINK * shank_scale
        hip = link(base, f"{prefix}_hip", hip_position(leg), [1, 0, 0], [0.03] * 3, [0, 0, 0], 0.5)
        at = [0, 0.05 * side, 0]
        middle = [0, 0, -thigh_length / 2]
        thigh = link(hip, f"{prefix}_thigh", at, [0, 1, 0], [0.015, 0.015, thigh_length / 2], middle, 0.8 * thigh_scale)
        at, end = [0, 0, -thigh_length], [0, 0, -shank_length]
        middle = [0, 0, -shank_length / 2]
        calf = link(thigh, f"{prefix}_calf", at, [0, 1, 0], [0.01, 0.01, shank_length / 2], middle, 0.3 * shank_scale)
        ball = mujoco.mjtGeom.mjGEOM_SPHERE
        calf.add_geom(
            name=f"{prefix}_foot", type=ball, size=[RADIUS, 0, 0], pos=end, mass=0.04, contype=1, conaffinity=0
        )
        calf.add_site(name=f"{prefix}_foot", pos=end)

    layout = BoxLayout()
    for name in layout.joints:
        servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=KP, kv=KD)
        servo.forcelimited, servo.forcerange = True, [-TORQUE, TORQUE]
    count, force = (
        1 << int(bit) for bit in (mujoco.mjtConDataField.mjCONDATA_FOUND, mujoco.mjtConDataField.mjCONDATA_FORCE)
    )
    for name in (*layout.foot_contact, *layout.link_contact):
        geom = name.removesuffix("_contact")
        # feet tell the net force too, the rest only how many contacts
        what = [count | force, 3, 1] if name in layout.foot_contact else [count, 0, 1]
        spec.add_sensor(
            name=name, type=mujoco.mjtSensor.mjSENS_CONTACT, objtype=mujoco.mjtObj.mjOBJ_GEOM, objname=geom
        ).intprm[:3] = what
    site = mujoco.mjtObj.mjOBJ_SITE
    spec.add_sensor(name="imu_gyro", type=mujoco.mjtSensor.mjSENS_GYRO, objtype=site, objname="imu")
    return spec


def _stance(model: mujoco.MjModel, design: np.ndarray) -> tuple[np.ndarray, np.ndarray, bool]:
    """Pose with a level trunk and feet under the hips, the targets that hold it, and whether it exists."""
    height = 0.75 * LINK * min(design[0] + design[1], design[2] + design[3])
    data, feasible = mujoco.MjData(model), True
    data.qpos[:7] = [0, 0, height + RADIUS, 1, 0, 0, 0]
    for leg in range(4):
        thigh, shank = LINK * (design[:2] if leg < 2 else design[2:])
        cos_thigh = (thigh**2 + height**2 - shank**2) / (2 * thigh * height)
        cos_shank = (shank**2 + height**2 - thigh**2) / (2 * shank * height)
        feasible &= abs(cos_thigh) <= 1 and abs(cos_shank) <= 1 and thigh * cos_thigh < height - RADIUS
        angle, knee = np.arccos(np.clip((cos_thigh, cos_shank), -1, 1))
        data.qpos[7 + 3 * leg : 10 + 3 * leg] = [0, angle, -angle - knee]
    mujoco.mj_forward(model, data)
    # the feet share the weight so that it has no moment about the centre of mass
    weight = 9.81 * model.body_mass.sum()
    com, (front, hind) = data.subtree_com[0, 0], (hip_position(0)[0], hip_position(2)[0])
    share = np.repeat([(com - hind) / (front - hind), (front - com) / (front - hind)], 2) / 2
    torque = data.qfrc_bias[6:].copy()
    jacobian = np.zeros((3, model.nv))
    for leg, name in enumerate(BoxLayout().feet):
        mujoco.mj_jacSite(model, data, jacobian, None, model.site(name).id)
        torque -= jacobian[2, 6:] * weight * share[leg]
    return data.qpos.copy(), data.qpos[7:] + torque / KP, bool(feasible)


class BoxQuadruped:
    """The stand-in factory; `name` may be changed to play another robot."""

    def __init__(self, name: str = "box") -> None:
        self.name, self.space, self.layout = name, Space(), BoxLayout()

    def compiled(self, design: np.ndarray, scene: mujoco.MjSpec | None = None) -> mujoco.MjModel:
        return box_spec(np.asarray(design, dtype=float), scene).compile()

    def batch(self, designs: np.ndarray, scene: mujoco.MjSpec | None = None) -> Bodies:
        designs = np.asarray(designs, dtype=float)
        models = [self.compiled(design, scene) for design in designs]
        stances = [_stance(model, design) for model, design in zip(models, designs, strict=True)]
        n = len(designs)
        return Bodies(
            designs=designs,
            model=self.compiled(self.space.nominal, scene),
            fields={name: np.stack([getattr(model, name) for model in models]) for name in FIELDS},
            stance_qpos=np.stack([qpos for qpos, _, _ in stances]),
            stance_ctrl=np.stack([ctrl for _, ctrl, _ in stances]),
            feasible=np.array([ok for _, _, ok in stances]),
            kp=np.full((n, 12), KP),
            kd=np.full((n, 12), KD),
            torque_limit=np.full((n, 12), TORQUE),
            total_mass=np.array([model.body_mass.sum() for model in models]),
        )
