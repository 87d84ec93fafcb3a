"""A Unitree Go2 as a robot: motor commands out, sensors in, over DDS."""

# pyright: reportMissingImports=false
from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from deploy.control.clock import WallClock
from deploy.depth.sources import DepthSource
from deploy.errors import RobotError
from deploy.interfaces import Clock, DepthFrame, EnergyReading, JointCommand, RobotSpec, RobotState
from deploy.robots.specs import GO2
from deploy.robots.unitree.domain import NEWEST, NEWEST_OF_OTHERS, join
from deploy.robots.unitree.energy import EnergyProcess
from deploy.robots.unitree.messages import COMMANDS, STATES, StampClock, low_cmd, robot_state
from deploy.robots.unitree.motion_switcher import MotionSwitcher
from deploy.robots.unitree.wire import LowCmd, LowState

LOOPBACK = "lo"
"""Interface of simulators on this machine, which have no services."""
_POLL_S = 0.005


@dataclass(frozen=True)
class UnitreeConfig:
    """How to reach a Go2.

    Attributes:
        interface: Network interface that the robot is wired to; `lo` for a simulator on this machine.
        domain: DDS domain: 0 on the robot.
        wait_s: How long `start` waits for the robot at each step, s.
        release_service: Ask the robot's own walking service to let go. The robot must lie on the ground.
        allow_silent_publishers: Accept others that could command the motors but do not; one that does never is.
        damping: Gain of `damp`, N m s/rad.
        contact_force: Counts of a foot's sensor above which it touches the ground.
    """

    interface: str
    domain: int = 0
    wait_s: float = 3.0
    release_service: bool = True
    allow_silent_publishers: bool = False
    damping: float = 3.0
    contact_force: int = 20


class UnitreeRobot:
    """A `RobotInterface` to a Go2; joints in the vendor's order, as `spec` names them.

    The motors close their loop themselves, so a command holds until the next one.
    """

    def __init__(self, config: UnitreeConfig, depth: DepthSource | None = None, clock: Clock | None = None) -> None:
        self._config = config
        self._depth = depth
        self._clock = clock or WallClock()
        self._stamps = StampClock()
        self._lock = threading.RLock()  # a signal may damp in the middle of a write
        self._states: DataReader | None = None
        self._others: DataReader | None = None
        self._writer: DataWriter | None = None
        self._energy: EnergyProcess | None = None
        self._newest: LowState | None = None
        self._reads = 0

    @property
    def spec(self) -> RobotSpec:
        """Joints, limits and rates of a Go2."""
        return GO2

    @property
    def clock(self) -> Clock:
        """Wall time."""
        return self._clock

    def start(self) -> None:
        """Find the robot, have its own service let go, make sure that nobody else commands it, take over.

        Nothing is sent to the motors yet.

        Raises:
            RobotError: No robot answers, its service keeps the motors, or somebody else publishes commands.
        """
        participant = join(self._config.domain, self._config.interface)
        commands = Topic(participant, COMMANDS, LowCmd)
        self._states = DataReader(participant, Topic(participant, STATES, LowState), NEWEST)
        self._others = DataReader(participant, commands, NEWEST_OF_OTHERS)
        self._await_state()
        if self._config.release_service:
            found = MotionSwitcher(participant).release(timeout_s=10.0)
            if found is None and self._config.interface != LOOPBACK:
                raise RobotError(
                    f"{self._where()}: no motion_switcher answers, so nobody knows what drives the motors; restart the "
                    "robot, or set release_service=False if it has none and nothing else moves it"
                )
        self._energy = EnergyProcess(self._config.domain, self._config.interface)
        self._listen_for_others()
        if self._depth is not None:
            self._depth.start(self._clock)
        writer = DataWriter(participant, commands)
        if not self._within(lambda: bool(writer.get_matched_subscriptions())):
            raise RobotError(f"{self._where()}: sends {STATES}, but nothing there listens to {COMMANDS}")
        self._writer = writer

    def stop(self) -> None:
        """Leave the topics; the motors keep the last command, which should be that of `damp`."""
        with self._lock:
            self._writer = self._others = self._states = None
        if self._depth is not None:
            self._depth.stop()
        if self._energy is not None:
            self._energy.close()
            self._energy = None

    def read(self) -> RobotState:
        """The latest state; its time is that of the robot's own counter.

        Raises:
            RobotError: The robot is not started, it was restarted meanwhile, or somebody else has begun to command it.
        """
        if self._states is None or self._others is None:
            raise RobotError(f"{self._where()}: not started")
        if any(isinstance(sample, LowCmd) for sample in self._others.take(1)):
            raise RobotError(
                f"{self._where()}: another program publishes on {COMMANDS}; stop it, two make the legs thrash"
            )
        self._take()
        assert self._newest is not None  # `start` waited for it
        try:
            stamp = self._stamps.stamp(self._newest.tick, self._clock.now_ns())
        except ValueError as error:
            raise RobotError(
                f"{self._where()}: {error}: it was restarted, or two robots send {STATES} on this domain"
            ) from error
        return robot_state(self._newest, stamp, self._reads, self._config.contact_force)

    def read_depth(self) -> DepthFrame | None:
        """The latest image of the depth camera, None without one."""
        return None if self._depth is None else self._depth.latest()

    def energy(self) -> EnergyReading | None:
        """Work of the joints since `start`, from every state that the robot sent and its estimates of torque."""
        return None if self._energy is None else self._energy.read()

    def write(self, command: JointCommand) -> None:
        """Send a command, its targets cut to the joint limits of the robot.

        Raises:
            RobotError: The robot is not started, or a number is not finite; then it is damped instead.
        """
        if not command.finite:
            self.damp()
            raise RobotError(f"{self._where()}: a command is not finite; the robot was damped instead")
        with self._lock:
            if self._writer is None:
                raise RobotError(f"{self._where()}: not started")
            self._writer.write(low_cmd(command, GO2))

    def damp(self) -> None:
        """No stiffness, `damping` on every joint; from any thread. Before `start` and after `stop` nothing is sent."""
        limp = JointCommand.limp(len(GO2.joint_names), self._config.damping)
        with self._lock:
            if self._writer is not None:
                self._writer.write(low_cmd(limp, GO2))

    def _take(self) -> None:
        assert self._states is not None
        for sample in self._states.take(1):
            if isinstance(sample, LowState):
                self._newest = sample
                self._reads += 1

    def _await_state(self) -> None:
        """Wait for readings whose counter advances, so that their age can be told."""
        first: list[int] = []

        def advanced() -> bool:
            self._take()
            if self._newest is not None:
                first.append(self._newest.tick)
            return bool(first) and first[-1] != first[0]

        if self._within(advanced):
            return
        if first:
            raise RobotError(f"{self._where()}: its counter stands at {first[0]}, its readings may be of any age")
        raise RobotError(
            f"{self._where()}: no {STATES} within {self._config.wait_s:g} s; is the robot on, is this the interface "
            "it is wired to, and does it use the same DDS domain?"
        )

    def _listen_for_others(self) -> None:
        others = self._others
        assert others is not None
        self._within(lambda: False, min(1.0, self._config.wait_s))  # time to be discovered
        if any(isinstance(sample, LowCmd) for sample in others.take(1)):
            raise RobotError(f"{self._where()}: another program publishes on {COMMANDS}; stop it first")
        if (silent := len(others.get_matched_publications())) and not self._config.allow_silent_publishers:
            raise RobotError(
                f"{self._where()}: {silent} other program(s) could publish on {COMMANDS}, silent so far; stop them, or "
                "set allow_silent_publishers if you know that they stay silent"
            )

    def _within(self, condition: Callable[[], bool], seconds: float | None = None) -> bool:
        end = time.monotonic() + (self._config.wait_s if seconds is None else seconds)
        while not condition():
            if time.monotonic() > end:
                return False
            time.sleep(_POLL_S)
        return True

    def _where(self) -> str:
        return f"Go2 on {self._config.interface}, DDS domain {self._config.domain}"
