"""The bundle's own scene in MuJoCo as a robot: PD at every physics step, virtual clock, deterministic."""

# pyright: reportAttributeAccessIssue=false
# mujoco ships no type stubs for its compiled modules.
from __future__ import annotations

from collections import deque

import mujoco
import numpy as np

from deploy.bundles.manifest import Bundle
from deploy.interfaces import (
    Array,
    DepthFrame,
    EnergyReading,
    GroundTruth,
    JointCommand,
    RobotSpec,
    RobotState,
)
from deploy.policy.observation import rotate_inverse
from deploy.robots.disturbances import Disturbances, StateDisturber, disturbed_image
from deploy.robots.energy_meter import EnergyMeter
from deploy.robots.mujoco_camera import MujocoCamera
from deploy.robots.mujoco_scene import load_scene

MOST_FRAMES = 64
"""Frames of the camera that may be under way."""


class MujocoRobot:
    """A simulated robot that satisfies `RobotInterface` and `Simulated`.

    Time passes only in `sleep_until`. The servo law of a `JointCommand` is written into gain and bias of the
    model's position actuators: MuJoCo evaluates it, clamped to the torque limit, at every physics step.
    The readings are those of an IMU at the base origin and of exact encoders, as `Disturbances` spoil them; a policy
    that sees gets a depth camera, which takes one frame per policy period.
    """

    def __init__(
        self,
        bundle: Bundle,
        seed: int = 0,
        joint_noise: float = 0.02,
        damping: float = 3.0,
        disturbances: Disturbances | None = None,
    ) -> None:
        """Load the scene and put the robot into its stance.

        Args:
            bundle: A verified bundle; its scene file is loaded.
            seed: Seed of the initial joint noise.
            joint_noise: Half-width of the uniform initial noise on each joint, rad.
            damping: Gain of `damp`, N m s/rad.
            disturbances: What goes wrong; None for nothing.

        Raises:
            RobotError: The scene does not compile or does not hold the robot that the manifest describes.
        """
        scene = load_scene(bundle)
        self._model, self._joints, self._base = scene.model, scene.joints, scene.base
        self._feet, self._foot_geoms = scene.foot_sites, scene.foot_geoms
        self._root_qpos, self._root_dof = scene.root_qpos, scene.root_dof
        self._data = mujoco.MjData(self._model)
        self._disturbances = disturbances or Disturbances()
        self._disturb = StateDisturber(self._disturbances)
        self._damping = damping
        self._spec = RobotSpec(
            f"{bundle.robot.name} in MuJoCo",
            self._joints.names,
            feet=bundle.robot.feet,
            noiseless=not self._disturbances.noisy,
        )
        self._step_ns = self._model.opt.timestep * 1e9
        self._steps = 0
        self._meter = EnergyMeter(len(self._joints.names))
        self._commands: deque[tuple[int, JointCommand]] = deque()
        self._period_ns = bundle.period_ns
        self._camera = None if bundle.depth is None else MujocoCamera(self._model, bundle.depth)
        self._poses: deque[tuple[int, int, Array]] = deque(maxlen=MOST_FRAMES)
        self._frames = 0
        self._frame: DepthFrame | None = None
        delay = round(self._disturbances.state_delay_s * 1e9 / self._step_ns)
        self._readings: deque[RobotState] = deque(maxlen=delay + 1 if delay else 0)
        self._start_in_stance(bundle, np.random.default_rng(seed), joint_noise)
        self._remember()

    def _start_in_stance(self, bundle: Bundle, rng: np.random.Generator, noise: float) -> None:
        joints = {joint.name: joint for joint in bundle.joints}
        ordered = [joints[name] for name in self._joints.names]
        start = {joint.name: joint.stance + rng.uniform(-noise, noise) for joint in bundle.joints}
        root = self._root_qpos
        qpos = self._data.qpos
        qpos[root + 2] = bundle.start_height
        qpos[root + 3 : root + 7] = bundle.start_quat_wxyz
        qpos[self._joints.qpos] = [start[joint.name] for joint in ordered]
        zeros = np.zeros(len(ordered))
        self._apply(
            JointCommand(
                q=np.array([joint.target_offset for joint in ordered]),
                dq=zeros,
                kp=np.array([joint.kp for joint in ordered]),
                kd=np.array([joint.kd for joint in ordered]),
                tau=zeros,
                stamp_ns=0,
            )
        )
        mujoco.mj_forward(self._model, self._data)

    @property
    def spec(self) -> RobotSpec:
        """Joint names in the order of the actuators of the scene."""
        return self._spec

    @property
    def clock(self) -> MujocoRobot:
        """The robot is its own virtual clock."""
        return self

    @property
    def virtual(self) -> bool:
        """Time passes only in `sleep_until`."""
        return True

    def now_ns(self) -> int:
        """Simulated time since construction, ns."""
        return round(self._steps * self._step_ns)

    def sleep_until(self, time_ns: int) -> None:
        """Simulate to the physics step nearest to `time_ns`."""
        steps = round(time_ns / self._step_ns) - self._steps
        for _ in range(steps):
            while self._commands and self._commands[0][0] <= self.now_ns():
                self._apply(self._commands.popleft()[1])
            velocity = self._data.qvel[self._joints.dof].copy()
            mujoco.mj_step(self._model, self._data)
            # mj_step leaves the forces that acted at its start: they pair with the velocity from before it.
            self._meter.add(velocity, self._data.qfrc_actuator[self._joints.dof], self._model.opt.timestep)
            self._steps += 1
            self._remember()
        if steps > 0:
            mujoco.mj_forward(self._model, self._data)  # forces and accelerations of this very instant

    def _remember(self) -> None:
        """Keep what will be read later: readings under way, and where the camera is when it takes a frame."""
        if self._readings.maxlen:
            mujoco.mj_forward(self._model, self._data)
            self._readings.append(self._reading())
        if self._camera is not None and self.now_ns() >= self._frames * self._period_ns:
            root = self._root_qpos
            pose = self._data.qpos[root : root + 7].copy()
            self._poses.append((self._frames, self.now_ns(), pose))
            self._frames += 1

    def start(self) -> None:
        """Nothing to take over: the servos hold the stance already."""

    def stop(self) -> None:
        """Nothing to give back."""

    def read(self) -> RobotState:
        """State at this instant, or before if readings are delayed; joints in the order of `spec`."""
        return self._disturb(self._readings[0] if self._readings else self._reading())

    def _reading(self) -> RobotState:
        data, root, dof = self._data, self._root_qpos, self._root_dof
        quat = data.qpos[root + 3 : root + 7].copy()
        return RobotState(
            stamp_ns=self.now_ns(),
            seq=self._steps,
            q=data.qpos[self._joints.qpos],
            dq=data.qvel[self._joints.dof],
            tau=data.qfrc_actuator[self._joints.dof],
            quat_wxyz=quat,
            gyro=data.qvel[dof + 3 : dof + 6].copy(),
            acc=rotate_inverse(quat, data.qacc[dof : dof + 3] - self._model.opt.gravity),
            contact=np.isin(self._foot_geoms, data.contact.geom),
        )

    def read_depth(self) -> DepthFrame | None:
        """The latest frame that has arrived; None before the first one, and of a robot whose policy is blind."""
        newest = self.now_ns() - round(self._disturbances.depth_delay_s * 1e9)
        while self._camera is not None and self._poses and self._poses[0][1] <= newest:
            seq, stamp, pose = self._poses.popleft()
            if self._poses and self._poses[0][1] <= newest:
                continue  # nobody asked for it in time
            image = disturbed_image(self._disturbances, self._camera.render(self._data, pose[:3], pose[3:]), seq, stamp)
            if image is not None:
                self._frame = DepthFrame(stamp, seq, image)
        return self._frame

    def write(self, command: JointCommand) -> None:
        """Set the servo law; it acts at every physics step until the next command."""
        delay = round(self._disturbances.action_delay_s * 1e9)
        if delay:
            self._commands.append((self.now_ns() + delay, command))
        else:
            self._apply(command)

    def _apply(self, command: JointCommand) -> None:
        model, index = self._model, self._joints.actuator
        model.actuator_gainprm[index, 0] = command.kp
        model.actuator_biasprm[index, 0] = command.kd * command.dq + command.tau
        model.actuator_biasprm[index, 1] = -command.kp
        model.actuator_biasprm[index, 2] = -command.kd
        self._data.ctrl[index] = command.q

    def damp(self) -> None:
        """No stiffness, `damping` on every joint."""
        self.write(JointCommand.limp(len(self._joints.names), self._damping, self.now_ns()))

    def truth(self) -> GroundTruth:
        """Exact pose and velocity of the base."""
        data, root, dof = self._data, self._root_qpos, self._root_dof
        position = data.qpos[root : root + 3].copy()
        return GroundTruth(
            position=position,
            quat_wxyz=data.qpos[root + 3 : root + 7].copy(),
            velocity=data.qvel[dof : dof + 3].copy(),
            angular_velocity=data.qvel[dof + 3 : dof + 6].copy(),
            height_over_feet=float(position[2] - data.site_xpos[self._feet, 2].min()),
        )

    def energy(self) -> EnergyReading:
        """Positive work of each joint since construction, and the peak power since the previous call."""
        return self._meter.read()
