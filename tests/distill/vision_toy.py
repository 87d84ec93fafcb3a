"""A toy world with a camera: what has to be done depends on a load, on terrain and on headings that are never told."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

WIDTH, TERRAIN, HEADINGS, ROWS, COLUMNS, PERIOD = 12, 4, 2, 8, 12, 5
PROPRIO = 3 * WIDTH + HEADINGS
HEADING = slice(3 * WIDTH, PROPRIO)
BODY = {"load": slice(0, WIDTH), "colour": slice(WIDTH, WIDTH + 1), "gravity": slice(WIDTH + 1, WIDTH + 2)}


class VisionToy:
    """x' = 0.8 x + action + load + [terrain, 0...] + heading on joint 11.

    A reference r has to be reached in one step. proprio = [x, r, last action, 2 headings], explicit = x[:3] - last[:3],
    implicit = [load, colour that does nothing, constant gravity], scan = terrain in +-1. Load, terrain and headings
    are drawn for each episode; headings are refreshed with the camera. An image shows terrain as the brightness of
    its four bands of rows, and the headings as slopes from left to right of its upper and lower half.

    Args:
        num_envs: N.
        episode: longest episode, steps; the k-th robot's first one is shorter.
        bodies: whether the load belongs to the robot instead of the episode.
        history: past frames in the group "history".
    """

    heading, depth_shape, depth_period = HEADING, (ROWS, COLUMNS), PERIOD
    load: Tensor
    terrain: Tensor
    course: Tensor
    colour: Tensor
    x: Tensor
    last: Tensor

    def __init__(self, num_envs: int = 32, episode: int = 40, bodies: bool = False, history: int = 0) -> None:
        self.num_envs, self.episode, self.bodies, self.past = num_envs, episode, bodies, history
        self.device = torch.device("cpu")
        self.group_dims = {"proprio": PROPRIO, "explicit": 3, "implicit": WIDTH + 2, "scan": TERRAIN}
        if history:
            self.group_dims["history"] = history * PROPRIO
        self.generator = torch.Generator()
        self.body = 0.5 * torch.randn(num_envs, WIDTH, generator=torch.Generator().manual_seed(17))
        self.steps = 0

    def randn(self, *shape: int) -> Tensor:
        return torch.randn(self.num_envs, *shape, generator=self.generator)

    def draw(self, rows: Tensor) -> None:
        load = self.body if self.bodies else 0.5 * self.randn(WIDTH)
        world = torch.tanh(self.randn(TERRAIN)), 0.7 * torch.tanh(self.randn(HEADINGS)), self.randn(1)
        for name, fresh in zip(("load", "terrain", "course", "colour"), (load, *world), strict=True):
            setattr(self, name, torch.where(rows[:, None], fresh, getattr(self, name, fresh)))
        for name in ("x", "last"):
            old = getattr(self, name, None)
            setattr(self, name, torch.zeros(self.num_envs, WIDTH) if old is None else old.masked_fill(rows[:, None], 0))
        self.shown_heading = torch.where(rows[:, None], self.course, getattr(self, "shown_heading", self.course))
        self.depth = torch.where(rows[:, None, None], self.look(), getattr(self, "depth", self.look()))

    def look(self) -> Tensor:
        bands = self.terrain.repeat_interleave(ROWS // TERRAIN, dim=1)[:, :, None]
        slopes = self.course.repeat_interleave(ROWS // HEADINGS, dim=1)[:, :, None] * torch.linspace(-1, 1, COLUMNS)
        return 0.25 * bands + 0.25 * slopes

    def reset(self, seed: int | None = None) -> dict[str, Tensor]:
        if seed is not None:
            self.generator.manual_seed(seed)
        everyone = torch.ones(self.num_envs, dtype=torch.bool)
        self.draw(everyone)
        self.reference = self.randn(WIDTH)
        self.age = torch.arange(self.num_envs) % self.episode
        self.tick = 0
        self.frames = [self.onboard()] * self.past
        return self.observe()

    def onboard(self) -> Tensor:
        frame = torch.cat((self.x, self.reference, self.last, self.shown_heading), dim=1)
        frame[:, HEADING] = 0.0
        return frame

    def observe(self) -> dict[str, Tensor]:
        n = self.num_envs
        obs = {
            "proprio": torch.cat((self.x, self.reference, self.last, self.shown_heading), dim=1),
            "explicit": self.x[:, :3] - self.last[:, :3],
            "implicit": torch.cat((self.load, self.colour, torch.full((n, 1), 9.81)), dim=1),
            "scan": self.terrain.clone(),
        }
        if self.past:
            obs["history"] = torch.cat(self.frames, dim=1)
        return obs

    def push(self) -> Tensor:
        """What load, terrain and heading do to x in a step, (N, 12)."""
        force = self.load.clone()
        force[:, :TERRAIN] += self.terrain
        force[:, -1] += self.course[:, 0]
        return force

    def step(self, action: Tensor) -> tuple[dict[str, Tensor], Tensor, Tensor, Tensor, object]:
        self.steps += 1
        self.tick += 1
        before = self.onboard()
        self.x = 0.8 * self.x + action + self.push()
        reward = -(self.x - self.reference).square().mean(dim=1)
        self.last, self.reference = action.clone(), self.randn(WIDTH)
        self.age += 1
        terminated = self.x.abs().amax(dim=1) > 50.0
        truncated = (self.age >= self.episode) & ~terminated
        done = terminated | truncated
        self.draw(done)
        self.age = torch.where(done, 0, self.age)
        if self.past:
            self.frames = [*self.frames[1:], before]
            self.frames = [torch.where(done[:, None], self.onboard(), frame) for frame in self.frames]
        if self.tick % PERIOD == 0:
            self.depth, self.shown_heading = self.look(), self.course.clone()
        return self.observe(), reward, terminated, truncated, None


class BlindToyTeacher:
    """Knows everything and opens nothing: r - 0.8 x - push reaches the reference exactly."""

    def act(self, obs: Mapping[str, Tensor]) -> Tensor:
        proprio = obs["proprio"]
        action = proprio[:, WIDTH : 2 * WIDTH] - 0.8 * proprio[:, :WIDTH] - obs["implicit"][:, :WIDTH]
        action[:, :TERRAIN] -= obs["scan"]
        action[:, -1] -= proprio[:, HEADING.start]
        return action


class VisionToyTeacher(BlindToyTeacher):
    """The same policy as a linear actor on [proprio, scan latent = terrain, explicit, latent = load]."""

    latent_dim, scan_latent_dim = WIDTH, TERRAIN

    def __init__(self) -> None:
        self.actor = nn.Linear(PROPRIO + TERRAIN + 3 + WIDTH, WIDTH)
        eye = torch.eye(WIDTH)
        with torch.no_grad():
            self.actor.weight.zero_()
            self.actor.bias.zero_()
            self.actor.weight[:, :WIDTH] = -0.8 * eye
            self.actor.weight[:, WIDTH : 2 * WIDTH] = eye
            self.actor.weight[-1, HEADING.start] = -1.0
            self.actor.weight[:TERRAIN, PROPRIO : PROPRIO + TERRAIN] = -torch.eye(TERRAIN)
            self.actor.weight[:, -WIDTH:] = -eye

    def latent(self, obs: Mapping[str, Tensor]) -> Tensor:
        return obs["implicit"][:, :WIDTH]

    def scan_latent(self, obs: Mapping[str, Tensor]) -> Tensor:
        return obs["scan"]
