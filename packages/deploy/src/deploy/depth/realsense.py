"""A RealSense depth camera, such as the D435i that the paper's robots carry."""

# pyright: reportMissingImports=false
from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from deploy.depth.sources import to_metres
from deploy.errors import RobotError
from deploy.interfaces import Clock, DepthFrame, Intrinsics


@dataclass(frozen=True)
class RealSenseConfig:
    """Which camera, and its stream; 848 x 480 px is the D435's native depth and sees all of its 87 degrees.

    Attributes:
        width: px.
        height: px.
        rate: Images per second.
        serial: Serial number; None: the only camera.
        wait_s: How long `start` waits for the first image, s.
    """

    width: int = 848
    height: int = 480
    rate: int = 30
    serial: str | None = None
    wait_s: float = 5.0


class RealSenseDepth:
    """A `DepthSource` on pyrealsense2; a thread takes the images."""

    def __init__(self, config: RealSenseConfig | None = None) -> None:
        self._config = config or RealSenseConfig()
        self._rs: Any = None
        self._pipeline: Any = None
        self._thread: threading.Thread | None = None
        self._running = False
        self._latest: DepthFrame | None = None

    def start(self, clock: Clock) -> None:
        """Open the camera and wait for an image.

        Raises:
            RobotError: pyrealsense2 or the camera is missing, or it gives no images.
        """
        try:
            import pyrealsense2
        except ModuleNotFoundError as error:
            raise RobotError("a RealSense camera needs pyrealsense2: pip install 'legged-deploy[realsense]'") from error
        except ImportError as error:
            raise RobotError(
                f"pyrealsense2 cannot be loaded ({error}): install the system's library that it names, on Debian "
                "`apt install libusb-1.0-0`"
            ) from error
        self._rs, config = pyrealsense2, self._config
        streams = self._rs.config()
        if config.serial is not None:
            streams.enable_device(config.serial)
        streams.enable_stream(self._rs.stream.depth, config.width, config.height, self._rs.format.z16, config.rate)
        pipeline = self._rs.pipeline()
        try:
            profile = pipeline.start(streams)
        except RuntimeError as error:
            raise RobotError(
                f"RealSense: cannot stream {config.width} x {config.height} depth at {config.rate} Hz ({error}); "
                "is the camera on a USB 3 port, and does no other program use it?"
            ) from error
        self._pipeline = pipeline
        scale = float(profile.get_device().first_depth_sensor().get_depth_scale())
        lens = profile.get_stream(self._rs.stream.depth).as_video_stream_profile().get_intrinsics()
        # librealsense counts from the centre of the first pixel
        optics = Intrinsics(lens.fx, lens.fy, lens.ppx + 0.5, lens.ppy + 0.5)
        self._running = True
        self._thread = threading.Thread(target=self._take, args=(clock, scale, optics), name="realsense", daemon=True)
        self._thread.start()
        end = time.monotonic() + config.wait_s
        while self._latest is None:
            if time.monotonic() > end:
                self.stop()
                raise RobotError(f"RealSense: no image within {config.wait_s:g} s; plug the camera in again")
            time.sleep(0.01)

    def stop(self) -> None:
        """Close the camera. Safe to call twice."""
        self._running = False
        if self._thread is not None:
            self._thread.join(timeout=2.0)
            self._thread = None
        pipeline, self._pipeline = self._pipeline, None
        if pipeline is not None:
            pipeline.stop()

    def latest(self) -> DepthFrame | None:
        """The newest image."""
        return self._latest

    def _take(self, clock: Clock, scale: float, optics: Intrinsics) -> None:
        """Keep the newest image; one that never comes shows by the age of the last."""
        while self._running:
            arrived, frames = self._pipeline.try_wait_for_frames(100)
            depth = frames.get_depth_frame() if arrived else None
            if not depth:
                continue
            # copied: the frame's memory goes back to the camera
            image = to_metres(np.array(np.asanyarray(depth.get_data()), dtype=np.uint16), scale)
            stamp = clock.now_ns() - self._age_ns(depth)
            self._latest = DepthFrame(stamp, int(depth.get_frame_number()), image, optics)

    def _age_ns(self, depth: Any) -> int:
        """Time since the image was taken, ns; 0 where its stamp is that of a clock of the camera's own."""
        if depth.get_frame_timestamp_domain() == self._rs.timestamp_domain.hardware_clock:
            return 0
        return max(0, time.time_ns() - round(depth.get_timestamp() * 1e6))
