"""Shaded pictures of triangles with a depth buffer in numpy: headless, and as fast for a CAD mesh as for a box."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, minimum_filter

Array = NDArray[np.float64]

SUPERSAMPLING = 2
_LIGHT = np.array([0.35, 0.6, 0.72])  # to the right, up and towards the viewer
_AMBIENT, _DIFFUSE, _GLOSS = 0.58, 0.5, 0.05
_EDGE, _EDGE_STEP = 0.55, 0.012  # how much an edge darkens, and the step in depth that makes one [m]
_SHADOW, _BLUR = 0.28, 0.012  # opacity, and softness [m]
_COARSE = 4  # pixels of the picture in one of the shadow


@dataclass(frozen=True)
class Camera:
    """An orthographic camera.

    Attributes:
        axes: (3, 3) rows right, up and towards the viewer, in world axes.
    """

    axes: Array

    @classmethod
    def looking_from(cls, azimuth: float, elevation: float) -> Camera:
        """Seen from a direction: azimuth from +x to +y and elevation [deg]."""
        a, e = np.radians([azimuth, elevation])
        towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        right = np.array([-np.sin(a), np.cos(a), 0.0])
        return cls(np.array([right, np.cross(towards, right), towards]))


RIGHT_SIDE = Camera.looking_from(-90, 0)
"""From the right of the robot: forward is right."""
THREE_QUARTER = Camera.looking_from(-52, 22)
"""From the front right and above."""


@dataclass(frozen=True)
class Surface:
    """Triangles (m, 3, 3) in world axes [m] and their colours (m, 3) in 0..1."""

    triangles: Array
    colors: Array


def surface_of(scene: trimesh.Scene) -> Surface:
    """All meshes of a scene in world axes."""
    triangles, colors = [np.zeros((0, 3, 3))], [np.zeros((0, 3))]
    for node in scene.graph.nodes_geometry:
        pose, name = scene.graph[node]
        mesh = scene.geometry[name]
        if isinstance(mesh, trimesh.Trimesh):
            triangles.append(trimesh.transform_points(mesh.vertices, pose)[mesh.faces])
            colors.append(mesh.visual.face_colors[:, :3] / 255)  # pyright: ignore[reportOptionalMemberAccess, reportAttributeAccessIssue]
    return Surface(np.concatenate(triangles), np.concatenate(colors))


def bounds_of(surface: Surface, camera: Camera, *, shadow: bool = False) -> tuple[Array, Array]:
    """Lower and upper corner (2,) of the picture that just holds the surface, and its shadow on request [m]."""
    points = surface.triangles.reshape(-1, 3)
    views = [points @ camera.axes[:2].T]
    if shadow:
        views.append((points * (1, 1, 0)) @ camera.axes[:2].T)
    return np.min([view.min(axis=0) for view in views], axis=0), np.max([view.max(axis=0) for view in views], axis=0)


def shade(surface: Surface, camera: Camera, low: Array, high: Array, width: int, *, shadow: bool = False) -> Array:
    """A picture of a part of the camera's plane.

    Args:
        surface: what to show.
        camera: from where.
        low: (2,) lower left corner, along the camera's right and up [m].
        high: (2,) upper right corner.
        width: of the picture in pixels; the height follows.
        shadow: whether the surface throws a soft shadow straight down on the floor z = 0.

    Returns:
        (h, w, 4) RGBA in 0..1, row 0 on top, transparent where there is nothing.
    """
    columns = width * SUPERSAMPLING
    pixel = (high[0] - low[0]) / columns
    rows = round(float(high[1] - low[1]) / pixel / SUPERSAMPLING) * SUPERSAMPLING
    seen = surface.triangles @ camera.axes.T
    hit, depth = _rasterise(_to_pixels(seen, low, pixel), rows, columns)
    image = np.zeros((rows, columns, 4))
    if shadow:
        image[..., 3] = _SHADOW * _shadow(surface, camera, low, pixel, rows, columns)
    solid = hit >= 0
    image[solid, :3] = (_GLOSS + surface.colors * _brightness(seen)[:, None])[hit[solid]]
    image[solid, 3] = 1
    image[..., :3] *= 1 - _EDGE * _edges(hit, depth)[..., None]
    small = _shrink(image)
    return np.clip(small[::-1], 0, 1)


def _to_pixels(seen: Array, low: Array, pixel: float) -> Array:
    placed = seen.copy()
    placed[..., :2] = (seen[..., :2] - low) / pixel - 0.5  # centres of pixels are whole numbers
    return placed


def _brightness(seen: Array) -> Array:
    """Lambert's law, for both sides of a triangle."""
    normal = np.cross(seen[:, 1] - seen[:, 0], seen[:, 2] - seen[:, 0])
    length = np.linalg.norm(normal, axis=1)
    facing = np.where(normal[:, 2] < 0, -1.0, 1.0) / np.where(length > 0, length, 1.0)
    return _AMBIENT + _DIFFUSE * np.clip(normal @ (_LIGHT / np.linalg.norm(_LIGHT)) * facing, 0, 1)


def _rasterise(placed: Array, rows: int, columns: int) -> tuple[NDArray[np.int64], Array]:
    """Nearest triangle (-1 for none) and its depth (-inf for none) at each pixel, bottom row first."""
    owner, x, y = _covered(placed, rows, columns)
    depth = _depth(placed, owner, x, y)
    order = np.argsort(depth, kind="stable")  # the nearest is written last
    pixel = (y * columns + x)[order]
    hit, nearest = np.full(rows * columns, -1), np.full(rows * columns, -np.inf)
    hit[pixel], nearest[pixel] = owner[order], depth[order]
    return hit.reshape(rows, columns), nearest.reshape(rows, columns)


def _covered(placed: Array, rows: int, columns: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Every pixel that every triangle covers: the triangle's index, column and row."""
    low, high = placed[..., 1].min(axis=1), placed[..., 1].max(axis=1)
    owner, y = _expand(np.clip(np.ceil(low), 0, rows), np.clip(np.floor(high), -1, rows - 1))
    left, right = _span(placed[owner], y)
    span, x = _expand(np.clip(np.ceil(left), 0, columns), np.clip(np.floor(right), -1, columns - 1))
    return owner[span], x, y[span]


def _expand(first: Array, last: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """All whole numbers of the ranges first..last, and the index of the range of each."""
    count = np.maximum(last - first + 1, 0).astype(np.int64)
    index = np.repeat(np.arange(len(count)), count)
    offset = np.arange(len(index)) - np.repeat(np.cumsum(count) - count, count)
    return index, first.astype(np.int64)[index] + offset


def _span(triangles: Array, y: NDArray[np.int64]) -> tuple[Array, Array]:
    """Where lines of constant y enter and leave triangles (k, 3, 3)."""
    left, right = np.full(len(y), np.inf), np.full(len(y), -np.inf)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        (x0, y0), (x1, y1) = triangles[:, i, :2].T, triangles[:, j, :2].T
        rise = np.where(y1 == y0, np.nan, y1 - y0)
        along = (y - y0) / rise
        x = np.where((along >= 0) & (along <= 1), x0 + along * (x1 - x0), np.nan)
        left, right = np.fmin(left, x), np.fmax(right, x)
    # a triangle that the line only touches has no span
    return np.where(np.isfinite(left), left, 0), np.where(np.isfinite(right), right, -1)


def _depth(placed: Array, owner: NDArray[np.int64], x: NDArray[np.int64], y: NDArray[np.int64]) -> Array:
    """Depth of the planes of triangles at pixels, kept within their corners' where they are seen edge on."""
    (ux, uy, uz), (vx, vy, vz) = (placed[:, 1] - placed[:, 0]).T, (placed[:, 2] - placed[:, 0]).T
    area = ux * vy - uy * vx
    area = np.where(np.abs(area) < 1e-9, np.inf, area)
    slope_x, slope_y = (uz * vy - uy * vz) / area, (ux * vz - uz * vx) / area
    plane = placed[:, 0, 2] - slope_x * placed[:, 0, 0] - slope_y * placed[:, 0, 1]
    depth = plane[owner] + slope_x[owner] * x + slope_y[owner] * y
    return np.clip(depth, placed[..., 2].min(axis=1)[owner], placed[..., 2].max(axis=1)[owner])


def _edges(hit: NDArray[np.int64], depth: Array) -> Array:
    """1 on the inside of outlines and of steps in depth, else 0."""
    far = np.where(hit >= 0, depth, -1e3)
    return ((hit >= 0) & (far - minimum_filter(far, size=3) > _EDGE_STEP)).astype(np.float64)


def _shadow(surface: Surface, camera: Camera, low: Array, pixel: float, rows: int, columns: int) -> Array:
    flat = (surface.triangles * (1, 1, 0)) @ camera.axes.T
    coarse = (rows // _COARSE + 1, columns // _COARSE + 1)
    _, x, y = _covered(_to_pixels(flat, low, pixel * _COARSE), *coarse)
    dark = np.zeros(coarse)
    dark[y, x] = 1
    blurred = gaussian_filter(dark, _BLUR / (pixel * _COARSE))
    return blurred.repeat(_COARSE, axis=0).repeat(_COARSE, axis=1)[:rows, :columns]


def _shrink(image: Array) -> Array:
    """Mean over squares of pixels, colours weighted by their opacity."""
    rows, columns, _ = image.shape
    n = SUPERSAMPLING
    weighted = np.concatenate([image[..., :3] * image[..., 3:], image[..., 3:]], axis=-1)
    mean = weighted.reshape(rows // n, n, columns // n, n, 4).mean(axis=(1, 3))
    mean[..., :3] /= np.where(mean[..., 3:] > 0, mean[..., 3:], 1)
    return mean
