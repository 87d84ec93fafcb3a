"""`locorl terrain`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import rich
import tyro
from rich.table import Table

from locorl.terrain.kinds import COURSES, KINDS
from locorl.terrain.map import TerrainConfig, TerrainMap
from locorl.terrain.tile import LOCOMOTION, PARKOUR


@dataclass(frozen=True)
class Terrain:
    """List the kinds of terrain, or draw them: heights with waypoints and starts, and a 3-D view."""

    kinds: tuple[str, ...] = ("hills", "slope", "steps", "hurdles", "platforms", "long_jump", "tilted_stones")
    """Kinds to show; each has a map of its own."""
    show: bool = False
    """Draw a picture, which needs the extra `play`, instead of a table."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("terrain.png")
    """Where the picture goes."""
    levels: int = 10
    """Levels of difficulty; the picture has the first, the middle and the last."""
    difficulty: tuple[float, float] = (0.0, 1.0)
    """Difficulty of the first and of the last level."""
    seed: int = 0
    """Of everything random on the maps."""

    def run(self) -> None:
        """Print the table, or write the picture."""
        maps = [self._map(kind) for kind in self.kinds]
        if not self.show:
            rich.print(_table(maps))
            return
        try:
            from locorl.terrain.picture import save_picture
        except ModuleNotFoundError as error:
            from locorl.play.errors import missing_extra

            raise missing_extra(error) from error
        save_picture(maps, self.output)
        rich.print(f"{len(maps)} maps -> {self.output}")

    def _map(self, kind: str) -> TerrainMap:
        tile = PARKOUR if kind in COURSES else LOCOMOTION
        config = TerrainConfig(
            kinds=(kind,), levels=self.levels, tile=tile, difficulty=self.difficulty, cell=0.025, seed=self.seed
        )
        return TerrainMap(config)


def _table(maps: list[TerrainMap]) -> Table:
    table = Table(title=f"terrain, one map of each kind (of {', '.join(KINDS)})")
    for name in ("kind", "tile", "levels", "easiest", "hardest", "waypoints", "boxes"):
        table.add_column(name, justify="left" if name == "kind" else "right")
    for terrain in maps:
        table.add_row(
            terrain.kinds[0],
            f"{terrain.tile_length:g} x {terrain.tile_width:g} m",
            str(len(terrain.difficulty)),
            f"{float(terrain.obstacle[0].mean()):.2f} m",
            f"{float(terrain.obstacle[-1].mean()):.2f} m",
            str(terrain.waypoints.shape[2]),
            str(len(terrain.boxes)),
        )
    return table
