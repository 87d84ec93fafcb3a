"""What a robot needs to know besides the network, from the body and the policy's task."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

import math

import distill
import mujoco
from locorl import DepthConfig, Policy, flat_scene
from locorl.env.observation import observation_layout
from locorl.interfaces import Array
from locorl.tasks.task import TaskConfig
from morphgen import BodyFactory
from morphgen.simulation.mjcf import to_mjcf

from legged_codesign.provenance import current_commit
from legged_codesign.scene import training_scene


def bundle_spec(
    factory: BodyFactory,
    teacher: Policy,
    design: Array,
    training: dict[str, object],
    camera: DepthConfig | None = None,
) -> distill.BundleSpec:
    """Everything that a robot needs to know besides the network, from the body and the policy's task.

    A seeing student needs the `camera` that it was trained with.
    """
    task: TaskConfig = teacher.card.task
    body = factory.batch(design[None], flat_scene(task.physics))
    layout, command = factory.layout, task.command
    joints = tuple(
        distill.JointSpec(
            name=name,
            actuator=layout.actuators[j],
            stance=float(body.stance_qpos[0, 7 + j]),
            target_offset=float(body.stance_ctrl[0, j]),
            kp=float(body.kp[0, j]),
            kd=float(body.kd[0, j]),
            torque_limit=float(body.torque_limit[0, j]),
            velocity_limit=float(body.velocity_limit[0, j]),
            lower=float(body.joint_lower[0, j]),
            upper=float(body.joint_upper[0, j]),
        )
        for j, name in enumerate(layout.joints)
    )
    robot_only = mujoco.MjSpec()
    robot_only.modelname = factory.name
    names = factory.space.names
    return distill.BundleSpec(
        name=f"{factory.name}-{task.name}",
        robot=factory.name,
        base=layout.base,
        feet=layout.feet,
        design={name: float(value) for name, value in zip(names, design, strict=True)},
        total_mass=float(body.total_mass[0]),
        joints=joints,
        observation=_observation(teacher),
        urdf=factory.urdf(design),
        robot_xml=to_mjcf(factory.spec(design, robot_only)),
        scene_xml=to_mjcf(factory.spec(design, training_scene(task))),
        start_height=float(body.stance_qpos[0, 2]),
        physics_dt=task.physics.timestep,
        command_low=(command.vx[0], command.vy[0], command.yaw_rate[0]),
        command_high=(command.vx[1], command.vy[1], command.yaw_rate[1]),
        action_scale=task.action_scale,
        action_clip=task.action_clip,
        policy_hz=1.0 / task.physics.control_dt,
        training=training,
        camera=None if camera is None else _camera(camera),
        commit=current_commit(),
    )


def _camera(config: DepthConfig) -> distill.CameraSpec:
    low, high = config.pitch
    return distill.CameraSpec(
        position=config.position,
        pitch=(math.radians(low), math.radians(high)),
        **config.intrinsics._asdict(),
        near=config.near,
        far=config.far,
        raw_size=config.raw_size,
        crop_bottom=config.crop_bottom,
        crop_sides=config.crop_sides,
    )


def _observation(teacher: Policy) -> tuple[distill.ObservationTerm, ...]:
    layout = observation_layout(teacher.card.task.observation, len(teacher.card.design_names))
    return tuple(
        distill.ObservationTerm(term.name, term.name, term.scale, term.frame, term.unit)  # pyright: ignore[reportArgumentType]
        for term in layout.proprio
    )
