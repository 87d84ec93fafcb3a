"""Depth images against MuJoCo's renderer, against planes and walls in closed form, and their way to the robot."""

from __future__ import annotations

import dataclasses
import math
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from locorl.config import from_dict, to_dict
from locorl.env.depth_camera import DepthCamera, DepthConfig, mounted
from locorl.env.depth_stream import DepthStream
from locorl.env.raycast import RayCaster
from locorl.simulation.scene import PhysicsConfig, flat_scene
from locorl.terrain.heights import HeightGrid, level_ground
from locorl.terrain.map import TerrainConfig, TerrainMap
from locorl.terrain.tile import LOCOMOTION, PARKOUR
from torch.nn.functional import interpolate

CELL = 0.05
DT = 0.02
SMALL = DepthConfig(rows=24, columns=36)
PLAIN = dataclasses.replace(SMALL, position=(0.0, 0.0, 0.0), pitch=(0.0, 0.0))

angle = st.floats(-0.6, 0.6)
full_turn = st.floats(-math.pi, math.pi)


def quat_of(roll: float, pitch: float, yaw: float) -> np.ndarray:
    quat = np.zeros(4)
    mujoco.mju_euler2Quat(quat, [yaw, pitch, roll], "zyx")
    return quat


def turned(quat: np.ndarray, vector: np.ndarray) -> np.ndarray:
    result = np.zeros(3)
    mujoco.mju_rotVecQuat(result, vector, quat)
    return result


def pixel_rays(config: DepthConfig, quat: np.ndarray) -> np.ndarray:
    """Directions through the pixels, by similar triangles on the 60 x 106 sensor, (rows, columns, 3)."""
    half = math.tan(math.radians(87.0 / 2))
    raw_row = (np.arange(config.rows) + 0.5) * 58 / config.rows
    raw_column = 4 + (np.arange(config.columns) + 0.5) * 98 / config.columns
    up, left = np.meshgrid((30 - raw_row) / 53 * half, (53 - raw_column) / 53 * half, indexing="ij")
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat)
    return np.stack((np.ones_like(up), left, up), axis=-1) @ matrix.reshape(3, 3).T


def ground_of(height: Callable[[np.ndarray, np.ndarray], np.ndarray], reach: float = 4.0) -> HeightGrid:
    """`height` sampled at the middles of cells, so that faces at multiples of the cell are exact."""
    nodes = np.arange(-reach + CELL / 2, reach, CELL)
    return HeightGrid(height(*np.meshgrid(nodes, nodes, indexing="ij")), (nodes[0], nodes[0]), CELL)


def look(config: DepthConfig, ground: HeightGrid, position: tuple[float, float, float], quat: np.ndarray) -> np.ndarray:
    camera = DepthCamera(config, ground)
    return camera.render(torch.tensor([position]), torch.from_numpy(quat[None]))[0].numpy()


# --- against MuJoCo's renderer ---

RENDER = """
import sys
try:
    import mujoco, numpy as np
    model = mujoco.MjModel.from_binary_path(sys.argv[1])
    renderer = mujoco.Renderer(model, 60, 106)
except Exception as error:
    print(error, file=sys.stderr)
    sys.exit(77)
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
renderer.enable_depth_rendering()
images = []
for camera in range(model.ncam):
    renderer.update_scene(data, camera)
    images.append(renderer.render().copy())
np.save(sys.argv[2], images)
"""


def rendered(spec: mujoco.MjSpec, poses: list[tuple[np.ndarray, np.ndarray]], folder: Path) -> torch.Tensor:
    """What the sensor sees, cropped by two rows and four columns, by MuJoCo's renderer, (n, 58, 98), m, up to 2 m."""
    fovy = 2 * math.degrees(math.atan(math.tan(math.radians(87.0 / 2)) * 60 / 106))
    for position, quat in poses:
        # MuJoCo's cameras look along -z, with y up
        axes = turned(quat, np.array((0.0, -1.0, 0.0))), turned(quat, np.array((0.0, 0.0, 1.0)))
        matrix, camera_quat = np.stack((*axes, np.cross(*axes)), axis=1), np.zeros(4)
        mujoco.mju_mat2Quat(camera_quat, matrix.reshape(-1))
        spec.worldbody.add_camera(pos=position, quat=camera_quat, fovy=fovy)
    spec.stat.extent = 1.0
    spec.visual.map.znear, spec.visual.map.zfar = 0.001, 50.0
    model, images = folder / "scene.mjb", folder / "images.npy"
    mujoco.mj_saveModel(spec.compile(), str(model), None)
    environment = {"MUJOCO_GL": "egl", **os.environ} if sys.platform == "linux" else dict(os.environ)
    command = [sys.executable, "-c", RENDER, str(model), str(images)]
    # a process of its own: MuJoCo chooses how to draw when it is imported
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode == 77:
        pytest.skip(f"MuJoCo cannot draw without a screen here: {done.stderr.strip()}")
    assert done.returncode == 0, done.stderr
    return torch.from_numpy(np.load(images))[:, :-2, 4:-4].float().clamp(max=2.0)


BOXES = (  # x from, to, y from, to, top; over a floor 0.5 m lower
    (-2.0, 1.0, -4.0, 4.0, 0.0),
    (1.0, 1.3, -4.0, 4.0, 0.1),
    (1.3, 1.6, -4.0, 4.0, 0.2),
    (1.6, 3.0, -4.0, 4.0, 0.3),
    (3.4, 4.0, -4.0, 4.0, 0.0),
    (1.0, 1.5, -1.0, -0.5, 0.6),
    (2.4, 2.8, -0.6, 0.6, 0.55),
    (3.6, 3.8, 0.5, 1.5, 0.45),
)


def over_boxes(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    height = np.full(x.shape, -0.5)
    for x0, x1, y0, y1, top in BOXES:
        inside = (x0 <= x) & (x < x1) & (y0 <= y) & (y < y1)
        height[inside] = np.maximum(height[inside], top)
    return height


def test_steps_hurdles_and_gaps_look_as_in_the_renderer(tmp_path):
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], pos=[0, 0, -0.5])
    for x0, x1, y0, y1, top in BOXES:
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[(x0 + x1) / 2, (y0 + y1) / 2, (top - 1) / 2],
            size=[(x1 - x0) / 2, (y1 - y0) / 2, (top + 1) / 2],
        )
    rng = np.random.default_rng(1)
    poses = []
    while len(poses) < 24:
        position = np.array((rng.uniform(-1, 3.5), rng.uniform(-1.5, 1.5), rng.uniform(0.15, 0.8)))
        around = over_boxes(position[0] + np.array((-0.1, 0, 0.1)), position[1] + np.array((-0.1, 0, 0.1)))
        if position[2] > around.max() + 0.1:
            poses.append((position, quat_of(*rng.uniform((-0.3, -0.2, -math.pi), (0.3, 0.5, math.pi)))))
    truth = rendered(spec, poses, tmp_path)
    ground = ground_of(over_boxes, reach=7.0)
    position, quat = (torch.from_numpy(np.array(part)) for part in zip(*poses, strict=True))

    sensor = DepthCamera(DepthConfig(columns=98), ground).render(position, quat)
    error = (sensor - truth).abs()
    assert error.median() < 1e-4
    assert error.quantile(0.95) < 1e-3
    assert (error > 0.01).float().mean() < 1e-3  # silhouettes: a ray there may fall on either side

    for config in (DepthConfig(), SMALL):
        ours = DepthCamera(config, ground).render(position, quat)
        # sampled at the middles of the new pixels, as resizing does; depth is not linear, hence the tolerance
        resized = interpolate(truth[:, None], (config.rows, config.columns), mode="bilinear")[:, 0]
        error = (ours - resized).abs()
        assert error.median() < 1e-3
        assert error.quantile(0.8) < 1e-2


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["steps", "high_jump", "long_jump", "tilted_stones", "hills"])
def test_terrains_look_as_in_the_renderer(kind, tmp_path):
    tile = LOCOMOTION if kind in ("steps", "hills") else PARKOUR
    terrain = TerrainMap(TerrainConfig(kinds=(kind,), levels=3, columns=1, tile=tile))
    spec = flat_scene(PhysicsConfig())
    terrain.add_to(spec)
    rng = np.random.default_rng(2)
    length, poses = terrain.tile_length, []
    for _ in range(16):
        x = np.array((rng.uniform(-1.4 * length, 1.4 * length), rng.uniform(-0.5, 0.5)))
        ring = x + 0.15 * np.array([(math.cos(a), math.sin(a)) for a in np.linspace(0, 2 * math.pi, 16)])
        height = terrain.ground(ring[:, 0], ring[:, 1]).max() + 0.3
        poses.append((np.array((*x, height)), quat_of(*rng.uniform((-0.1, -0.1, -0.5), (0.1, 0.3, 0.5)))))
    truth = rendered(spec, poses, tmp_path)
    position, quat = (torch.from_numpy(np.array(part)) for part in zip(*poses, strict=True))
    error = (DepthCamera(DepthConfig(columns=98), terrain.heights).render(position, quat) - truth).abs()
    # the grid knows a face to half its cell
    assert error[truth < 2.0].quantile(0.9) < CELL
    assert (error > CELL).float().mean() < 0.02


# --- against closed forms ---


@given(st.floats(0.05, 1.5), angle, angle, full_turn, st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_tilted_plane(height, roll, pitch, yaw, slope_x, slope_y):
    ground = ground_of(lambda x, y: slope_x * x + slope_y * y)
    quat = quat_of(roll, pitch, yaw)
    rays = pixel_rays(SMALL, quat)
    with np.errstate(divide="ignore"):
        depth = height / (slope_x * rays[..., 0] + slope_y * rays[..., 1] - rays[..., 2])
    expected = np.where((depth > 0) & (depth < 2.0), depth, 2.0)
    np.testing.assert_allclose(look(SMALL, ground, (0.0, 0.0, height), quat), expected, atol=1e-3)


@given(st.floats(0.05, 1.5), angle, angle, full_turn)
def test_infinite_floor(height, roll, pitch, yaw):
    quat = quat_of(roll, pitch, yaw)
    with np.errstate(divide="ignore"):
        depth = -height / pixel_rays(SMALL, quat)[..., 2]
    expected = np.where((depth > 0) & (depth < 2.0), depth, 2.0)
    np.testing.assert_allclose(look(SMALL, level_ground(), (70.0, -30.0, height), quat), expected, atol=1e-4)


@given(st.integers(4, 39), st.floats(-0.6, 0.6))
def test_wall_at_a_known_distance(cells, yaw):
    distance = cells * CELL
    wall = ground_of(lambda x, y: np.where(x > distance, 5.0, -5.0))
    quat = quat_of(0.0, 0.0, yaw)
    expected = np.minimum(distance / pixel_rays(SMALL, quat)[..., 0], 2.0)
    np.testing.assert_allclose(look(SMALL, wall, (0.0, 0.0, 0.3), quat), expected, atol=1e-3)


@given(st.floats(0.2, 1.9))
def test_wall_between_the_nodes_is_right_to_half_a_cell(distance):
    wall = ground_of(lambda x, y: np.where(x > distance, 5.0, -5.0))
    depth = look(SMALL, wall, (0.0, 0.0, 0.3), quat_of(0.0, 0.0, 0.0))
    assert np.abs(depth - distance).max() < CELL / 2 + 1e-3


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.floats(-0.8, 0.8), full_turn, st.floats(0.0, 3.0))
def test_nothing_is_missed_or_made_up_among_blocks(seed, pitch, yaw, x):
    """Against a march in steps of 1 mm."""
    rng = np.random.default_rng(seed)
    blocks = np.where(rng.random((60, 40)) < 0.15, rng.uniform(0.1, 0.8, (60, 40)), rng.choice((-0.4, 0.0), (60, 40)))
    ground = HeightGrid(blocks.repeat(3, 0).repeat(3, 1), (-4.0, -3.0), CELL)
    config = dataclasses.replace(SMALL, rows=6, columns=9)
    origin = torch.tensor((x, 0.2, float(ground.at(torch.tensor((x, 0.2)))) + 0.25))
    rays = torch.from_numpy(pixel_rays(config, quat_of(0.0, pitch, yaw)).reshape(-1, 3)).float()
    speed = float(rays.norm(dim=1).max())
    depth = RayCaster(ground, reach=2.0, speed=speed, steepest=0.0).cast(origin[None], rays[None])[0]

    t = torch.arange(0.0, 2.0, 1e-3)
    points = origin + t[:, None, None] * rays
    below = points[..., 2] <= ground.at(points[..., :2])
    first = torch.where(below.any(0), t[below.int().argmax(0)], 2.0)
    found = depth.clamp(max=2.0)
    # a ray may clip a corner between two steps
    assert ((found - first).abs() < 2e-3).float().mean() > 0.95
    assert (found < first + 2e-3).all()
    touch = (origin + depth[:, None] * rays)[depth.isfinite()]
    hair = torch.tensor(((2e-3, 0.0), (-2e-3, 0.0), (0.0, 2e-3), (0.0, -2e-3)))
    assert (touch[:, 2] < ground.at(touch[:, :2] + hair[:, None]).amax(0) + 2e-3).all()


def test_sky_far_walls_and_the_land_beyond_the_grid():
    upwards = look(SMALL, ground_of(over_boxes), (-1.0, 0.0, 0.7), quat_of(0.0, -1.2, 0.0))
    np.testing.assert_array_equal(upwards, 2.0)
    far = look(SMALL, ground_of(lambda x, y: np.where(x > 2.1, 5.0, -5.0)), (0.0, 0.0, 0.3), quat_of(0.0, 0.0, 0.0))
    np.testing.assert_array_equal(far, 2.0)
    quat = quat_of(0.0, 0.3, 0.0)
    beyond = look(SMALL, ground_of(lambda x, y: np.full(x.shape, 0.2)), (50.0, -80.0, 0.6), quat)
    here = look(SMALL, level_ground(), (0.0, 0.0, 0.4), quat)
    np.testing.assert_allclose(beyond, here, atol=1e-4)
    assert here.min() < 1.0


def test_chunks_change_nothing():
    ground = ground_of(over_boxes)
    generator = torch.Generator().manual_seed(0)
    position = torch.rand(8, 3, generator=generator) * 2.0 + torch.tensor((-1.0, -1.0, 0.3))
    quat = torch.nn.functional.normalize(torch.randn(8, 4, generator=generator), dim=1)
    whole = DepthCamera(SMALL, ground, chunk=10**6).render(position, quat)
    for chunk in (1, 5000):
        torch.testing.assert_close(DepthCamera(SMALL, ground, chunk).render(position, quat), whole, rtol=0, atol=1e-5)


@given(st.tuples(angle, angle, full_turn), st.floats(-0.1, 0.1))
def test_mount(base, pitch):
    quat, tilt, expected = quat_of(*base), np.zeros(4), np.zeros(4)
    position, camera_quat = mounted(
        SMALL, torch.tensor([(1.0, 2.0, 0.3)]).double(), torch.from_numpy(quat[None]), torch.tensor([pitch]).double()
    )
    mujoco.mju_axisAngle2Quat(tilt, [0.0, 1.0, 0.0], pitch)
    mujoco.mju_mulQuat(expected, quat, tilt)
    np.testing.assert_allclose(camera_quat[0], expected, atol=1e-9)
    np.testing.assert_allclose(position[0], (1.0, 2.0, 0.3) + turned(quat, np.array((0.27, 0.0, 0.03))), atol=1e-7)


# --- the way to the robot ---

LEVEL = torch.tensor((1.0, 0.0, 0.0, 0.0))
WALL = ground_of(lambda x, y: np.where(x > 2.0, 5.0, -5.0))


def before_wall(distance: float, count: int = 1) -> tuple[torch.Tensor, torch.Tensor]:
    """Poses `distance` in front of the wall, which fills the image."""
    return torch.tensor((2.0 - distance, 0.0, 0.3)).expand(count, 3), LEVEL.expand(count, 4)


def stream_of(config: DepthConfig, ground: HeightGrid = WALL, count: int = 1, seed: int = 0) -> DepthStream:
    return DepthStream(config, ground, count, DT, seed)


def seen(stream: DepthStream) -> torch.Tensor:
    """Depth in the middle of each image, m."""
    c = stream.config
    return (stream.frame[:, c.rows // 2, c.columns // 2] + 0.5) * (c.far - c.near) + c.near


@pytest.mark.parametrize(("period", "latency"), [(5, 5), (5, 0), (5, 7), (1, 3), (3, 2), (4, 12)])
def test_image_arrives_after_the_latency(period, latency):
    stream = stream_of(dataclasses.replace(PLAIN, period=period * DT, latency=latency * DT))
    distance = [1.5 - 0.03 * tick for tick in range(40)]
    stream.reset(torch.tensor([0]), *before_wall(distance[0]))
    for tick in range(1, 40):
        stream.step(*before_wall(distance[tick]))
        taken = max(0, (tick - latency) // period * period)
        assert seen(stream).item() == pytest.approx(distance[taken], abs=1e-3)
        assert stream.fresh == ((tick - latency) % period == 0)


def test_default_is_the_image_before_last_at_10_hz():
    stream = stream_of(dataclasses.replace(DepthConfig(), position=(0.0, 0.0, 0.0), pitch=(0.0, 0.0)))
    stream.reset(torch.tensor([0]), *before_wall(1.0))
    images = []
    for tick in range(1, 16):
        stream.step(*before_wall(1.0 - 0.05 * tick))
        images.append(round(seen(stream).item(), 2))
    assert images == [1.0] * 9 + [0.75] * 5 + [0.5]
    assert stream.frame.shape == (1, 58, 87)


def test_restart_shows_the_new_place_at_once():
    stream = stream_of(PLAIN, count=2)
    stream.reset(torch.arange(2), *before_wall(1.0, 2))
    for _ in range(7):
        stream.step(*before_wall(1.0, 2))
    stream.reset(torch.tensor([1]), *before_wall(0.4))
    np.testing.assert_allclose(seen(stream), (1.0, 0.4), atol=1e-3)
    for tick in range(8, 16):
        stream.step(*before_wall(0.6, 2))
        # at tick 10 comes the image of tick 5, which was before the restart and is replaced by the one at it
        np.testing.assert_allclose(seen(stream), (1.0, 0.4) if tick < 15 else (0.6, 0.6), atol=1e-3)


def test_normalisation_and_clipping():
    config = dataclasses.replace(PLAIN, near=0.3, far=1.8, additive_noise=0.5, relative_noise=0.5, dropout=0.2)
    noisy = stream_of(config)
    noisy.reset(torch.tensor([0]), *before_wall(1.0))
    assert noisy.frame.min() == -0.5
    assert noisy.frame.max() == 0.5
    plain = stream_of(dataclasses.replace(PLAIN, near=0.3, far=1.8), count=3)
    position = torch.cat([before_wall(distance)[0] for distance in (0.1, 1.2, 1.9)])
    plain.reset(torch.arange(3), position, LEVEL.expand(3, 4))
    np.testing.assert_allclose(plain.frame[:, 12, 18], (-0.5, 0.9 / 1.5 - 0.5, 0.5), atol=1e-3)


def test_noise_has_its_standard_deviation():
    config = dataclasses.replace(PLAIN, relative_noise=0.03, additive_noise=0.02)
    stream = stream_of(config, count=20)
    for distance in (0.5, 1.0):
        stream.reset(torch.arange(20), *before_wall(distance, 20))
        depth = (stream.frame + 0.5) * 2.0
        std = math.hypot(0.03 * distance, 0.02)
        assert depth.std().item() == pytest.approx(std, rel=0.03)  # 17280 pixels: 0.5 %
        assert depth.mean().item() == pytest.approx(distance, abs=5 * std / math.sqrt(17280) + 1e-3)


def test_dropout_reads_far_and_misses_have_no_noise():
    config = dataclasses.replace(PLAIN, dropout=0.1, additive_noise=0.05)
    stream = stream_of(config, count=20)
    stream.reset(torch.arange(20), *before_wall(1.0, 20))
    assert (stream.frame == 0.5).float().mean().item() == pytest.approx(0.1, abs=0.01)
    stream.reset(torch.arange(20), *before_wall(2.5, 20))
    assert (stream.frame == 0.5).all()


def test_edges_lose_the_pixels_behind_them():
    pillar = ground_of(lambda x, y: np.where((x > 1.0) & (x < 1.2) & (np.abs(y) < 0.2) | (x > 1.6), 5.0, 0.0))
    pose = torch.tensor([(0.0, 0.0, 0.6)]), LEVEL[None]
    whole, torn = stream_of(PLAIN, pillar), stream_of(dataclasses.replace(PLAIN, edge_dropout=1.0), pillar)
    for stream in (whole, torn):
        stream.reset(torch.tensor([0]), *pose)
    lost = whole.frame[0] != torn.frame[0]
    assert (torn.frame[0][lost] == 0.5).all()
    # the wall behind the pillar, beside its left and right edges and nowhere else
    row = whole.frame[0, 8]
    near = (row - row.min()).abs() < 1e-3
    columns = near.nonzero().squeeze(1)
    assert lost[8].nonzero().squeeze(1).tolist() == [columns.min() - 1, columns.max() + 1]

    floor = stream_of(dataclasses.replace(PLAIN, edge_dropout=1.0), level_ground())
    floor.reset(torch.tensor([0]), torch.tensor([(0.0, 0.0, 0.3)]), LEVEL[None])
    assert (floor.frame[0, -5:] < 0.5).all()


def test_pitch_stays_until_the_reset():
    stream = stream_of(SMALL, count=60)
    stream.reset(torch.arange(60), *before_wall(1.0, 60))
    pitch = stream.pitch.clone()
    bound = math.radians(5.0)
    assert (pitch.abs() <= bound).all()
    assert pitch.min() < -0.9 * bound
    assert pitch.max() > 0.9 * bound
    for _ in range(6):
        stream.step(*before_wall(1.0, 60))
    assert torch.equal(stream.pitch, pitch)
    stream.reset(torch.tensor([3, 7]), *before_wall(1.0, 2))
    changed = (stream.pitch != pitch).nonzero().squeeze(1)
    assert changed.tolist() == [3, 7]


def test_image_follows_the_pitch_and_the_mount():
    stream = stream_of(SMALL, level_ground(), count=2)
    quat = quat_of(0.1, -0.1, 0.4)
    stream.reset(torch.arange(2), torch.tensor([(1.0, 2.0, 0.35)] * 2), torch.from_numpy(quat).expand(2, 4))
    for robot in range(2):
        tilt, camera = np.zeros(4), np.zeros(4)
        mujoco.mju_axisAngle2Quat(tilt, [0.0, 1.0, 0.0], stream.pitch[robot].item())
        mujoco.mju_mulQuat(camera, quat, tilt)
        height = 0.35 + turned(quat, np.array((0.27, 0.0, 0.03)))[2]
        depth = -height / pixel_rays(SMALL, camera)[..., 2]
        expected = np.where((depth > 0) & (depth < 2.0), depth, 2.0) / 2.0 - 0.5
        np.testing.assert_allclose(stream.frame[robot], expected, atol=1e-4)


def run(stream: DepthStream, first: int, last: int) -> list[torch.Tensor]:
    images = []
    for tick in range(first, last):
        stream.step(*before_wall(1.0 + 0.02 * tick, 3))
        if tick % 4 == 0:
            stream.reset(torch.tensor([tick % 3]), *before_wall(0.5))
        images.append(stream.frame.clone())
    return images


def test_saved_state_goes_on_bit_exactly():
    config = dataclasses.replace(SMALL, additive_noise=0.01, dropout=0.05)
    stream = stream_of(config, count=3)
    stream.reset(torch.arange(3), *before_wall(1.0, 3))
    run(stream, 0, 13)
    state = stream.state_dict()
    expected = run(stream, 13, 30)
    other = stream_of(config, count=3, seed=1)
    other.load_state_dict(state)
    assert all(torch.equal(a, b) for a, b in zip(run(other, 13, 30), expected, strict=True))
    with pytest.raises(ValueError, match="shape"):
        stream_of(config, count=4).load_state_dict(state)


def test_seeds():
    first, same, other = (stream_of(dataclasses.replace(SMALL, dropout=0.1), seed=seed) for seed in (3, 3, 4))
    for stream in (first, same, other):
        stream.reset(torch.tensor([0]), *before_wall(1.0))
    assert torch.equal(first.frame, same.frame)
    assert not torch.equal(first.frame, other.frame)


@pytest.mark.parametrize(
    "wrong",
    [
        {"rows": 0},
        {"crop_bottom": 60},
        {"field_of_view": 180.0},
        {"near": 2.0},
        {"additive_noise": -0.1},
        {"pitch": (1.0, -1.0)},
        {"dropout": 1.5},
    ],
)
def test_impossible_cameras_are_refused(wrong):
    with pytest.raises(ValueError, match="DepthConfig"):
        DepthConfig(**wrong)


def test_configuration_survives_json():
    assert from_dict(DepthConfig, to_dict(SMALL)) == SMALL


@pytest.mark.parametrize("name", ["period", "latency"])
def test_times_between_ticks_are_refused(name):
    with pytest.raises(ValueError, match=f"{name} is 0.033 s: choose a multiple of the control period"):
        stream_of(dataclasses.replace(SMALL, **{name: 0.033}))
