"""A picture of maps: heights, waypoints and starts from above, beside a view in three dimensions."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LightSource, LinearSegmentedColormap, TwoSlopeNorm
from matplotlib.figure import Figure, SubFigure

from locorl.play.renderer import Frame, gl_context, render_context
from locorl.simulation.scene import PhysicsConfig, flat_scene
from locorl.terrain.map import TerrainMap

INK, MUTED, ACCENT = "#1d2430", "#6b7480", "#0b7a75"
_COLOURS = LinearSegmentedColormap.from_list(
    "ground",
    [
        (0.0, "#1f3a52"),
        (0.3, "#4f7d94"),
        (0.47, "#b9cfd3"),
        (0.5, "#efe9dc"),
        (0.56, "#ecd3a4"),
        (0.75, "#d2844a"),
        (1.0, "#7a2e1d"),
    ],
)
_WIDTH, _LEFT = 14.0, 0.58
_PITCH = 0.025
"""Distance of the points that are drawn, m."""
_SUN = np.array((0.5, -0.45, -0.8))
"""Direction of the light."""
_WAYPOINT = (0.04, 0.48, 0.46, 1.0)
_ROBOT = (0.20, 0.25, 0.32, 1.0)


def save_picture(maps: Sequence[TerrainMap], path: Path) -> None:
    """Write a PNG with one row per map: its easiest, middle and hardest tile of the first column, and a view.

    Raises:
        ValueError: there is no map, or `path` does not end in .png.
        FileNotFoundError: the folder of `path` does not exist.
        PlayError: there is no OpenGL to draw the view with.
    """
    if not maps:
        raise ValueError("there is no terrain to draw: name at least one kind")
    if path.suffix.lower() != ".png":
        raise ValueError(f"{path}: a picture is a .png file")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path}: the folder {path.parent} does not exist")
    heights = [_row_height(terrain) for terrain in maps]
    figure = Figure((_WIDTH, sum(heights)), facecolor="white", dpi=110)
    rows = figure.subfigures(len(maps), 1, squeeze=False, height_ratios=heights)
    for row, terrain in zip(rows[:, 0], maps, strict=True):
        _draw_row(row, terrain)
    temporary = path.with_name(f".{path.name}.part")
    try:
        figure.savefig(temporary, format="png")
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def render(terrain: TerrainMap, level: int, column: int, width: int = 800, height: int = 500) -> Frame:
    """View of one tile and its neighbours, with waypoints and a figure of a robot's size, (height, width, 3).

    Raises:
        PlayError: there is no OpenGL.
    """
    spec = flat_scene(PhysicsConfig())
    terrain.add_to(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    middle = terrain.origins[level, column].double().numpy(force=True)
    course = terrain.waypoints[level, column].double().numpy(force=True)
    if len(course):
        middle += 0.33 * (course[-1] - middle)
    reach = 0.6 * terrain.tile_length if len(course) else max(terrain.tile_length, terrain.tile_width)
    _light(model, middle, reach)
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height

    option, camera = mujoco.MjvOption(), mujoco.MjvCamera()
    camera.lookat[:] = middle
    camera.azimuth, camera.elevation = (38.0, -24.0) if len(course) else (55.0, -32.0)
    camera.distance = (1.0 if len(course) else 1.3) * reach
    scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 100)
    everything = mujoco.mjtCatBit.mjCAT_ALL.value
    context = gl_context(width, height)
    try:
        mujoco.mj_forward(model, data)
        data.light_xpos[:] = middle - reach * data.light_xdir
        mujoco.mjv_updateScene(model, data, option, None, camera, everything, scene)
        for point in course:
            _add(scene, mujoco.mjtGeom.mjGEOM_SPHERE, point + np.array((0.0, 0.0, 0.1)), (0.1, 0.1, 0.1), _WAYPOINT)
        _add_figure(scene, terrain.origins[level, column].double().numpy(force=True))
        drawer = render_context(model)
        window = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(window, scene, drawer)
        pixels = np.empty((height, width, 3), np.uint8)
        mujoco.mjr_readPixels(pixels, None, window, drawer)
        drawer.free()
    finally:
        context.free()
    return pixels[::-1]


def _light(model: mujoco.MjModel, middle: np.ndarray, reach: float) -> None:
    settings = model.vis
    settings.global_.fovy = 40.0
    settings.quality.shadowsize, settings.quality.offsamples = 2048, 4
    settings.headlight.ambient[:], settings.headlight.diffuse[:], settings.headlight.specular[:] = 0.42, 0.18, 0.0
    model.light_ambient[:], model.light_diffuse[:], model.light_specular[:] = 0.0, 0.6, 0.0
    model.light_dir[:] = _SUN / np.linalg.norm(_SUN)
    model.stat.extent, model.stat.center[:] = 1.0, middle
    settings.map.znear, settings.map.zfar = 0.1, 400.0
    settings.map.shadowclip = 0.75 * reach


def _add(
    scene: mujoco.MjvScene,
    shape: mujoco.mjtGeom,
    position: np.ndarray,
    size: tuple[float, float, float],
    colour: tuple[float, float, float, float],
) -> None:
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(geom, shape, np.array(size), position, np.eye(3).ravel(), np.array(colour, np.float32))
    scene.ngeom += 1


def _add_figure(scene: mujoco.MjvScene, ground: np.ndarray) -> None:
    """A trunk with a head and four legs, hips 0.3 m high, for scale."""
    box, capsule = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CAPSULE
    parts = [(box, (0.0, 0.0, 0.33), (0.28, 0.1, 0.06)), (box, (0.33, 0.0, 0.37), (0.07, 0.06, 0.05))]
    parts += [(capsule, (x, y, 0.16), (0.04, 0.04, 0.12)) for x in (-0.2, 0.2) for y in (-0.13, 0.13)]
    for shape, offset, size in parts:
        _add(scene, shape, ground + np.array(offset), size, _ROBOT)


def _row_height(terrain: TerrainMap) -> float:
    """Height of a map's row in the figure, in."""
    return 6.2 if terrain.tile_length > 2 * terrain.tile_width else 3.7


def _draw_row(figure: SubFigure, terrain: TerrainMap) -> None:
    count = len(terrain.difficulty)
    levels = sorted({0, count // 2, count - 1})
    left, right = figure.subfigures(1, 2, squeeze=False, width_ratios=(_LEFT, 1 - _LEFT))[0]
    long = terrain.tile_length > 2 * terrain.tile_width
    axes = left.subplots(*((len(levels), 1) if long else (1, len(levels))), squeeze=False).ravel()
    left.subplots_adjust(left=0.07, right=0.98, top=0.84 if long else 0.86, bottom=0.08, hspace=0.42, wspace=0.2)
    name = terrain.kinds[0].replace("_", " ")
    left.text(0.07, 0.955, name, color=INK, fontsize=15, weight="bold", va="center")
    height = _row_height(terrain)
    low, high = min(float(terrain.heights.heights.min()), -0.02), max(terrain.heights.highest, 0.02)
    norm = TwoSlopeNorm(0.0, low, high)
    for ax, level in zip(axes, levels, strict=True):
        _draw_tile(ax, terrain, level, norm)
    scale = left.add_axes((0.66, 0.955 - 0.05 / height, 0.25, 0.1 / height))
    bar = left.colorbar(ScalarMappable(norm, _COLOURS), cax=scale, orientation="horizontal")
    ticks = [tick for tick in (low, 0.0, high) if abs(tick) > 0.021 or tick == 0.0]
    bar.set_ticks(ticks, labels=[f"{tick:.2g} m" for tick in ticks])
    bar.ax.set_xlim(low if low < -0.02 else 0.0, high if high > 0.02 else 0.0)
    bar.ax.tick_params(colors=MUTED, labelsize=8, length=2)
    bar.outline.set_visible(False)
    ax = right.add_axes((0.0, 0.04, 0.97, 0.86))
    pixels = int(_WIDTH * (1 - _LEFT) * 0.97 * 180), int(height * 0.86 * 180)
    ax.imshow(render(terrain, levels[-1], 0, *pixels))
    ax.set_title(f"level {levels[-1]}, with a figure of hip height 0.3 m", color=INK, fontsize=9.5, loc="left", pad=4)
    ax.set_axis_off()


def _shade(colours: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Darken and lighten `colours` (..., 3) about the `light` (..., 1) of level ground."""
    return np.clip(colours * (1.0 + 0.6 * (light - np.median(light))), 0.0, 1.0)


def _draw_tile(ax: Axes, terrain: TerrainMap, level: int, norm: TwoSlopeNorm) -> None:
    length, width = terrain.tile_length, terrain.tile_width
    corner = np.array(terrain.tile_corner(level, 0))
    x, y = np.arange(0, length, _PITCH), np.arange(-width / 2, width / 2, _PITCH)
    points = np.stack(np.meshgrid(x, y, indexing="xy"), axis=-1) + corner
    z = terrain.heights.at(torch.from_numpy(points).to(terrain.device)).numpy(force=True)
    colours = LightSource(azdeg=315, altdeg=50).shade(z, _COLOURS, norm=norm, blend_mode=_shade, dx=_PITCH, dy=_PITCH)
    ax.imshow(colours, origin="lower", extent=(0, length, -width / 2, width / 2), interpolation="antialiased")
    course = terrain.waypoints[level, 0, :, :2].numpy(force=True) - corner
    start = terrain.origins[level, 0, :2].numpy(force=True) - corner
    if len(course):
        ax.plot(*np.vstack((start, course)).T, color="white", lw=3.0)
        ax.plot(*np.vstack((start, course)).T, color=ACCENT, lw=1.2)
        ax.scatter(*course.T, s=90, color="white", edgecolor=ACCENT, lw=1.4, zorder=3)
        for number, point in enumerate(course, 1):
            ax.annotate(
                str(number), point, color=ACCENT, fontsize=7.5, weight="bold", ha="center", va="center_baseline"
            )
    ax.scatter(*start, s=70, marker=">", color=INK, edgecolor="white", lw=1.0, zorder=4)
    label = f"level {level}"
    if float(terrain.obstacle.max()) > 0.0:
        label += f"    {float(terrain.obstacle[level, 0]):.2f} m"
    ax.set_title(label, color=INK, fontsize=9.5, loc="left", pad=4)
    ax.tick_params(colors=MUTED, labelsize=8, length=2)
    for spine in ax.spines.values():
        spine.set_color("#c9ced6")
    ax.set_xticks(np.arange(0, length + 0.1, 2))
    ax.set_yticks((-width / 2, 0, width / 2))
