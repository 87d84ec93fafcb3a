"""URDF to MuJoCo: free base, PD position servos, IMU, contact sensors, in any scene."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from morphgen.simulation.layout import Layout
from morphgen.stance.skeleton import Skeleton
from morphgen.urdf.legs import LegMap

FLOOR = "floor"
_PREFIX = "morphgen/"
_COLORS = {
    "base": (0.16, 0.18, 0.22, 1.0),
    "hip": (0.30, 0.33, 0.38, 1.0),
    "thigh": (0.85, 0.87, 0.90, 1.0),
    "shank": (0.20, 0.47, 0.75, 1.0),
    "foot": (0.10, 0.10, 0.10, 1.0),
}


@dataclass(frozen=True)
class Drive:
    """The PD servo at every joint: torque = kp (target - q) - kd dq within the joint's torque limit.

    Gains are those of the paper's Section IV; armature and friction are of the size identified on Go2.

    Attributes:
        kp: stiffness [N m/rad].
        kd: damping [N m s/rad].
        armature: reflected rotor inertia [kg m^2].
        damping: viscous joint friction [N m s/rad].
        friction: dry joint friction [N m].
    """

    kp: float = 40.0
    kd: float = 0.7
    armature: float = 0.01
    damping: float = 0.1
    friction: float = 0.1


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
    urdf: str, leg_map: LegMap, body: Skeleton, layout: Layout, drive: Drive, scene: mujoco.MjSpec | None
) -> mujoco.MjSpec:
    """Put the robot of a URDF into a copy of a scene; the scene's options win.

    Args:
        urdf: text of the robot.
        leg_map: its legs.
        body: its numbers, of which only the shared ones (limits) are used.
        layout: the names to give.
        drive: servo at every joint.
        scene: None for `flat_scene()`. Robot geoms have contype 1 and conaffinity 0, so they touch scene
            geoms whose conaffinity has bit 1, and not each other.
    """
    robot = mujoco.MjSpec.from_string(urdf)
    robot.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    robot.compiler.fusestatic = False
    _prepare_bodies(robot, leg_map, layout, drive)

    spec = flat_scene() if scene is None else scene.copy()
    # an empty prefix makes MuJoCo warn that the result may not save, so use one and strip it
    spec.attach(robot, prefix=_PREFIX, frame=spec.worldbody.add_frame())
    base = spec.body(_PREFIX + layout.base)
    kinds = ("body", "joint", "geom", "site")
    for element in [base, *(item for kind in kinds for item in base.find_all(kind))]:
        element.name = element.name.removeprefix(_PREFIX)
    _add_servos(spec, body, layout, drive)
    _add_sensors(spec, layout)
    return spec


def foot_geom(foot: str) -> str:
    """Name of the collision geom of a foot body."""
    return collision_geom(foot, 0)


def collision_geom(body: str, index: int) -> str:
    """Name of the collision geom of a body by its place in the URDF."""
    return f"{body}_collision" if index == 0 else f"{body}_collision{index}"


def _prepare_bodies(robot: mujoco.MjSpec, leg_map: LegMap, layout: Layout, drive: Drive) -> None:
    base = robot.body(layout.base)
    base.add_freejoint(name=f"{layout.base}_free")
    base.add_site(name="imu", size=[0.01] * 3, group=4)
    for leg in leg_map.legs:
        robot.body(leg.links[3]).add_site(name=leg.links[3], size=[0.01] * 3, group=4)
    kind_of = {name: kind for leg in leg_map.legs for name, kind in zip(leg.links, list(_COLORS)[1:], strict=True)}
    for body in robot.bodies[1:]:
        for index, geom in enumerate(body.geoms):
            geom.name = collision_geom(body.name, index)
            geom.rgba = _COLORS[kind_of.get(body.name, "base")]
            geom.contype, geom.conaffinity = 1, 0
    for name in layout.joints:
        joint = robot.joint(name)
        joint.armature = drive.armature
        joint.damping[0] = drive.damping
        joint.frictionloss = drive.friction


def _add_servos(spec: mujoco.MjSpec, body: Skeleton, layout: Layout, drive: Drive) -> None:
    for name, effort in zip(layout.actuators, body.effort.ravel(), strict=True):
        servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=drive.kp, kv=drive.kd)
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
        _add_contact_count(spec, name, mujoco.mjtObj.mjOBJ_GEOM, foot_geom(foot))
    for name, link in zip(layout.link_contact, layout.links, strict=True):
        _add_contact_count(spec, name, mujoco.mjtObj.mjOBJ_BODY, link)


def _add_contact_count(spec: mujoco.MjSpec, name: str, kind: mujoco.mjtObj, target: str) -> None:
    sensor = spec.add_sensor(name=name, type=mujoco.mjtSensor.mjSENS_CONTACT, objtype=kind, objname=target)
    data_bits, no_reduction, slots = 1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND), 0, 1
    sensor.intprm[:3] = [data_bits, no_reduction, slots]
