"""The map that all robots share: tiles of growing difficulty along x, kinds of terrain side by side along y."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import torch
from torch import Tensor

from locorl.interfaces import Array
from locorl.terrain.heights import HeightGrid, level_ground
from locorl.terrain.kinds import KINDS, installed_kinds
from locorl.terrain.surface import HeightField, box_top, raise_boxes
from locorl.terrain.tile import LOCOMOTION, PIT, Box, Kind, Tile, TileSize

_BASE = 0.2
"""How far the floor lies under the lowest point of a height field, m."""
_DEEP, _LEVEL, _LOW, _HIGH = (0.45, 0.55, 0.58), (0.84, 0.84, 0.83), (0.80, 0.72, 0.60), (0.70, 0.38, 0.25)
"""Colours of hollows, level ground, low and high obstacles."""
_PIT = (0.24, 0.31, 0.37, 1.0)
_VIEW = 8.0
"""Extent that MuJoCo's cameras scale their clipping planes by, m; the map's own would cut near robots off."""


@dataclass(frozen=True)
class TerrainConfig:
    """What the map is made of."""

    kinds: tuple[str, ...] = ("flat",)
    """Kinds of terrain; column j of the map is of kind j modulo their number."""
    levels: int = 10
    """Tiles along x, from the easiest to the hardest; one level alone is the hardest."""
    columns: int | None = None
    """Tiles along y; None makes two of each kind."""
    tile: TileSize = LOCOMOTION
    """Extent of a tile; parkour needs 18 x 4 m."""
    difficulty: tuple[float, float] = (0.0, 1.0)
    """Difficulty of the first and of the last level, see `Kind`; above 1 it goes on beyond the paper's range."""
    cell: float = 0.05
    """Spacing of the height grid that scans and cameras read, m."""
    relief_cell: float = 0.2
    """Spacing of the height field that the physics walks on, m; only maps with relief have one, and at half the
    spacing it costs half as much again."""
    border: float = 50.0
    """Level ground around the tiles, m."""
    seed: int = 0
    """Of everything random on the map."""

    def __post_init__(self) -> None:
        """Refuse maps without tiles, and difficulties that run backwards."""
        low, high = self.difficulty
        if not self.kinds or self.levels < 1 or self.seed < 0:
            raise ValueError(f"TerrainConfig: need a kind, levels >= 1 and seed >= 0, got {self}")
        if self.columns is not None and self.columns < len(self.kinds):
            raise ValueError(f"TerrainConfig: {len(self.kinds)} kinds need as many columns, got {self.columns}")
        if not -1.0 < low <= high:
            raise ValueError(f"TerrainConfig: need -1 < easiest <= hardest difficulty, got {self.difficulty}")
        if min(self.cell, self.relief_cell, self.border) <= 0.0:
            raise ValueError(f"TerrainConfig: need cell, relief_cell and border > 0, got {self}")


class TerrainMap:
    """Tiles side by side around the world's origin, one ground for all simulations.

    The ground is the plane z = 0; or slabs over a plane 1 m lower, where there are pits; or a height field,
    where there is relief. A map of flat ground alone is the plane of the scene, without a geom of its own.

    Args:
        config: kinds, levels, sizes.
        device: where the tensors live.
        kinds: the functions behind the names of `config.kinds`; other names are looked up among the installed ones.

    Attributes:
        origins: (levels, columns, 3), world position of each tile's start on the ground, m.
        waypoints: (levels, columns, k, 3), world positions on the ground, m; k may be 0.
        obstacle: (levels, columns), size of the obstacles, m (see `Tile`).
        kinds: the kind of each column.
        difficulty: of each level.
        heights: the ground as a grid.
        boxes: all boxes, in the world's frame.
        tile_length: extent of a tile along x, m.
        tile_width: extent of a tile along y, m.

    Raises:
        ValueError: a kind is unknown, does not fit its tile, or cannot share a map with the others.
    """

    def __init__(
        self,
        config: TerrainConfig | None = None,
        device: torch.device | str = "cpu",
        kinds: Mapping[str, Kind] = KINDS,
    ) -> None:
        self.config = config = config or TerrainConfig()
        self.device = torch.device(device)
        if not set(config.kinds) <= set(kinds):
            kinds = {**installed_kinds(), **kinds}
        unknown = sorted(set(config.kinds) - set(kinds))
        if unknown:
            raise ValueError(f"no terrain is called {unknown}; there are: {', '.join(kinds)}")
        columns = 2 * len(config.kinds) if config.columns is None else config.columns
        levels = config.levels
        if set(config.kinds) == {"flat"}:
            levels = columns = 1
        self.kinds = tuple(config.kinds[column % len(config.kinds)] for column in range(columns))
        self.tile_length, self.tile_width = config.tile.length, config.tile.width
        low, high = config.difficulty
        self.difficulty = (high,) if levels == 1 else tuple(np.linspace(low, high, levels).tolist())
        tiles = [
            [
                kinds[name](difficulty, np.random.default_rng((config.seed, level, column)), config.tile)
                for column, name in enumerate(self.kinds)
            ]
            for level, difficulty in enumerate(self.difficulty)
        ]
        self._corner = (-levels * self.tile_length / 2, -columns * self.tile_width / 2)
        self._build_ground(tiles)
        self._place_tensors(tiles)

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Put the ground into a scene that has a plane called "floor" at z = 0; robots collide with it.

        Raises:
            ValueError: the scene has no such plane.
        """
        floor = spec.geom("floor")
        if floor is None:
            raise ValueError("the scene has no plane called 'floor'; make it with flat_scene")
        if self.floor < 0.0:
            floor.pos, floor.material, floor.rgba = [0.0, 0.0, self.floor], "", _PIT
        if self.boxes or self.field is not None:
            spec.stat.extent = _VIEW
        if self.field is not None:
            self._add_field(spec)
        tallest = max((box.centre[2] + box.half_size[2] for box in self.boxes), default=0.0)
        for number, box in enumerate(self.boxes):
            geom = spec.worldbody.add_geom(
                name=f"terrain_{number}",
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=box.centre,
                size=box.half_size,
                quat=box.quat,
                contype=0,
                conaffinity=1,
            )
            top = box.centre[2] + box.half_size[2]
            if top > 1e-6 or box.quat[0] < 1.0:
                shade = max(top, 0.0) / max(tallest, 1e-6)
                geom.rgba = [*_blend(shade, (0.0, 1.0), (_LOW, _HIGH)), 1.0]
            elif spec.material("grid") is not None:
                geom.material = "grid"

    def ground(self, x: Array, y: Array) -> Array:
        """Exact height of the ground at points (x, y), world, m; for building and checking, not for scans."""
        height = np.full(x.shape, self.floor) if self.field is None else self.field.at(x, y)
        for box in self.boxes:
            np.maximum(height, box_top(box, x, y), out=height)
        return height

    def _add_field(self, spec: mujoco.MjSpec) -> None:
        field = self.field
        assert field is not None
        low, high = float(field.nodes.min()), float(field.nodes.max())
        # MuJoCo stretches the data to [0, 1], so the height of the field is their range
        spec.add_hfield(
            name="terrain",
            nrow=field.nodes.shape[1],
            ncol=field.nodes.shape[0],
            size=[-field.low[0], -field.low[1], max(high - low, 1e-3), _BASE],
            userdata=field.nodes.T.ravel(),
        )
        spec.worldbody.add_geom(
            name="terrain",
            type=mujoco.mjtGeom.mjGEOM_HFIELD,
            hfieldname="terrain",
            pos=[0.0, 0.0, low],
            material="terrain",
            contype=0,
            conaffinity=1,
        )
        colours = _blend(field.nodes.T, (min(low, -1e-3), 0.0, max(high, 1e-3)), (_DEEP, _LEVEL, _HIGH))
        colours[np.add.outer(*(np.arange(count) // 5 for count in field.nodes.T.shape)) % 2 == 0] *= 0.93
        spec.add_texture(
            name="terrain",
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            width=field.nodes.shape[0],
            height=field.nodes.shape[1],
            nchannel=3,
            data=(255 * colours).astype(np.uint8).ravel().tolist(),
        )
        material = spec.add_material(name="terrain", specular=0.0)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "terrain"

    def tile_corner(self, level: int, column: int) -> tuple[float, float]:
        """World position of a tile's frame: the middle of its near edge."""
        x, y = self._corner
        return x + level * self.tile_length, y + (column + 0.5) * self.tile_width

    def _build_ground(self, tiles: Sequence[Sequence[Tile]]) -> None:
        every = [tile for row in tiles for tile in row]
        pits = any(not tile.floor for tile in every)
        relief = any(tile.relief is not None for tile in every)
        if pits and relief:
            raise ValueError(
                f"{sorted(set(self.kinds))} cannot share a map: some have pits, some have relief; make two maps"
            )
        self.field = self._build_field(tiles) if relief else None
        self.floor = -PIT if pits else 0.0
        if self.field is not None:
            self.floor = float(self.field.nodes.min()) - _BASE
        boxes = []
        for level, row in enumerate(tiles):
            for column, tile in enumerate(row):
                x, y = self.tile_corner(level, column)
                own = tile.boxes
                if pits and tile.floor:
                    half = self.tile_width / 2
                    own = (Box.between((0.0, -half, -PIT), (self.tile_length, half, 0.0)), *own)
                boxes += [replace(b, centre=(b.centre[0] + x, b.centre[1] + y, b.centre[2])) for b in own]
        if self.floor < 0.0:
            boxes += self._apron()
        self.boxes: tuple[Box, ...] = tuple(boxes)
        self.heights = self._sample()

    def _build_field(self, tiles: Sequence[Sequence[Tile]]) -> HeightField:
        shape = np.array((len(tiles) * self.tile_length, len(tiles[0]) * self.tile_width))
        count = np.rint(shape / self.config.relief_cell).astype(int) + 1
        low, high = self._corner, (-self._corner[0], -self._corner[1])
        x, y = (np.linspace(low[axis], high[axis], count[axis]) for axis in (0, 1))
        nodes = np.zeros((len(x), len(y)))
        for level, row in enumerate(tiles):
            for column, tile in enumerate(row):
                if tile.relief is None:
                    continue
                near, middle = self.tile_corner(level, column)
                rows = np.flatnonzero((x >= near - 1e-9) & (x <= near + self.tile_length + 1e-9))
                columns = np.flatnonzero(np.abs(y - middle) <= self.tile_width / 2 + 1e-9)
                nodes[np.ix_(rows, columns)] = tile.relief(
                    *np.meshgrid(x[rows] - near, y[columns] - middle, indexing="ij")
                )
        return HeightField(nodes, low, high)

    def _apron(self) -> list[Box]:
        """Level ground around the tiles, for maps whose floor is lower."""
        x, y, border = -self._corner[0], -self._corner[1], self.config.border
        return [
            Box.between((-x - border, -y - border, self.floor), (-x, y + border, 0.0)),
            Box.between((x, -y - border, self.floor), (x + border, y + border, 0.0)),
            Box.between((-x, -y - border, self.floor), (x, -y, 0.0)),
            Box.between((-x, y, self.floor), (x, y + border, 0.0)),
        ]

    def _sample(self) -> HeightGrid:
        if not self.boxes and self.field is None:
            return level_ground(self.device)
        cell = self.config.cell
        # one node more on each side, so that the level ground around goes on for ever
        origin = (self._corner[0] - cell, self._corner[1] - cell)
        x, y = (
            np.arange(int(np.ceil(-2 * start / cell - 1e-9)) + 1, dtype=np.float64) * cell + start for start in origin
        )
        if self.field is None:
            heights = np.full((len(x), len(y)), self.floor)
        else:
            heights = self.field.at(*np.meshgrid(x, y, indexing="ij"))
        raise_boxes(heights, self.boxes, x, y)
        return HeightGrid(heights, origin, cell, self.device)

    def _place_tensors(self, tiles: Sequence[Sequence[Tile]]) -> None:
        lengths = {len(tile.waypoints) for row in tiles for tile in row}
        if len(lengths) > 1:
            raise ValueError(f"{sorted(set(self.kinds))} cannot share a map: they have {sorted(lengths)} waypoints")
        corners = np.array(
            [[self.tile_corner(level, column) for column in range(len(self.kinds))] for level in range(len(tiles))]
        )
        starts = corners + np.array([[tile.start for tile in row] for row in tiles])
        points = np.array([[tile.waypoints for tile in row] for row in tiles]) + corners[:, :, None]
        self.origins = self._on_ground(starts)
        self.waypoints = self._on_ground(points)
        obstacle = [[tile.obstacle for tile in row] for row in tiles]
        self.obstacle = torch.tensor(obstacle, dtype=torch.float32, device=self.device)

    def _on_ground(self, xy: Array) -> Tensor:
        """Points (..., 2) with the height of the ground there, (..., 3)."""
        points = np.concatenate((xy, self.ground(xy[..., 0], xy[..., 1])[..., None]), axis=-1)
        return torch.from_numpy(points).to(self.device, torch.float32)


def _blend(value: Array | float, at: Sequence[float], colours: Sequence[tuple[float, float, float]]) -> Array:
    """Colour (..., 3) of each value, between the `colours` that belong `at` certain values."""
    return np.stack([np.interp(value, at, channel) for channel in zip(*colours, strict=True)], axis=-1)
