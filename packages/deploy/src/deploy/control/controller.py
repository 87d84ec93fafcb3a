"""The state machine between policy and robot: one call of `tick` per slot of the schedule.

Idle -> Passive -> StandUp -> Ready -> RampIn -> Policy; any of them -> Damp, which latches with its reason.
"""

from __future__ import annotations

import math
import threading

import numpy as np

from deploy.bundles.manifest import Bundle
from deploy.control.binding import JointBinding
from deploy.control.guards import Guards
from deploy.control.operator import Operator, Unattended
from deploy.control.schedule import Slot
from deploy.control.states import ControllerConfig, Mode, Tick
from deploy.errors import RobotError
from deploy.interfaces import Array, JointCommand, PolicyRuntime, RobotInterface, RobotState
from deploy.policy.tick import Policy, PolicyStep

__all__ = ["Controller", "ControllerConfig", "Mode", "Tick"]


class Controller:
    """Runs a policy on a robot behind guards."""

    def __init__(
        self,
        bundle: Bundle,
        robot: RobotInterface,
        runtime: PolicyRuntime,
        config: ControllerConfig | None = None,
        operator: Operator | None = None,
        dry_run: bool = False,
    ) -> None:
        """Bind the joints of robot and policy by name.

        Args:
            bundle: A verified bundle.
            robot: What to run it on.
            runtime: The bundle's networks.
            config: Timing and thresholds.
            operator: Who lets the robot go on and can stop it; None agrees to everything.
            dry_run: Compute everything, but send only damping; the robot need not stand for the policy to start.

        Raises:
            RobotError: The joints are not the same, or the policy feels its feet and the robot does not.
        """
        config = config or ControllerConfig()
        self._robot = robot
        self._binding = JointBinding.of(bundle, robot.spec)
        if robot.spec.feet is None and bundle.feels_feet:
            raise RobotError(
                f"{robot.spec.name}: it does not feel its feet, {bundle.name} reads them; train it without"
            )
        self._policy = Policy(bundle, runtime, wait=robot.clock.virtual)
        self._guards = Guards(bundle, config.guards, noiseless=robot.spec.noiseless)
        self._operator = operator or Unattended()
        self._dry_run = dry_run
        self._offset = bundle.per_joint("target_offset")
        self._lower, self._upper = bundle.per_joint("lower"), bundle.per_joint("upper")
        self._kp, self._kd = bundle.per_joint("kp"), bundle.per_joint("kd")
        self._stand_kp, self._stand_kd = config.stand_stiffness * self._kp, np.sqrt(config.stand_stiffness) * self._kd
        # the same torque against gravity from a stiffer servo
        stance = bundle.per_joint("stance")
        self._stand = stance + (self._offset - stance) / config.stand_stiffness
        passive, stand, hold, timeout, ramp = (
            math.ceil(seconds * bundle.policy_hz)
            for seconds in (
                *(config.passive_s, config.stand_up_s, config.hold_s),
                *(config.ready_timeout_s, config.ramp_in_s),
            )
        )
        self._ticks = {Mode.PASSIVE: passive, Mode.STAND_UP: stand, Mode.READY: hold, Mode.RAMP_IN: ramp}
        self._timeout = timeout
        self._mode = Mode.IDLE
        self._reason = ""
        self._elapsed = 0
        self._waiting: int | None = None
        self._from = self._stand
        self._policy_start_ns = 0
        joints, axes = np.full(len(self._offset), np.nan), np.full(3, np.nan)
        self._state = RobotState(0, 0, joints, joints, joints, np.full(4, np.nan), axes, axes)
        # `stop` may come from another thread, or from a signal in the middle of a tick
        self._lock = threading.RLock()

    @property
    def mode(self) -> Mode:
        """Current mode."""
        return self._mode

    @property
    def reason(self) -> str:
        """Why the robot is damped, empty otherwise."""
        return self._reason

    def stop(self, reason: str) -> None:
        """Damp the robot at once and for good, from any thread; the first reason stays."""
        with self._lock:
            if self._mode is not Mode.DAMP:
                self._mode, self._reason = Mode.DAMP, reason
            self._robot.damp()

    def close(self) -> None:
        """End the worker of a policy that sees."""
        self._policy.close()

    def tick(self, slot: Slot, command: Array) -> Tick:
        """Read, judge, compute, judge, write.

        Args:
            slot: The slot of the schedule that has just begun.
            command: (vx, vy, yaw_rate), base frame, m/s and rad/s.

        Returns:
            Everything the tick read, computed and sent.
        """
        trip = self._read()
        state = self._state
        trip = self._operator.stop() or self._guards.check_slot(slot) or trip
        trip = trip or self._guards.check_state(state, self._robot.clock.now_ns())
        if trip is None and not np.isfinite(command).all():
            trip = f"command: not finite: {command.tolist()}"
        step = None
        try:
            trip = trip or self._advance(state)
            if trip is None and self._mode in (Mode.RAMP_IN, Mode.POLICY):
                step = self._policy.step(state, command, self._robot.read_depth, slot.start_ns)
                trip = self._guards.check_action(step.action) or self._check_depth(step)
        except RobotError as error:  # from the camera
            trip = f"robot: {error}"
        if trip is not None:
            self.stop(trip)
        sent, clamped = self._send(step)
        return Tick(
            slot=slot,
            mode=self._mode,
            reason=self._reason,
            state=state,
            command=command,
            joint_command=sent,
            step=step,
            clamped=clamped,
            done_ns=self._robot.clock.now_ns(),
            dry_run=self._dry_run,
        )

    def _read(self) -> str | None:
        """Take the latest reading; says why there is none, and keeps the one before."""
        try:
            self._state = self._binding.state(self._robot.read())
        except RobotError as error:
            return f"robot: {error}"
        return None

    def _advance(self, state: RobotState) -> str | None:
        """Move the state machine on by one tick; says why it cannot go on at all."""
        ready = self._elapsed >= self._ticks.get(self._mode, 0)
        if self._mode is Mode.IDLE:
            self._enter(Mode.PASSIVE)
            ready = self._ticks[Mode.PASSIVE] == 0
        if self._mode is Mode.PASSIVE and ready and self._operator.go():
            self._enter(Mode.STAND_UP)
            # The target that gives the torque of this instant: a robot that stands does not sag.
            self._from = state.q + state.tau / self._stand_kp
        elif self._mode is Mode.STAND_UP and ready:
            self._enter(Mode.READY)
        held = self._mode is Mode.READY and self._elapsed >= self._ticks[Mode.READY]
        if held and self._waiting is None and self._operator.go():
            self._waiting = 0
        if held and self._waiting is not None:
            trip = None if self._dry_run else self._check_start(state)
            if trip is not None and self._waiting >= self._timeout:
                return f"start envelope: {trip}"
            self._waiting += 1
            if trip is None:
                self._policy.reset()
                self._policy_start_ns = self._robot.clock.now_ns()
                self._enter(Mode.RAMP_IN)
        if self._mode is Mode.RAMP_IN and self._elapsed >= self._ticks[Mode.RAMP_IN]:
            self._enter(Mode.POLICY)
        self._elapsed += 1
        return None

    def _enter(self, mode: Mode) -> None:
        with self._lock:
            if self._mode is not Mode.DAMP:
                self._mode, self._elapsed = mode, 0

    def _check_start(self, state: RobotState) -> str | None:
        perception = self._policy.perception
        trip = self._guards.check_start(state)
        if trip is None and perception is not None:
            trip = perception.check(self._robot.read_depth(), self._robot.clock.now_ns())
        return trip

    def _check_depth(self, step: PolicyStep) -> str | None:
        perception = self._policy.perception
        fault = None if perception is None else perception.fault
        return self._guards.check_depth(step.seen, self._policy_start_ns, self._robot.clock.now_ns(), fault)

    def _send(self, step: PolicyStep | None) -> tuple[JointCommand | None, int]:
        """Send what the mode asks for; returns it and the number of targets that were cut to the joint limits."""
        share = self._share()
        target = self._target(step, share)
        within = np.clip(target, self._lower, self._upper)
        zeros = np.zeros_like(within)
        with self._lock:
            if self._mode in (Mode.IDLE, Mode.PASSIVE, Mode.DAMP):
                self._robot.damp()
                return None, 0
            policy = share if step is not None else 0.0
            kp = self._stand_kp + policy * (self._kp - self._stand_kp)
            kd = self._stand_kd + policy * (self._kd - self._stand_kd)
            sent = JointCommand(within, zeros, kp, kd, zeros, self._robot.clock.now_ns())
            if self._dry_run:
                self._robot.damp()
            else:
                self._robot.write(self._binding.command(sent))
        return sent, int((within != target).sum())

    def _share(self) -> float:
        """How far the mode has come, from 0 to 1."""
        if self._mode is Mode.STAND_UP:
            return min(self._elapsed / max(self._ticks[Mode.STAND_UP], 1), 1.0)
        return self._elapsed / (self._ticks[Mode.RAMP_IN] + 1) if self._mode is Mode.RAMP_IN else 1.0

    def _target(self, step: PolicyStep | None, share: float) -> Array:
        """Joint targets of this tick, before they are cut to the joint limits."""
        if step is None:
            return self._from + share * (self._stand - self._from)
        return self._stand + share * (step.target - self._stand)
