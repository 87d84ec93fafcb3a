"""Which tile each robot stands on: up a level when it gets far, down when it does not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from locorl.terrain.map import TerrainMap


@dataclass(frozen=True)
class CurriculumConfig:
    """When robots change level, at the end of an episode."""

    promote: float = 0.8
    """Share of the commanded distance above which a robot goes up a level."""
    demote: float = 0.4
    """Share of the commanded distance below which it goes down a level."""
    least: float = 1.0
    """Robots that were to go less than this far stay where they are, m: standing still proves nothing."""
    start_level: int = 5
    """Robots start on levels 0 to this one."""
    hip_limit: float | None = None
    """Largest obstacle, in hip heights of the body that meets it; None lets every body onto every level."""

    def __post_init__(self) -> None:
        """Refuse thresholds that contradict each other."""
        if not 0.0 <= self.demote < self.promote:
            raise ValueError(f"CurriculumConfig: need 0 <= demote < promote, got {self.demote}, {self.promote}")
        if self.start_level < 0 or (self.hip_limit is not None and self.hip_limit <= 0.0):
            raise ValueError(f"CurriculumConfig: need start_level >= 0 and hip_limit > 0, got {self}")


class Curriculum:
    """Level and column of each of N robots on a `TerrainMap`.

    A robot keeps its column for life; columns are dealt out evenly, at random. A robot that passes its last
    level goes to a random one, so that the easy levels are not forgotten.

    Args:
        config: thresholds.
        terrain: the map.
        num_envs: N.
        generator: of everything random here, on the map's device; its state is the owner's to save.
        hip_height: hip height of each body, (N,), m; needed for `config.hip_limit`.

    Attributes:
        level: (N,) long, row of the map.
        column: (N,) long, column of the map.

    Raises:
        ValueError: there is a `hip_limit`, but no hip heights.
    """

    def __init__(
        self,
        config: CurriculumConfig,
        terrain: TerrainMap,
        num_envs: int,
        generator: torch.Generator,
        hip_height: Tensor | None = None,
    ) -> None:
        self.config = config
        self.terrain = terrain
        self._generator = generator
        device = terrain.device
        self._levels, columns = terrain.obstacle.shape
        order = torch.randperm(num_envs, generator=generator, device=device)
        self.column = order % columns
        self._placed = torch.zeros(num_envs, dtype=torch.bool, device=device)
        self.level = torch.zeros(num_envs, dtype=torch.long, device=device)
        self.ceiling = torch.full((num_envs,), self._levels, dtype=torch.long, device=device)
        """Number of levels open to each robot, (N,) long."""
        if config.hip_limit is not None:
            if hip_height is None:
                raise ValueError("CurriculumConfig.hip_limit needs the hip height of each body")
            self.set_hip_heights(hip_height)
        self.level = self._draw(self.ceiling.clamp(max=config.start_level + 1))

    def place(self, ids: Tensor) -> Tensor:
        """World positions, (m, 3), m, of the ground where robots `ids` (m,) start their next episode."""
        self._placed[ids] = True
        return self.terrain.origins[self.level[ids], self.column[ids]]

    def update(self, ids: Tensor, distance: Tensor, commanded: Tensor, success: Tensor | None = None) -> None:
        """Promote or demote robots `ids` (m,) whose episode has ended; the never placed ones stay untouched.

        Args:
            ids: robots, (m,).
            distance: how far each has come, (m,), m.
            commanded: how far it should have come in a whole episode, (m,), m.
            success: robots that reached their last waypoint, (m,) bool; they go up whatever the distance.
        """
        if self._levels == 1:
            return
        asked = commanded >= self.config.least
        up = asked & (distance > self.config.promote * commanded)
        if success is not None:
            up |= success
        down = asked & ~up & (distance < self.config.demote * commanded)
        level = (self.level[ids] + up.long() - down.long()).clamp(min=0)
        ceiling = self.ceiling[ids]
        level = torch.where(level < ceiling, level, self._draw(ceiling))
        self.level[ids] = torch.where(self._placed[ids], level, self.level[ids])

    def set_hip_heights(self, hip_height: Tensor) -> None:
        """Close the levels whose obstacles are too large for bodies with hips at `hip_height` (N,), m.

        The first level stays open to every body. Without a `hip_limit` this changes nothing.
        """
        if self.config.hip_limit is None:
            return
        size = self.terrain.obstacle[:, self.column].T
        fits = size <= self.config.hip_limit * hip_height.to(size)[:, None]
        self.ceiling = fits.long().cumprod(dim=1).sum(dim=1).clamp(min=1)
        self.level = torch.minimum(self.level, self.ceiling - 1)

    def state_dict(self) -> dict[str, Tensor]:
        """Levels, columns and who has been placed, as copies."""
        return {name: getattr(self, name).clone() for name in _STATE}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Go back to a saved state.

        Raises:
            ValueError: it belongs to another number of robots, or to a larger map.
        """
        levels, columns = self.terrain.obstacle.shape
        if state["level"].shape != self.level.shape:
            raise ValueError(f"curriculum of {len(state['level'])} robots loaded into one of {len(self.level)}")
        if int(state["level"].max()) >= levels or int(state["column"].max()) >= columns:
            raise ValueError(f"the curriculum was saved on a map larger than {levels} x {columns} tiles")
        for name in _STATE:
            setattr(self, name, state[name].clone().to(self.terrain.device))

    def _draw(self, ceiling: Tensor) -> Tensor:
        """A random level below each `ceiling` (m,)."""
        share = torch.rand(ceiling.shape, generator=self._generator, device=ceiling.device)
        return (share * ceiling).long()


_STATE = ("level", "column", "ceiling", "_placed")
