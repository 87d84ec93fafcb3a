"""Terrains against rays, balls and hand-computed dimensions in compiled MuJoCo scenes."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from importlib.metadata import EntryPoint

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from locorl.config import from_dict, to_dict
from locorl.simulation.scene import PhysicsConfig, flat_scene
from locorl.terrain import kinds as kinds_module
from locorl.terrain.kinds import COURSES, KINDS
from locorl.terrain.map import TerrainConfig, TerrainMap
from locorl.terrain.surface import box_top
from locorl.terrain.tile import LOCOMOTION, PARKOUR, Box, Tile

VERTICAL = ("steps_up", "steps_down", "hurdles", "platforms", "long_jump")
DOWN = np.array([0.0, 0.0, -1.0])


class Scene:
    """A map compiled into a flat scene, and rays into it."""

    def __init__(self, terrain: TerrainMap) -> None:
        spec = flat_scene(PhysicsConfig())
        terrain.add_to(spec)
        self.terrain = terrain
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        self._geom = np.zeros(1, np.int32)

    def height(self, x, y) -> np.ndarray:
        """Height that a ray from 5 m above meets at each point."""
        points = np.column_stack([a.ravel() for a in np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))])
        ray = [self._ray(np.array([*point, 5.0])) for point in points]
        return (5.0 - np.array(ray)).reshape(np.broadcast(x, y).shape)

    def _ray(self, start: np.ndarray) -> float:
        return mujoco.mj_ray(self.model, self.data, start, DOWN, None, 1, -1, self._geom)

    def tile_points(self, level: int, column: int, n: int, seed: int = 0) -> np.ndarray:
        """Random points of one tile, (n, 2)."""
        terrain = self.terrain
        half = terrain.tile_width / 2
        rng = np.random.default_rng((seed, level, column))
        corner = terrain.tile_corner(level, column)
        return rng.uniform((0, -half), (terrain.tile_length, half), (n, 2)) + corner


def config(kind: str, **changes) -> TerrainConfig:
    tile = PARKOUR if kind in COURSES else LOCOMOTION
    return replace(TerrainConfig(kinds=(kind,), levels=3, columns=2, tile=tile, seed=3), **changes)


@lru_cache
def scene(kind: str, levels: int = 3) -> Scene:
    return Scene(TerrainMap(config(kind, levels=levels)))


def tiles(terrain: TerrainMap):
    return [(i, j) for i in range(terrain.obstacle.shape[0]) for j in range(terrain.obstacle.shape[1])]


# ---------------------------------------------------------------------- heights


@pytest.mark.parametrize("kind", KINDS)
def test_the_ground_is_what_a_ray_from_above_meets(kind):
    world = scene(kind)
    for level, column in tiles(world.terrain):
        x, y = world.tile_points(level, column, 80).T
        np.testing.assert_allclose(world.terrain.ground(x, y), world.height(x, y), atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_nodes_of_the_grid_hold_the_ground(kind):
    world = scene(kind)
    grid = world.terrain.heights
    rng = np.random.default_rng(1)
    nodes = np.column_stack([rng.integers(0, size, 500) for size in grid.shape])
    x, y = (np.array(grid.origin) + grid.cell * nodes).T
    # a node may lie on a face, where rays beside it differ by its whole height
    beside = np.stack([world.height(x + dx, y + dy) for dx in (-1e-5, 1e-5) for dy in (-1e-5, 1e-5)])
    held = grid.heights[nodes[:, 0], nodes[:, 1]].double().numpy()
    assert (held >= beside.min(axis=0) - 2e-5).all()
    assert (held <= beside.max(axis=0) + 2e-5).all()


@pytest.mark.parametrize("kind", KINDS)
def test_ground_around_the_map_is_level(kind):
    world = scene(kind)
    terrain = world.terrain
    x, y = (
        1.5 * terrain.tile_length + np.array([0.5, 3.0, 0.0, -2.0]),
        terrain.tile_width + np.array([0.0, 2.0, 5.0, 9]),
    )
    sides = np.array([[x, y], [-x, y], [x, -y], [-x, -y]]).swapaxes(1, 2).reshape(-1, 2)
    np.testing.assert_allclose(world.height(*sides.T), 0.0, atol=1e-9)
    points = torch.from_numpy(sides)
    assert (terrain.heights.at(points) == 0.0).all()
    assert (terrain.heights.interpolate(points) == 0.0).all()


@given(
    st.tuples(*[st.floats(-1, 1)] * 3),
    st.tuples(*[st.floats(0.1, 1)] * 3),
    st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1),
)
def test_the_top_of_any_box_is_where_a_ray_meets_it(centre, half_size, quat):
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=centre, size=half_size, quat=quat)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    rng = np.random.default_rng(0)
    points = rng.uniform(-2, 2, (40, 2))
    geom = np.zeros(1, np.int32)
    ray = [mujoco.mj_ray(model, data, np.array([*p, 5.0]), DOWN, None, 1, -1, geom) for p in points]
    expected = np.where(np.array(ray) < 0, -np.inf, 5.0 - np.array(ray))
    np.testing.assert_allclose(box_top(Box(centre, half_size, quat), *points.T), expected, atol=1e-6)


@pytest.mark.parametrize("kind", VERTICAL)
def test_faces_are_vertical(kind):
    world = scene(kind)
    terrain = world.terrain
    corner = terrain.tile_corner(2, 0)
    x = corner[0] + np.arange(0, terrain.tile_length, 0.002)
    for y in (corner[1] + 0.013, corner[1] - 0.31):
        change = np.abs(np.diff(world.height(x, y)))
        jumps = change[change > 1e-7]
        assert len(jumps) >= 6
        assert jumps.min() > 0.049  # a ramp would show as many small changes


@pytest.mark.parametrize("kind", ["hills", "slope_up", "slope_down"])
def test_relief_has_no_edges_and_ends_level(kind):
    world = scene(kind)
    terrain = world.terrain
    for level, column in tiles(terrain):
        points = torch.from_numpy(world.tile_points(level, column, 500))
        assert not terrain.heights.near_edge(points).any()
        (x, y), half = terrain.tile_corner(level, column), terrain.tile_width / 2
        side = np.linspace(0, terrain.tile_length, 30)
        np.testing.assert_allclose(world.height(x + side, y + half), 0.0, atol=1e-5)
        np.testing.assert_allclose(world.height(np.full(9, x), y + np.linspace(-half, half, 9)), 0.0, atol=1e-5)


@pytest.mark.parametrize("kind", ["steps_up", "hurdles", "long_jump"])
def test_edges_are_near_real_edges_only(kind):
    world = scene(kind)
    reach = np.arange(-0.1, 0.101, 0.0125)
    for level in (1, 2):
        # half of the points anywhere, half beside a box
        points = world.tile_points(level, 0, 60, seed=5)
        rng = np.random.default_rng(level)
        for i in range(0, 60, 2):
            box = world.terrain.boxes[rng.integers(len(world.terrain.boxes))]
            if max(box.half_size) < 5:
                points[i] = np.array(box.centre[:2]) + (box.half_size[0] * rng.choice((-1, 1)), 0.0)
                points[i] += rng.uniform(-0.12, 0.12, 2)
        flagged = world.terrain.heights.near_edge(torch.from_numpy(points)).numpy()
        x, y = points.T[:, :, None]
        along_x = np.ptp(world.height(x + reach[None, 6:11] / 2, y + 0 * reach[None, 6:11]), axis=1)
        around = world.height(x[:, :, None] + reach[None, :, None], y[:, :, None] + reach[None, None, :])
        assert flagged[along_x > 0.06].all()
        assert not flagged[np.ptp(around, axis=(1, 2)) < 0.05].any()
        assert flagged.any()
        assert not flagged.all()


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "flat"])
def test_a_ball_rests_where_the_grid_says(kind):
    """Balls on vertical rails at starts, waypoints and random places away from edges."""
    terrain = scene(kind).terrain
    world, radius = scene(kind), 0.02
    points = torch.cat((terrain.origins[..., :2].reshape(-1, 2), terrain.waypoints[..., :2].reshape(-1, 2))).double()
    random = torch.from_numpy(np.concatenate([world.tile_points(*tile, 8) for tile in tiles(terrain)]))
    if kind not in ("hills", "slope", "slope_up", "slope_down"):
        around = torch.tensor([[dx, dy] for dx in (-0.06, 0, 0.06) for dy in (-0.06, 0, 0.06)])
        beside = terrain.heights.at(random[:, None] + around)
        random = random[beside.amax(dim=1) - beside.amin(dim=1) < 0.045]
    points = torch.cat((points, random))
    spec = flat_scene(PhysicsConfig(solver_iterations=20))
    terrain.add_to(spec)
    expected = terrain.heights.interpolate(points).double().numpy()
    for (x, y), z in zip(points.tolist(), expected, strict=True):
        body = spec.worldbody.add_body(pos=[x, y, z + 0.06])
        body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1])
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], mass=0.1, contype=1, conaffinity=0)
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    model = spec.compile()
    data = mujoco.MjData(model)
    for _ in range(80):
        mujoco.mj_step(model, data)
    assert np.abs(data.qvel).max() < 0.02
    rest = data.xpos[1:, 2] - radius
    # a ball on a slope touches it uphill of its middle: radius * (1 / cos - 1) is 3 mm at slope 0.6
    np.testing.assert_allclose(rest, expected, atol=0.006)


# ------------------------------------------------------------------- dimensions


@pytest.mark.parametrize(("level", "height"), [(0, 0.05), (1, 0.23)])
@pytest.mark.parametrize("kind", ["steps_up", "steps_down"])
def test_dimensions_of_stairs(kind, level, height):
    world = scene(kind, levels=2)
    x, y, z = world.terrain.origins[level, 0].tolist()
    line = x + np.arange(0.0, 4.0, 0.001)
    profile = world.height(line, y)
    steps = np.flatnonzero(np.abs(np.diff(profile)) > 0.01)
    rises = np.diff(profile)[steps]
    treads = np.diff(line[steps])
    np.testing.assert_allclose(np.abs(rises), height, atol=1e-6)
    assert world.terrain.obstacle[level, 0].item() == pytest.approx(height)
    if kind == "steps_down":
        assert z == pytest.approx(7 * height, abs=1e-5)
        assert (rises < 0).all()
        assert len(rises) == 7
        np.testing.assert_allclose(treads, 0.31, atol=0.0021)
    else:
        assert z == 0.0
        assert np.sign(rises).tolist() == [1] * 4 + [-1] * 4
        np.testing.assert_allclose(np.delete(treads, 3), 0.31, atol=0.0021)
    for quarter in ((0, 1), (-1, 0), (0, -1)):  # the same whichever way the robot goes
        np.testing.assert_allclose(
            world.height(x + quarter[0] * (line - x), y + quarter[1] * (line - x))[::37], profile[::37], atol=1e-6
        )


@pytest.mark.parametrize(("kind", "sign"), [("slope_up", 1), ("slope_down", -1)])
def test_dimensions_of_slopes(kind, sign):
    world = scene(kind, levels=2)
    assert np.ptp(world.height(*world.tile_points(0, 0, 100).T)) < 1e-6  # difficulty 0 is level
    x, y, z = world.terrain.origins[1, 1].tolist()
    assert z == pytest.approx(-sign * 0.4 * 2.4, abs=1e-5)
    out = world.height(x + np.array([0.0, 1.5, 2.0, 3.0, 4.0]), y)
    np.testing.assert_allclose(out - z, sign * 0.4 * np.array([0, 0, 0.4, 1.4, 2.4]), atol=1e-5)


def test_dimensions_of_hills():
    world = scene("hills", levels=2)
    for level, amplitude in ((0, 0.06), (1, 0.28)):
        heights = world.height(*world.tile_points(level, 0, 800).T)
        assert np.abs(heights).max() <= amplitude
        assert np.ptp(heights) > amplitude
    assert world.terrain.obstacle[:, 0].tolist() == pytest.approx([0.06, 0.28])


def spans(world: Scene, line: np.ndarray, y: float, solid) -> list[float]:
    """Lengths of the stretches of a line on which `solid(height)` holds, those at the ends excluded."""
    inside = solid(world.height(line, np.full(line.shape, y)))
    edges = np.flatnonzero(np.diff(inside.astype(int)))
    lengths = np.diff(line[edges])
    return lengths[0 if inside[edges[0] + 1] else 1 :: 2].tolist()


@pytest.mark.parametrize(("level", "depth", "low", "high"), [(0, 0.1, 0.1, 0.15), (1, 0.4, 0.2, 0.4)])
def test_dimensions_of_hurdles(level, depth, low, high):
    world = scene("hurdles", levels=2)
    for column in range(2):
        points = world.terrain.waypoints[level, column].double().numpy()
        tops = points[1:7]
        assert ((tops[:, 2] >= low - 1e-6) & (tops[:, 2] <= high + 1e-6)).all()
        assert world.terrain.obstacle[level, column].item() == pytest.approx(tops[:, 2].max(), abs=1e-6)
        spacing = np.diff(tops[:, 0])
        assert ((spacing >= 1.2 - 1e-4) & (spacing <= 2.2 + 1e-4)).all()
        for x, y, z in tops:
            line = x + np.arange(-0.5, 0.5, 0.001)
            assert spans(world, line, y, lambda h: h > 0.05) == pytest.approx([depth], abs=0.0021)
            across = world.height(np.full(2001, x), y + np.arange(-1, 1.001, 0.001)) > 0.05
            assert 0.8 - 0.003 < across.sum() * 0.001 < 1.6 + 0.003
            assert abs(y - world.terrain.tile_corner(level, column)[1]) <= 0.4 + 1e-5
            assert world.height(x, y) == pytest.approx(z, abs=1e-6)


@pytest.mark.parametrize(("level", "height"), [(0, 0.1), (1, 0.45)])
def test_dimensions_of_platforms(level, height):
    world = scene("platforms", levels=2)
    for column in range(2):
        points = world.terrain.waypoints[level, column].double().numpy()
        np.testing.assert_allclose(points[:, 2], height * np.array([0, 1, 2, 3, 3, 2, 1, 0]), atol=1e-5)


@pytest.mark.parametrize(("level", "gap"), [(0, 0.1), (1, 0.8)])
def test_dimensions_of_gaps(level, gap):
    world = scene("long_jump", levels=2)
    for column in range(2):
        x, y = world.terrain.tile_corner(level, column)
        points = world.terrain.waypoints[level, column].double().numpy()
        line = x + np.arange(0, 18, 0.001)
        # every ledge reaches at least 0.2 m to both sides of the middle line
        gaps = spans(world, line, y, lambda h: h < -0.5)
        assert gaps == pytest.approx([gap] * 6, abs=0.0021)
        ledges = spans(world, line, y, lambda h: h > -0.5)
        assert len(ledges) == 5
        assert all(0.8 - 0.003 < ledge < 1.5 + 0.003 for ledge in ledges)
        np.testing.assert_allclose(points[:, 2], 0.0, atol=1e-6)
        assert world.height(line, np.full(line.shape, y)).min() == pytest.approx(-1.0)


def test_dimensions_of_tilted_stones():
    world = scene("tilted_stones", levels=2)
    for level in range(2):
        for column in range(2):
            points = world.terrain.waypoints[level, column].double().numpy()[1:7]
            rise = world.height(points[:, 0], points[:, 1] + 0.3) - world.height(points[:, 0], points[:, 1] - 0.3)
            np.testing.assert_allclose(np.abs(rise), 0.6 * 0.25 * level, atol=1e-5)
            middle = points[:, 1] - world.terrain.tile_corner(level, column)[1]
            assert (np.sign(middle[1:]) == -np.sign(middle[:-1])).all()
            if level:
                assert (np.sign(rise) == np.sign(middle)).all()
            gaps = np.diff(points[:, 0]) - 0.9
            assert ((gaps >= -0.1 - 1e-4) & (gaps <= 0.1 + 0.3 * level + 1e-4)).all()


# ------------------------------------------------------------- starts, waypoints


@pytest.mark.parametrize("kind", COURSES)
def test_waypoints_lead_along_the_tile(kind):
    world = scene(kind)
    terrain = world.terrain
    assert terrain.waypoints.shape[2:] == (8, 3)
    for level, column in tiles(terrain):
        points = terrain.waypoints[level, column].double().numpy()
        near, middle = terrain.tile_corner(level, column)
        assert (np.diff(points[:, 0]) > 0.2).all()
        assert (np.linalg.norm(np.diff(points[:, :2], axis=0), axis=1) < 3.0).all()
        assert terrain.origins[level, column, 0] < points[0, 0]
        assert ((points[:, 0] > near + 0.3) & (points[:, 0] < near + terrain.tile_length - 0.3)).all()
        assert (np.abs(points[:, 1] - middle) < terrain.tile_width / 2 - 0.5).all()
        np.testing.assert_allclose(points[:, 2], world.height(*points[:, :2].T), atol=1e-5)
        assert (points[:, 2] > -0.2).all()  # none in a pit
        np.testing.assert_allclose(points[-1, 1], points[-2, 1])  # straight on behind the last obstacle


@pytest.mark.parametrize("kind", KINDS)
def test_starts_are_free_and_level(kind):
    world = scene(kind)
    offset = np.linspace(-0.4, 0.4, 9)
    for x, y, z in world.terrain.origins.reshape(-1, 3).tolist():
        np.testing.assert_allclose(world.height(x + offset[:, None], y + offset), z, atol=1e-5)


# -------------------------------------------------------------------- the map


def test_flat_ground_costs_nothing():
    terrain = TerrainMap()
    before = flat_scene(PhysicsConfig()).compile()
    after = scene("flat").model
    assert after.ngeom == before.ngeom == 1
    assert after.geom("floor").pos.tolist() == [0, 0, 0]
    assert terrain.origins.tolist() == [[[0, 0, 0]]]
    assert terrain.waypoints.shape == (1, 1, 0, 3)


@pytest.mark.parametrize("kind", ["hills", "slope", "steps", "high_jump", "long_jump", "tilted_stones"])
def test_default_maps_stay_small(kind):
    terrain = TerrainMap(config(kind, levels=10, columns=None))
    assert terrain.obstacle.shape == (10, 2)
    assert len(terrain.boxes) <= 250


def test_kinds_share_a_map_by_columns():
    terrain = TerrainMap(TerrainConfig(kinds=("steps_down", "hills"), levels=2, columns=3))
    assert terrain.kinds == ("steps_down", "hills", "steps_down")
    assert terrain.obstacle[:, 0].tolist() == pytest.approx([0.05, 0.23])
    assert terrain.obstacle[:, 1].tolist() == pytest.approx([0.06, 0.28])
    world = Scene(terrain)
    for tile in tiles(terrain):
        x, y = world.tile_points(*tile, 100).T
        np.testing.assert_allclose(terrain.ground(x, y), world.height(x, y), atol=1e-6)


def test_tiles_without_pits_keep_their_floor_beside_pits():
    terrain = TerrainMap(TerrainConfig(kinds=("hurdles", "long_jump"), levels=2, tile=PARKOUR))
    world = Scene(terrain)
    assert world.height(*world.tile_points(1, 0, 200).T).min() == pytest.approx(0.0, abs=1e-9)
    assert world.height(*world.tile_points(1, 1, 200).T).min() == pytest.approx(-1.0)


def test_equal_seeds_give_equal_maps_and_more_columns_change_no_tile():
    one, two = TerrainMap(config("hurdles")), TerrainMap(config("hurdles"))
    assert one.boxes == two.boxes
    assert torch.equal(one.heights.heights, two.heights.heights)
    other, wider = TerrainMap(config("hurdles", seed=4)), TerrainMap(config("hurdles", columns=3))
    assert not torch.equal(one.waypoints, other.waypoints)
    assert torch.equal(one.obstacle, wider.obstacle[:, :2])


def test_difficulty_runs_from_the_first_to_the_last_level():
    terrain = TerrainMap(config("platforms", levels=3, difficulty=(0.2, 1.4)))
    assert terrain.obstacle[:, 0].tolist() == pytest.approx([0.1 + 0.35 * d for d in (0.2, 0.8, 1.4)])
    assert TerrainMap(config("platforms", levels=1)).obstacle[0, 0].item() == pytest.approx(0.45)


@pytest.mark.parametrize(
    ("kind", "obstacle"),
    [("steps_up", 0.0125), ("steps_down", 0.0125), ("hills", 0.015), ("slope_up", 0.0), ("slope_down", 0.0)]
    + [("platforms", 0.025), ("long_jump", 0.025), ("tilted_stones", 0.025)],
)
def test_below_difficulty_0_obstacles_shrink(kind, obstacle):
    """At -0.75 they are a quarter of the easiest ones of difficulty 0."""
    world = Scene(TerrainMap(config(kind, levels=1, difficulty=(-0.75, -0.75))))
    assert world.terrain.obstacle[0].tolist() == pytest.approx([obstacle] * 2)
    x, y = world.tile_points(0, 0, 200).T
    on_top = world.height(x, y)
    on_top = on_top[on_top > -0.5]
    steps = {"steps_up": 4, "steps_down": 7, "platforms": 3, "hills": 1, "long_jump": 0, "tilted_stones": 0}
    assert on_top.min() >= -obstacle - 1e-6
    assert on_top.max() == pytest.approx(steps.get(kind, 0) * obstacle, abs=0.015 if kind == "hills" else 1e-6)


def test_below_difficulty_0_hurdles_are_lower():
    world = Scene(TerrainMap(config("hurdles", levels=1, difficulty=(-0.5, -0.5))))
    tops = world.terrain.waypoints[0, :, 1:7, 2]
    assert tops.min() >= 0.05 - 1e-6
    assert tops.max() <= 0.075 + 1e-6
    assert world.height(*world.terrain.waypoints[0, 0, 1, :2].tolist()) == pytest.approx(tops[0, 0].item(), abs=1e-6)


def wall(difficulty, rng, size):
    x, half, height = size.length - 1.0, size.width / 2, 0.1 + difficulty
    return Tile((Box.between((x - 0.1, -half, 0.0), (x + 0.1, half, height)),), (1.0, 0.0), obstacle=height)


def test_other_packages_bring_terrains(monkeypatch):
    point = EntryPoint("wall", f"{__name__}:wall", "legged.terrains")
    monkeypatch.setattr(EntryPoint, "load", lambda self: wall)
    monkeypatch.setattr(kinds_module, "entry_points", lambda group: [point] if group == "legged.terrains" else [])
    terrain = TerrainMap(TerrainConfig(kinds=("wall",), levels=2))
    assert terrain.obstacle.tolist() == pytest.approx(np.array([[0.1, 0.1], [1.1, 1.1]]))
    with pytest.raises(ValueError, match=r"no terrain is called \['moat'\].*wall"):
        TerrainMap(TerrainConfig(kinds=("moat",)))


def test_a_new_terrain_is_one_function():
    terrain = TerrainMap(TerrainConfig(kinds=("wall", "flat"), levels=2), kinds={**KINDS, "wall": wall})
    world = Scene(terrain)
    x, y = terrain.tile_corner(1, 0)
    assert world.height(x + 7.0, y) == pytest.approx(1.1)
    assert terrain.heights.at(torch.tensor([x + 7.0, y])).item() == pytest.approx(1.1)
    assert terrain.obstacle.tolist() == pytest.approx(np.array([[0.1, 0, 0.1, 0], [1.1, 0, 1.1, 0]]))


def test_configuration_survives_json():
    original = config("hurdles", difficulty=(0.1, 0.7), columns=None)
    assert from_dict(TerrainConfig, to_dict(original)) == original


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: TerrainConfig(kinds=()), "need a kind"),
        (lambda: TerrainConfig(levels=0), "levels >= 1"),
        (lambda: TerrainConfig(kinds=("hills", "steps"), columns=1), "need as many columns"),
        (lambda: TerrainConfig(difficulty=(0.8, 0.2)), "-1 < easiest <= hardest"),
        (lambda: TerrainConfig(cell=0.0), "cell"),
        (lambda: TerrainMap(TerrainConfig(kinds=("lava",))), r"no terrain is called \['lava'\]; there are: flat"),
        (lambda: TerrainMap(TerrainConfig(kinds=("hurdles",))), "18 x 4 m"),
        (lambda: TerrainMap(TerrainConfig(kinds=("hills", "long_jump"), tile=PARKOUR)), "make two maps"),
        (lambda: TerrainMap(TerrainConfig(kinds=("flat", "hurdles"), tile=PARKOUR)), "waypoints"),
        (lambda: TerrainMap().add_to(mujoco.MjSpec()), "flat_scene"),
    ],
)
def test_what_cannot_be_built_says_why(make, message):
    with pytest.raises(ValueError, match=message):
        make()
