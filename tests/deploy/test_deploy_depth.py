"""Depth frames on their way to the network: geometry, holes, clip, scale and frames that show nothing."""

import json
import math
import operator
import queue
import sys
import time
from dataclasses import replace
from importlib.resources import files
from types import SimpleNamespace

import numpy as np
import pytest
from deploy.control.clock import WallClock
from deploy.depth.optics import DepthOptics
from deploy.depth.preprocess import DepthPreprocessor
from deploy.depth.realsense import RealSenseConfig, RealSenseDepth
from deploy.depth.sources import to_metres
from deploy.errors import RobotError
from deploy.interfaces import DepthFrame, Intrinsics
from hypothesis import given
from hypothesis import strategies as st

SMALL = DepthOptics(
    rows=2,
    columns=3,
    intrinsics=Intrinsics(fx=2.0, fy=4.0, cx=1.5, cy=1.5),
    near=0.2,
    far=2.2,
    raw_size=(3, 8),
    crop_bottom=1,
    crop_sides=1,
)
"""A sensor of 3 x 8 px, whose last row and outer columns are left out; pairs of columns become one."""


def d435(rows: int = 58, columns: int = 87) -> DepthOptics:
    """The camera of Extreme Parkour: 60 x 106 px, 87 deg, cropped to 58 x 98, resized."""
    focal = 53.0 / math.tan(math.radians(43.5))
    x, y = columns / 98, rows / 58
    optics = Intrinsics(focal * x, focal * y, 0.5 * columns, 30.0 * y)
    return DepthOptics(rows, columns, optics, 0.0, 2.0, (60, 106), 2, 4)


def frame(image: np.ndarray, camera: Intrinsics | None = None) -> DepthFrame:
    return DepthFrame(0, 0, image.astype(np.float32), camera)


def test_16uc1_by_hand():
    raw = np.array(
        [
            [9, 1200, 700, 4000, 1200, 0, 2200, 9],
            [9, 0, 0, 100, 200, 1700, 0, 9],
            [9, 9, 9, 9, 9, 9, 9, 9],
        ],
        dtype=np.uint16,
    )
    reading = DepthPreprocessor(SMALL)(frame(to_metres(raw)))
    # The border of two columns goes to the right one: columns 2, 4 and 6. Holes: (1, 2) has none around it and
    # reads far; (1, 6) takes its left neighbour 1700. (d - 0.2) / 2 - 0.5:
    expected = [[-0.25, 0.0, 0.5], [0.5, -0.5, 0.25]]
    np.testing.assert_allclose(reading.image, expected, atol=1e-6)
    assert reading.image.dtype == np.float32
    assert reading.measured == pytest.approx(5 / 6)
    assert reading.fault is None


def test_nearest_hole_filler_then_row_then_column():
    optics = replace(SMALL, rows=1, columns=1, intrinsics=Intrinsics(1 / 3, 1 / 3, 0.5, 0.5), raw_size=(3, 3))
    optics = replace(optics, crop_bottom=0, crop_sides=0, near=0.0, far=10.0)
    image = np.array([[1.0, 2.0, 3.0], [4.0, 0.0, 5.0], [6.0, 7.0, 8.0]])
    found = []
    for _ in range(9):
        reading = DepthPreprocessor(optics)(frame(image))
        found.append(round(float(reading.image[0, 0] + 0.5) * 10.0, 4))
        image[image == found[-1]] = np.nan
    assert found == [2.0, 4.0, 5.0, 7.0, 1.0, 3.0, 6.0, 8.0, 10.0]  # the last: nothing left, far


def test_resize_looks_through_the_centre_of_each_pixel():
    # 848 x 480 is 8 times the sensor: image column 43 of 87 looks straight ahead, between columns 423 and 424.
    columns = np.tile(np.arange(1.0, 849.0), (480, 1))
    optics = replace(d435(), far=10_000.0)
    image = (DepthPreprocessor(optics)(frame(columns)).image + 0.5) * 10_000.0
    assert image[0, 43] == pytest.approx(425.0, abs=0.01)
    # column 0: (0 + 0.5) * 98 / 87 = 0.563 px of the crop, 4.563 of the sensor, 36.5 of the frame: pixel 36
    assert image[10, 0] == pytest.approx(37.0, abs=0.01)
    assert image[10, 86] == pytest.approx(812.0, abs=0.01)
    rows = np.tile(np.arange(1.0, 481.0)[:, None], (1, 848))
    image = (DepthPreprocessor(optics)(frame(rows)).image + 0.5) * 10_000.0
    # row 57 of 58: 57.5 px of the sensor, 460 of the frame, so 20 rows before the end: two of 60 are cropped below
    np.testing.assert_allclose(image[[0, 57], 5], [5.0, 461.0], atol=0.01)


@pytest.mark.parametrize(
    ("size", "camera"),
    [
        ((480, 848), None),
        ((720, 1272), None),
        ((480, 848), Intrinsics(424.0, 424.0, 420.5, 243.0)),
        ((480, 640), Intrinsics(300.0, 310.0, 322.0, 236.0)),
    ],
)
@pytest.mark.parametrize("shape", [(58, 87), (24, 36)])
def test_a_plane_is_seen_as_the_rays_of_training_meet_it(size, camera, shape):
    optics = d435(*shape)
    normal, distance = np.array([0.35, 0.25, -1.0]), 0.6  # a slope below the camera: n . p = distance

    def depth_along(directions):
        towards = directions @ normal
        return np.where(towards > 0.05, distance / np.maximum(towards, 0.05), np.inf)

    used = camera or optics.sensor(*size)
    right = (np.arange(size[1]) + 0.5 - used.cx) / used.fx
    down = (np.arange(size[0]) + 0.5 - used.cy) / used.fy
    pixels = np.stack(np.broadcast_arrays(1.0, -right[None], -down[:, None]), axis=-1)
    reading = DepthPreprocessor(optics)(frame(depth_along(pixels), camera))
    exact = np.clip(depth_along(optics.rays()), optics.near, optics.far) / 2.0 - 0.5
    # half a pixel of the frame turns a ray by 1/600 at most: inverse depth changes by |normal| / distance times that
    inverse = 1.0 / (2.0 * (reading.image + 0.5)), 1.0 / (2.0 * (exact + 0.5))
    np.testing.assert_allclose(*inverse, atol=1.1 / 0.6 / 300.0)
    assert 0.2 < np.mean(exact < 0.49) < 0.9


def test_a_simulated_camera_gives_the_same_image_as_a_real_one():
    optics = d435()
    wall = np.full((58, 87), 1.3)
    np.testing.assert_array_equal(
        DepthPreprocessor(optics)(frame(wall)).image, DepthPreprocessor(optics)(frame(np.full((480, 848), 1.3))).image
    )


def test_rays_look_where_the_manifest_says():
    rays = d435().rays()
    assert rays.shape == (58, 87, 3)
    np.testing.assert_allclose(rays[:, 43, 1], 0.0, atol=1e-12)  # the middle column looks straight ahead
    half = math.tan(math.radians(43.5)) * (1 - 4 / 53) * (1 - 1 / 87)  # without 4 columns, and half a pixel
    np.testing.assert_allclose(rays[0, [0, 86], 1], [half, -half])  # left is positive
    focal = 53.0 / math.tan(math.radians(43.5))
    np.testing.assert_allclose(rays[[0, 57], 0, 2], [29.5 / focal, -27.5 / focal])  # two rows fewer below


@given(depth=st.floats(0.0009765625, 10.0, width=32), near=st.floats(0.0, 0.5), far=st.floats(1.0, 5.0))
def test_scale_is_the_rule_of_the_schema(depth, near, far):
    schema = json.loads(files("deploy").joinpath("bundle.schema.json").read_text())
    rule = schema["properties"]["depth"]["properties"]["image"]["properties"]["rule"]["const"]
    names = {"clip": lambda x, low, high: min(max(x, low), high), "depth": depth, "near": near, "far": far}
    optics = replace(SMALL, near=near, far=far)
    image = DepthPreprocessor(optics)(frame(np.full((2, 3), depth))).image
    np.testing.assert_allclose(image, eval(rule, {}, names), atol=1e-6)
    assert -0.500001 < image.min() <= image.max() < 0.500001


def test_infinite_depths_are_measurements():
    image = np.array([[np.inf, -np.inf, 1.2], [np.nan, 0.0, -3.0]])
    reading = DepthPreprocessor(SMALL)(frame(image))
    np.testing.assert_allclose(reading.image, [[0.5, -0.5, 0.0], [0.5, 0.5, 0.5]], atol=1e-6)
    assert (reading.measured, reading.fault) == (0.5, None)


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (np.zeros((3, 8)), "every pixel is 0"),
        (np.full((3, 8), np.nan), "every pixel is NaN"),
        (np.where(np.arange(24).reshape(3, 8) % 2, np.nan, 0.0), "no pixel holds a measurement"),
        (np.full((2, 3), np.nan), "every pixel is NaN"),
    ],
)
def test_frames_that_show_nothing_are_told_apart(image, words):
    reading = DepthPreprocessor(SMALL)(frame(image))
    assert reading.fault is not None
    assert words in reading.fault
    assert reading.measured == 0.0
    np.testing.assert_array_equal(reading.image, 0.5)


@pytest.mark.parametrize(("pixels", "fault"), [(9, "only 9.0% of the image is measured, need 10%"), (10, None)])
def test_a_nearly_blind_camera_is_a_fault(pixels, fault):
    optics = replace(SMALL, rows=10, columns=10)
    image = np.zeros(100)
    image[:pixels] = 1.0
    reading = DepthPreprocessor(optics)(frame(image.reshape(10, 10)))
    assert reading.measured == pytest.approx(pixels / 100)
    assert reading.fault is None if fault is None else fault in str(reading.fault)


def test_frames_may_change_their_size():
    preprocess = DepthPreprocessor(SMALL)
    for size in ((3, 8), (2, 3), (6, 16), (3, 8)):
        np.testing.assert_allclose(preprocess(frame(np.full(size, 1.2))).image, 0.0, atol=1e-6)


def test_what_a_wider_camera_misses_reads_far():
    # the ray of the outermost columns leaves a frame that is cut by one column of 87 on the left: 1.1 %
    optics = d435()
    full = optics.sensor(480, 848)
    cut = replace(full, cx=full.cx - 38.0)
    reading = DepthPreprocessor(optics)(frame(np.full((480, 810), 1.0), cut))
    np.testing.assert_array_equal(reading.image[:, 0], 0.5)
    np.testing.assert_allclose(reading.image[:, 1:], 0.0, atol=1e-6)
    assert reading.measured == pytest.approx(86 / 87)
    assert reading.fault is None


def test_a_narrower_camera_is_refused():
    with pytest.raises(RobotError, match=r"misses \d+% of the image"):
        DepthPreprocessor(d435())(frame(np.ones((480, 848)), Intrinsics(600.0, 600.0, 424.0, 240.0)))


def test_another_aspect_ratio_needs_intrinsics():
    with pytest.raises(RobotError, match=r"640 x 480 px, the policy was trained with a sensor of 106 x 60"):
        DepthPreprocessor(d435())(frame(np.ones((480, 640))))


@pytest.mark.parametrize("shape", [(480,), (0, 848), (480, 848, 1)])
def test_no_image_is_refused(shape):
    with pytest.raises(RobotError, match="a frame has shape"):
        DepthPreprocessor(d435())(frame(np.ones(shape)))


def test_units():
    np.testing.assert_allclose(to_metres(np.array([[1500]], np.uint16)), [[1.5]], rtol=1e-6)
    np.testing.assert_allclose(to_metres(np.array([[1500]], np.uint16), 1e-4), [[0.15]], rtol=1e-6)
    np.testing.assert_array_equal(to_metres(np.array([[1.5]], np.float32)), [[1.5]])
    with pytest.raises(RobotError, match="pixels are uint8"):
        to_metres(np.zeros((1, 1), np.uint8))


def test_optics_of_a_manifest():
    depth = {
        "image": {"rows": 58, "columns": 87},
        "camera": {
            **{"position": [0.27, 0, 0.03], "pitch": [-0.1, 0.1], "fx": 49.6, "fy": 55.9, "cx": 43.5, "cy": 30.0},
            **{"near": 0.0, "far": 2.0, "raw_size": [60, 106], "crop_bottom": 2, "crop_sides": 4},
        },
    }
    found = DepthOptics.from_manifest(depth)
    assert found == DepthOptics(58, 87, Intrinsics(49.6, 55.9, 43.5, 30.0), 0.0, 2.0, (60, 106), 2, 4)


# ---------------------------------------------------------------------------------------------- RealSense


class StandIn:
    """A stand-in for pyrealsense2: one camera, whose images a test hands over."""

    stream = SimpleNamespace(depth="depth")
    format = SimpleNamespace(z16="z16")
    timestamp_domain = SimpleNamespace(hardware_clock="hardware", global_time="global")

    def __init__(self):
        self.images, self.asked, self.stopped, self.refusal = queue.Queue(), [], 0, None

    def config(self):
        return SimpleNamespace(
            enable_stream=lambda *words: self.asked.append(words),
            enable_device=lambda serial: self.asked.append(serial),
        )

    def pipeline(self):
        return self

    def start(self, streams):
        if self.refusal:
            raise RuntimeError(self.refusal)
        lens = SimpleNamespace(fx=425.0, fy=426.0, ppx=423.0, ppy=239.0)
        video = SimpleNamespace(get_intrinsics=lambda: lens)
        sensor = SimpleNamespace(get_depth_scale=lambda: 1e-4)
        return SimpleNamespace(
            get_device=lambda: SimpleNamespace(first_depth_sensor=lambda: sensor),
            get_stream=lambda kind: SimpleNamespace(as_video_stream_profile=lambda: video),
        )

    def stop(self):
        self.stopped += 1

    def try_wait_for_frames(self, milliseconds):
        try:
            image = self.images.get(timeout=milliseconds * 1e-3)
        except queue.Empty:
            return False, None
        return True, SimpleNamespace(get_depth_frame=lambda: image)

    def give(self, counts, number, domain="global", age_ms=0.0):
        pixels = np.array(counts, dtype=np.uint16)
        self.images.put(
            SimpleNamespace(
                get_data=lambda: pixels,
                get_frame_number=lambda: number,
                get_frame_timestamp_domain=lambda: domain,
                get_timestamp=lambda: time.time() * 1e3 - age_ms,
            )
        )
        return pixels


@pytest.fixture
def sensor(monkeypatch):
    """A stand-in for pyrealsense2."""
    made = StandIn()
    monkeypatch.setitem(sys.modules, "pyrealsense2", made)
    return made


def until(condition):
    end = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < end, "nothing happened in time"
        time.sleep(0.005)


def test_realsense_images_have_units_time_and_intrinsics(sensor):
    camera, clock = RealSenseDepth(RealSenseConfig(serial="7")), WallClock()
    pixels = sensor.give([[0, 10000], [20000, 65535]], 41, age_ms=500.0)
    camera.start(clock)
    assert sensor.asked == ["7", ("depth", 848, 480, "z16", 30)]
    frame = camera.latest()
    pixels[:] = 0  # the driver uses its memory again
    np.testing.assert_allclose(frame.image_m, [[0.0, 1.0], [2.0, 6.5535]], rtol=1e-6)
    assert (frame.seq, frame.intrinsics) == (41, Intrinsics(425.0, 426.0, 423.5, 239.5))
    assert 0.4e9 < clock.now_ns() - frame.stamp_ns < 5e9
    sensor.give([[1, 2], [3, 4]], 42, domain="hardware", age_ms=-1e9)  # a clock of the camera's own
    until(lambda: camera.latest().seq == 42)
    assert 0 <= clock.now_ns() - camera.latest().stamp_ns < 5e9
    camera.stop()
    camera.stop()
    assert sensor.stopped == 1


def test_a_realsense_that_gives_no_images(sensor):
    camera = RealSenseDepth(RealSenseConfig(wait_s=0.2))
    with pytest.raises(RobotError, match=r"no image within 0.2 s"):
        camera.start(WallClock())
    assert sensor.stopped == 1
    assert camera.latest() is None


def test_a_realsense_that_is_not_there(sensor):
    sensor.refusal = "No device connected"
    with pytest.raises(RobotError, match=r"848 x 480 depth at 30 Hz \(No device connected\); is the camera on a USB 3"):
        RealSenseDepth().start(WallClock())


def test_without_pyrealsense2_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(RobotError, match=r"pip install 'legged-deploy\[realsense\]'"):
        RealSenseDepth().start(WallClock())


def test_a_pyrealsense2_without_its_system_library_names_it(monkeypatch, tmp_path):
    (tmp_path / "pyrealsense2.py").write_text(
        "raise ImportError('libusb-1.0.so.0: cannot open shared object file: No such file or directory')"
    )
    monkeypatch.delitem(sys.modules, "pyrealsense2", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(RobotError, match=r"libusb-1\.0\.so\.0.*apt install libusb-1\.0-0"):
        RealSenseDepth().start(WallClock())


def test_the_stand_in_has_the_names_of_pyrealsense2(monkeypatch):
    rs = pytest.importorskip("pyrealsense2", reason="needs pyrealsense2 and the system's libusb", exc_type=ImportError)
    for name in ("stream.depth", "format.z16", "timestamp_domain.hardware_clock", "config.enable_device"):
        operator.attrgetter(name)(rs)
    operator.attrgetter("pipeline.try_wait_for_frames", "depth_sensor.get_depth_scale", "intrinsics.ppx")(rs)
    operator.attrgetter("depth_frame.get_frame_timestamp_domain", "stream_profile.as_video_stream_profile")(rs)
    with pytest.raises(RobotError, match="No device connected"):
        RealSenseDepth().start(WallClock())
