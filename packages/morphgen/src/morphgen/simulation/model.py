"""A body in MuJoCo: free base, PD position servos, IMU, contact sensors, in any scene."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from morphgen.palette import PALETTE
from morphgen.scaling.articulate import Collisions
from morphgen.simulation.drive import Drive
from morphgen.simulation.layout import Layout
from morphgen.skeleton import Array, Skeleton

FLOOR = "floor"
_PREFIX = "morphgen/"
_COUNT, _FORCE = (1 << int(b) for b in (mujoco.mjtConDataField.mjCONDATA_FOUND, mujoco.mjtConDataField.mjCONDATA_FORCE))
_NO_REDUCTION, _NET_FORCE = 0, 3
_PARTS = ("hip", "thigh", "shank", "foot", "trunk")
_GEOM = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
}


def flat_scene(timestep: float = 0.005) -> mujoco.MjSpec:
    """A plane at z = 0 with a light, implicitfast integration and dense algebra."""
    scene = mujoco.MjSpec()
    scene.option.timestep = timestep
    scene.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    scene.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    texture = scene.add_texture(
        name="grid",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.92, 0.92, 0.90],
        rgb2=[0.80, 0.82, 0.84],
        width=256,
        height=256,
    )
    material = scene.add_material(name="grid", texrepeat=[2, 2], texuniform=True)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = texture.name
    scene.worldbody.add_light(pos=[0, 0, 4], dir=[0.2, 0.2, -1], type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
    scene.worldbody.add_geom(
        name=FLOOR,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 0.05],
        contype=0,
        conaffinity=1,
        material="grid",
    )
    return scene


def build_spec(
    body: Skeleton,
    collisions: Collisions,
    layout: Layout,
    drive: Drive,
    kp: Array,
    kd: Array,
    scene: mujoco.MjSpec | None,
) -> mujoco.MjSpec:
    """Put one body (n = 1) into a copy of a scene; the scene's options win.

    Args:
        body: its parts.
        collisions: its geoms.
        layout: the names to give.
        drive: servo at every joint.
        kp: (12,) stiffness of the servos [N m/rad].
        kd: (12,) damping of the servos [N m s/rad].
        scene: None for `flat_scene()`. Robot geoms have contype 1 and conaffinity 0, so they touch scene
            geoms whose conaffinity has bit 1, and not each other.
    """
    robot = mujoco.MjSpec()
    robot.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    robot.compiler.degree = False
    _add_bodies(robot, body, layout, drive)
    _add_geoms(robot, collisions, layout)

    spec = flat_scene() if scene is None else scene.copy()
    # an empty prefix makes MuJoCo warn that the result may not save, so use one and strip it
    spec.attach(robot, prefix=_PREFIX, frame=spec.worldbody.add_frame())
    base = spec.body(_PREFIX + layout.base)
    kinds = ("body", "joint", "geom", "site")
    for element in [base, *(item for kind in kinds for item in base.find_all(kind))]:
        element.name = element.name.removeprefix(_PREFIX)
    _add_servos(spec, drive.torque_limits(body, layout), layout, kp, kd)
    _add_sensors(spec, layout)
    return spec


def foot_geom(foot: str) -> str:
    """Name of the collision geom of a foot body."""
    return collision_geom(foot, 0)


def collision_geom(body: str, index: int) -> str:
    """Name of the collision geom of a body by its place in the URDF."""
    return f"{body}_collision" if index == 0 else f"{body}_collision{index}"


def _add_bodies(robot: mujoco.MjSpec, skeleton: Skeleton, layout: Layout, drive: Drive) -> None:
    base = robot.worldbody.add_body(name=layout.base)
    _set_inertial(base, skeleton.base_mass[0], skeleton.base_com[0], skeleton.base_inertia[0])
    base.add_freejoint(name=f"{layout.base}_free")
    base.add_site(name="imu", size=[0.01] * 3, group=4)
    torque = drive.torque_limits(skeleton, layout)
    damping, friction = drive.joint_friction(skeleton)
    for leg in range(4):
        parent = base
        for part in range(4):
            parent = parent.add_body(name=layout.body(leg, part), pos=skeleton.joint_origin[0, leg, part])
            _set_inertial(
                parent,
                skeleton.link_mass[0, leg, part],
                skeleton.link_com[0, leg, part],
                skeleton.link_inertia[0, leg, part],
            )
            if part == 3:
                parent.add_site(name=layout.feet[leg], size=[0.01] * 3, group=4)
                continue
            joint = parent.add_joint(
                name=layout.joints[3 * leg + part],
                type=mujoco.mjtJoint.mjJNT_HINGE,
                axis=skeleton.axis[leg, part],
                armature=drive.armature,
                frictionloss=friction[leg, part],
            )
            joint.damping[0] = damping[leg, part]
            lower, upper = skeleton.lower[leg, part], skeleton.upper[leg, part]
            if np.isfinite(lower) and np.isfinite(upper):
                joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
                joint.range = [lower, upper]
            joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
            joint.actfrcrange = [-torque[leg, part], torque[leg, part]]


def _set_inertial(body: mujoco.MjsBody, mass: float, com: Array, inertia: Array) -> None:
    if mass == 0:  # a frame without mass of its own
        return
    body.explicitinertial = True
    body.mass, body.ipos = mass, com
    if inertia.any():  # else a point mass, which MuJoCo takes on bodies without a joint
        body.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def _add_geoms(robot: mujoco.MjSpec, collisions: Collisions, layout: Layout) -> None:
    count: dict[str, int] = {}
    for g, (leg, part, kind) in enumerate(zip(collisions.leg, collisions.part, collisions.kind, strict=True)):
        name = layout.body(leg, part)
        index = count[name] = count.get(name, -1) + 1
        robot.body(name).add_geom(
            name=collision_geom(name, index),
            type=_GEOM[kind],
            size=geom_size(kind, collisions.size[0, g]),
            pos=collisions.position[0, g],
            quat=rotation_to_quat(collisions.rotation[:1, g])[0],
            rgba=np.array(PALETTE[_PARTS[part]]) / 255,
            contype=1,
            conaffinity=0,
        )


def geom_size(kind: str, size: Array) -> Array:
    """MuJoCo's half sizes (..., 3) of a shape's size (..., 3), see `Shape.size`."""
    if kind == "box":
        return size / 2
    return size * (1.0, 0.5, 0.0)


def rotation_to_quat(rotation: Array) -> Array:
    """Unit quaternions w, x, y, z (n, 4) with w >= 0 of rotations (n, 3, 3)."""
    return Rotation.from_matrix(rotation).as_quat(canonical=True, scalar_first=True)


def _add_servos(spec: mujoco.MjSpec, torque: Array, layout: Layout, kp: Array, kd: Array) -> None:
    for i, (name, effort) in enumerate(zip(layout.actuators, torque.ravel(), strict=True)):
        servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=kp[i], kv=kd[i])
        servo.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        servo.forcerange = np.array([-effort, effort])


def _add_sensors(spec: mujoco.MjSpec, layout: Layout) -> None:
    kinds = {
        "gyro": mujoco.mjtSensor.mjSENS_GYRO,
        "acc": mujoco.mjtSensor.mjSENS_ACCELEROMETER,
        "quat": mujoco.mjtSensor.mjSENS_FRAMEQUAT,
    }
    for key, name in layout.imu.items():
        spec.add_sensor(name=name, type=kinds[key], objtype=mujoco.mjtObj.mjOBJ_SITE, objname="imu")
    for name, foot in zip(layout.foot_contact, layout.feet, strict=True):
        _add_contact(spec, name, mujoco.mjtObj.mjOBJ_GEOM, foot_geom(foot), _COUNT | _FORCE, _NET_FORCE)
    for name, link in zip(layout.link_contact, layout.links, strict=True):
        _add_contact(spec, name, mujoco.mjtObj.mjOBJ_BODY, link, _COUNT, _NO_REDUCTION)


def _add_contact(spec: mujoco.MjSpec, name: str, kind: mujoco.mjtObj, target: str, data: int, reduction: int) -> None:
    sensor = spec.add_sensor(name=name, type=mujoco.mjtSensor.mjSENS_CONTACT, objtype=kind, objname=target)
    sensor.intprm[:3] = [data, reduction, 1]
