"""When images are taken in and when what they show is used: in a worker, with a latency that is always the same."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from deploy.bundles.manifest import Depth
from deploy.depth.preprocess import DepthPreprocessor
from deploy.errors import RobotError
from deploy.interfaces import DepthFrame, Image, PolicyRuntime, Seen

Camera: TypeAlias = Callable[[], DepthFrame | None]
"""Gives the latest frame, as `RobotInterface.read_depth` does."""


MOST_DUE = 3
"""Images that may be waited for at the same time; a camera later than that has lost them."""


@dataclass(frozen=True)
class Picture:
    """An image that entered the depth encoder.

    Attributes:
        tick: Policy tick since the start to which it belongs, and with whose observation it entered.
        stamp_ns: When it was taken.
        image: As the network reads it, shape (rows, columns), from -0.5 to 0.5.
    """

    tick: int
    stamp_ns: int
    image: Image


class Perception:
    """The depth encoder beside the control loop.

    At every `period_ticks`th tick an image is due. It is the first frame taken since half a tick before, and may come
    later: what it shows is used from `latency_ticks` after its tick on, whether camera and network
    were early or late within that time. So training, simulation, replay and robot see the same.

    Where that time was not enough, what was seen before stays in use, `overdue` counts, and a guard judges its age.
    With a virtual clock the loop waits for the network, which costs no time there.
    """

    def __init__(self, runtime: PolicyRuntime, depth: Depth, period_ns: int, wait: bool = True) -> None:
        """Start with nothing seen.

        Args:
            runtime: The networks.
            depth: Timing and optics.
            period_ns: Policy period, ns.
            wait: Whether a tick waits for what it must use (virtual clock, or no latency to compute in).
        """
        self._runtime = runtime
        self._depth = depth
        self._period_ns = period_ns
        self._wait = wait or depth.latency_ticks == 0
        self._preprocess = DepthPreprocessor(depth.optics)
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="depth")
        self._under_way: deque[tuple[Picture, Future[tuple[Image, Image]]]] = deque()
        terrain, heading = (
            np.zeros(depth.graph.outputs[name][1:], dtype=np.float32) for name in ("terrain", "heading")
        )
        self._nothing = Seen(terrain, heading)
        self.overdue = 0
        """Ticks that went on with something older than the latency allows."""
        self.missed = 0
        """Images that never came."""
        self.fault: str | None = None
        """What was wrong with the latest frame, None for nothing."""
        self.reset()

    def reset(self) -> None:
        """Begin a new episode at tick 0 with nothing seen; waits for what is under way."""
        wait([future for _, future in self._under_way])
        self._under_way.clear()
        self._tick = 0
        self._seen = self._nothing
        self._due: deque[tuple[int, int, NDArray[np.float32]]] = deque()
        self._last_seq: int | None = None
        self.fault = None
        self._runtime.reset()

    def close(self) -> None:
        """End the worker."""
        self._worker.shutdown(wait=True)

    def step(
        self, obs: NDArray[np.float32], camera: Camera, now_ns: int, seen_tick: int | None = None
    ) -> tuple[Seen, Picture | None]:
        """Advance one tick.

        Args:
            obs: Observation of this tick, shape (P,).
            camera: Asked for its latest frame while an image is due.
            now_ns: Time of this tick on the clock of the frames, ns.
            seen_tick: Tick whose image is to be in use, as a log says; None: by the latency.

        Returns:
            What is in use at this tick, and the image that entered the network at this tick, if one did.

        Raises:
            RobotError: The camera's frames are not those that the policy was trained with.
        """
        if self._tick % self._depth.period_ticks == 0:
            self._due.append((self._tick, now_ns, obs))
            if len(self._due) > MOST_DUE:
                self._due.popleft()
                self.missed += 1
        picture = self._take(camera)
        while self._under_way:
            first, future = self._under_way[0]
            if seen_tick is None:
                ready = first.tick + self._depth.latency_ticks <= self._tick
            else:
                ready = first.tick <= seen_tick
            if not ready:
                break
            if not (self._wait or seen_tick is not None or future.done()):
                break
            terrain, heading = future.result()
            self._seen = Seen(terrain, heading, first.tick, first.stamp_ns)
            self._under_way.popleft()
        period, past = self._depth.period_ticks, self._tick - self._depth.latency_ticks
        self.overdue += past >= 0 and self._seen.tick < past - past % period
        self._tick += 1
        return self._seen, picture

    def check(self, frame: DepthFrame | None, now_ns: int) -> str | None:
        """Why a policy that needs images must not start with this frame, or None if it may."""
        if frame is None:
            return "depth: no frame from the camera"
        ticks = self._depth.period_ticks + self._depth.latency_ticks
        age, limit = now_ns - frame.stamp_ns, ticks * self._period_ns
        if not 0 <= age <= limit:
            return f"depth: the latest frame is {age * 1e-6:.0f} ms old, limit {limit * 1e-6:.0f} ms"
        return None if self._prepare(frame) is not None else self.fault

    def _take(self, camera: Camera) -> Picture | None:
        """Hand the image that is due to the worker, if it is there."""
        if not self._due:
            return None
        frame = camera()
        if frame is None or frame.seq == self._last_seq:
            return None
        waiting = [due_ns - self._period_ns // 2 <= frame.stamp_ns for _, due_ns, _ in self._due].count(True)
        if not waiting or (image := self._prepare(frame)) is None:
            return None
        self._last_seq = frame.seq
        # times ascend: a frame that is late enough for several ticks belongs to the last of them
        taken = [self._due.popleft() for _ in range(waiting)]
        self.missed += waiting - 1
        tick, _, obs = taken[-1]
        picture = Picture(tick, frame.stamp_ns, image)
        self._under_way.append((picture, self._worker.submit(self._runtime.see, image, obs)))
        return picture

    def _prepare(self, frame: DepthFrame) -> Image | None:
        if not frame.prepared:
            reading = self._preprocess(frame)
            self.fault = reading.fault
            return None if reading.fault else reading.image
        shape = (self._depth.optics.rows, self._depth.optics.columns)
        if frame.image_m.shape != shape:
            raise RobotError(f"depth: a prepared image has shape {frame.image_m.shape}, the network reads {shape}")
        return frame.image_m
