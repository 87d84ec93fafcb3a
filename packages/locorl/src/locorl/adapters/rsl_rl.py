"""LeggedEnv as an rsl_rl `VecEnv`, our hyperparameters for its runner, and its policies as actors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from locorl.config import to_dict
from locorl.env.legged_env import LeggedEnv
from locorl.learning.networks import NetworkConfig
from locorl.learning.ppo import PPOConfig

try:
    from rsl_rl.env import VecEnv
    from rsl_rl.models import MLPModel
    from tensordict import TensorDict
except ImportError as error:
    raise ImportError("the rsl_rl environment needs rsl-rl-lib 5: pip install legged-locorl[rsl-rl]") from error


class RslRlVecEnv(VecEnv):
    """N robots as an rsl_rl environment::

        env = RslRlVecEnv(LeggedEnv(factory, designs, task))
        torch.manual_seed(0)
        runner = OnPolicyRunner(env, rsl_rl_config(env), log_dir="runs/rsl_rl")
        runner.learn(500)
        evaluate(RslRlActor(runner.get_inference_policy()), factory, designs, task)

    Observations are a `TensorDict` of the groups of `LeggedEnv`; which of them actor and critic see is said in the
    runner's configuration (`rsl_rl_config`). `extras["time_outs"]` (N,) marks episodes cut by time, which rsl_rl
    bootstraps with the value of the state before the cut; `extras["log"]` holds, as means over the robots,
    `reward/<term>` and `reward/total` (1/s), `episode/tracking_error` (m/s), `episode/falls` (1/s) and
    `episode/diverged` (1/s).

    Args:
        env: the robots; it is reset here.
    """

    def __init__(self, env: LeggedEnv) -> None:
        self.env = env
        self.num_envs, self.num_actions = env.num_envs, env.num_actions
        self.max_episode_length = env.task.episode_steps
        self.device = env.device
        self.cfg = to_dict(env.task)
        self._obs: Mapping[str, Tensor] = env.reset()

    @property
    def episode_length_buf(self) -> Tensor:
        """Age of each episode, (N,), steps."""
        return self.env.episode_step

    @episode_length_buf.setter
    def episode_length_buf(self, steps: Tensor) -> None:  # pyright: ignore[reportIncompatibleVariableOverride]
        self.env.episode_step[:] = steps

    def get_observations(self) -> TensorDict:
        """The present observation, group -> (N, dim)."""
        return TensorDict(dict(self._obs), batch_size=[self.num_envs])

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict[str, Any]]:
        """Advance one control period with `actions` (N, 12); see `rsl_rl.env.VecEnv.step`."""
        # the runner's inference mode would leave state behind that nobody may write outside it
        with torch.inference_mode(False), torch.no_grad():
            self._obs, reward, terminated, truncated, info = self.env.step(actions)
            dt = self.env.dt
            log = {f"reward/{name}": value / dt for name, value in info.reward_terms.items()}
            log["reward/total"] = reward.mean() / dt
            log["episode/tracking_error"] = info.tracking_error.mean()
            log["episode/falls"] = terminated.float().mean() / dt
            log["episode/diverged"] = info.diverged.float().mean() / dt
            dones = (terminated | truncated).long()
            return self.get_observations(), reward, dones, {"time_outs": truncated, "log": log}


class RslRlActor:
    """A policy that rsl_rl has learnt, as an actor for `locorl.evaluate`; acts with the mean action.

    Args:
        policy: as `OnPolicyRunner.get_inference_policy` gives it.
    """

    def __init__(self, policy: MLPModel) -> None:
        self.policy = policy.eval()

    def reset(self, done: Tensor | None = None) -> None:
        """Forget; everything, or only robots where `done` (N,)."""
        self.policy.reset(done)

    @torch.no_grad()
    def act(self, obs: Mapping[str, Tensor]) -> Tensor:
        """Mean action, (N, 12)."""
        return self.policy(TensorDict(dict(obs), batch_size=[len(next(iter(obs.values())))]))


def rsl_rl_config(
    env: LeggedEnv | RslRlVecEnv,
    ppo: PPOConfig | None = None,
    network: NetworkConfig | None = None,
    actor: Sequence[str] | None = None,
    critic: Sequence[str] | None = None,
    save_interval: int = 50,
) -> dict[str, Any]:
    """A new configuration of `rsl_rl.runners.OnPolicyRunner` with our hyperparameters.

    What rsl_rl does otherwise: actor and critic read their groups without a privileged encoder, each has its
    gradient clipped on its own, and the bounds of the learning rate are fixed.

    Args:
        env: names the observation groups.
        ppo: hyperparameters.
        network: hidden layers and exploration noise.
        actor: groups that the actor sees; all by default.
        critic: groups that the critic sees; all by default.
        save_interval: iterations between checkpoints.

    Raises:
        ValueError: the environment has no such group, or rsl_rl lacks what `ppo` asks for.
    """
    env = env.env if isinstance(env, RslRlVecEnv) else env
    ppo, network = ppo or PPOConfig(), network or NetworkConfig()
    if ppo.mirror or ppo.regulariser in ("activation", "ppg"):
        raise ValueError("this configuration of rsl_rl has no mirror images, activation regulariser or ppg: drop them")
    known = list(env.group_dims)
    groups = {"actor": list(actor or known), "critic": list(critic or known)}
    unknown = {group for names in groups.values() for group in names if group not in known}
    if unknown:
        raise ValueError(f"no observation groups {sorted(unknown)}; the environment has {known}")
    return {
        "num_steps_per_env": ppo.steps,
        "save_interval": save_interval,
        "obs_groups": groups,
        "algorithm": {
            "class_name": "PPO",
            "num_learning_epochs": ppo.epochs,
            "num_mini_batches": ppo.minibatches,
            "clip_param": ppo.clip,
            "gamma": ppo.discount,
            "lam": ppo.lam,
            "value_loss_coef": ppo.value_weight,
            "entropy_coef": ppo.entropy,
            "learning_rate": ppo.learning_rate,
            "schedule": "adaptive",
            "desired_kl": ppo.desired_kl,
            "max_grad_norm": ppo.max_grad_norm,
        },
        "actor": {
            "class_name": "MLPModel",
            "hidden_dims": list(network.actor),
            "activation": "elu",
            "distribution_cfg": {
                "class_name": "GaussianDistribution",
                "init_std": network.initial_std,
                "std_range": (network.min_std, 1e6),
                "std_type": "log",
            },
        },
        "critic": {"class_name": "MLPModel", "hidden_dims": list(network.critic), "activation": "elu"},
    }
