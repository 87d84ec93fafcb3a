"""A problem whose solution is known, for tests of PPO: the action is to be a function of the observation."""

from __future__ import annotations

import torch
from locorl import PPO, ActorCritic, NetworkConfig, PPOConfig, StepInfo

DIMS = {"proprio": 3, "explicit": 1, "implicit": 2}
NETWORK = NetworkConfig(actor=(16,), critic=(16,), encoder=(8,), latent=3)


class TargetEnv:
    """Reward -|action - f(obs)|^2; episodes end by time or by a fall at fixed steps."""

    dt = 0.02

    def __init__(self, num_envs: int = 32, poison: str = "") -> None:
        self.num_envs, self.poison, self.t = num_envs, poison, 0
        self.generator = torch.Generator().manual_seed(0)
        self.matrix = torch.tensor([[0.8, -0.5], [0.0, 0.6], [-0.4, 0.0]])

    def observe(self) -> dict[str, torch.Tensor]:
        def draw(size: int) -> torch.Tensor:
            return torch.randn(self.num_envs, size, generator=self.generator)

        self.obs = {group: draw(size) for group, size in DIMS.items()}
        return self.obs

    def target(self, obs: dict[str, torch.Tensor]) -> torch.Tensor:
        return obs["proprio"] @ self.matrix + 0.5 * obs["implicit"]

    def step(self, action: torch.Tensor):
        assert action.isfinite().all()  # as LeggedEnv, which refuses NaN
        self.t += 1
        reward = -(action - self.target(self.obs)).square().sum(dim=1)
        if self.poison == "reward" and self.t == 3:
            reward[1] = float("nan")
        robots = torch.arange(self.num_envs)
        terminated, truncated = (robots == 0) & (self.t == 2), (robots == 1) & (self.t == 3)
        ids = (terminated | truncated).nonzero().flatten()
        self.final = {group: values[ids] for group, values in self.observe().items()}
        if self.t == 2:  # what a fallen robot saw last is of no use, even if its simulation failed
            self.final = {group: torch.full_like(values, float("nan")) for group, values in self.final.items()}
        zeros = torch.zeros(self.num_envs)
        info = StepInfo(
            ids,
            self.final,
            {"target": reward.mean()},
            zeros,
            zeros,
            zeros,
            zeros.bool(),
            zeros,
            zeros,
            truncated,
            robots,
        )
        if truncated.any():
            self.last = self.final
        obs = self.observe()
        if self.poison in DIMS and self.t == 2:
            obs[self.poison][3, 0] = float("-inf") if self.poison == "explicit" else float("nan")
        return obs, reward, terminated, truncated, info


def make_ppo(config: PPOConfig | None = None, num_envs: int = 32, seed: int = 0, **options) -> PPO:
    torch.manual_seed(seed)
    return PPO(ActorCritic(DIMS, 2, NETWORK), config or PPOConfig(steps=4), num_envs, DIMS, seed, **options)
