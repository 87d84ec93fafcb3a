"""Proximal policy optimisation with discount regularisation (Algorithm 1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from locorl.learning.advantage import generalised_advantage
from locorl.learning.config import PPOConfig
from locorl.learning.distributed import Processes, mean_and_std
from locorl.learning.divergence import DivergedError, find_fault
from locorl.learning.gradient import Descent
from locorl.learning.hooks import RolloutHook
from locorl.learning.losses import clipped_surrogate, clipped_value_loss, gaussian_kl
from locorl.learning.networks import ActorCritic, Obs
from locorl.learning.parallel import Backward, threads_for
from locorl.learning.regularisers import make_regulariser
from locorl.learning.stats import RolloutStats
from locorl.learning.storage import Minibatch, Mirror, Rollout, evaluate_rows

if TYPE_CHECKING:
    from locorl.env.legged_env import LeggedEnv

__all__ = ["PPO", "DivergedError", "PPOConfig"]


class PPO:
    """Collects rollouts and updates an `ActorCritic` on them, on the device of the model.

    Args:
        model: policy and value function; trained in place.
        config: hyperparameters.
        num_envs: N of the environment.
        dims: its observation groups.
        seed: of exploration noise and minibatches; of processes that train together each takes its own.
        hooks: what is learnt beside the policy.
        mirror: the robots' symmetry; with it each minibatch is trained together with its mirror image.
        group: the processes that train together, each on N robots.

    Attributes:
        iteration: updates so far.
        rollout: the one collected last.

    Raises:
        ValueError: `config` asks for mirroring without a `mirror`, or two hooks share a name.
    """

    def __init__(
        self,
        model: ActorCritic,
        config: PPOConfig,
        num_envs: int,
        dims: Mapping[str, int],
        seed: int,
        hooks: Sequence[RolloutHook] = (),
        mirror: Mirror | None = None,
        group: Processes | None = None,
    ) -> None:
        if config.mirror and mirror is None:
            raise ValueError("PPOConfig.mirror is set, so PPO needs `mirror`: the symmetry of the environment's robots")
        names = [hook.name for hook in hooks]
        if len(set(names)) < len(names):
            raise ValueError(f"two hooks share a name: {names}")
        self.model, self.config, self.hooks, self.mirror, self.group = model, config, tuple(hooks), mirror, group
        self.iteration = 0
        self.learning_rate = config.learning_rate
        parameters = chain(model.parameters(), *(hook.parameters() for hook in self.hooks))
        self._descent = Descent(parameters, config.learning_rate, config.max_grad_norm, group)
        self.optimizer = self._descent.optimizer
        device = model.log_std.device
        self.generator = torch.Generator(device).manual_seed(seed)
        # what a hook may want beyond what the networks read is not known
        kept = {name: size for name, size in dims.items() if self.hooks or name in model.groups}
        self.rollout = Rollout(config.steps, num_envs, kept, model.log_std.numel(), device)
        self._regulariser = make_regulariser(config, model, self.generator, group)

    # ------------------------------------------------------------------ collect

    @torch.no_grad()
    def collect(self, env: LeggedEnv, obs: Obs) -> tuple[dict[str, Tensor], dict[str, float]]:
        """Fill the rollout from `env`, starting at `obs`.

        Returns:
            The observation after the last step, and the rollout's statistics.

        Raises:
            DivergedError: an observation, an action, a reward or a value is not finite.
        """
        rollout, stats = self.rollout, RolloutStats()
        for hook in self.hooks:
            hook.begin(self.iteration)
        std = self.model.std()
        torch.randn(rollout.action.shape, generator=self.generator, out=rollout.action)
        ends: list[tuple[int, Tensor, Obs]] = []
        current = dict(obs)
        for t in range(rollout.steps):
            rollout.observe(t, current)
            mean, action = rollout.mean[t], rollout.action[t]
            with threads_for(rollout.num_envs):
                seen = self._seen(current)
                mean.copy_(self.model.act(seen))
            rollout.show(t, current, seen)
            if not mean.isfinite().all():
                self._stop(self._bad_observation(t) or find_fault("action", "the action", mean[None], t))
            action.mul_(std).add_(mean)
            current, reward, terminated, truncated, info = env.step(action)
            rollout.reward[t] = reward
            rollout.terminated[t], rollout.done[t] = terminated, terminated | truncated
            if len(info.done_ids):
                ends.append((t, info.done_ids, info.final_obs))
            stats.add(info)
        rollout.observe(rollout.steps, current)
        rollout.log_prob = self.model.log_prob(rollout.mean, rollout.action)
        self._evaluate(ends)
        fault = self._fault()
        if fault or self.group:
            self._stop(fault)
        rollout.advantage, rollout.target = generalised_advantage(
            rollout.reward,
            rollout.value,
            rollout.next_value,
            rollout.done,
            rollout.terminated,
            self.config.discount,
            self.config.lam,
        )
        summary = stats.summary(rollout, env.dt)
        return current, self.group.average_metrics(summary) if self.group else summary

    def _seen(self, obs: Obs) -> Obs:
        """What the actor sees of `obs`."""
        for hook in self.hooks:
            obs = hook.observe(obs)
        return obs

    def _evaluate(self, ends: Sequence[tuple[int, Tensor, Obs]]) -> None:
        """Values of all states, and V(s_(t+1)), of episodes cut by time that of the state they were cut in.

        Args:
            ends: step, robots (m,) and last observations, group -> (m, dim), of the episodes that ended.
        """
        rollout, groups = self.rollout, self.model.groups
        states = {group: rollout.states[group].flatten(0, 1) for group in groups}
        values = evaluate_rows(self.model.value, states).view(rollout.steps + 1, -1)
        rollout.value, rollout.next_value = values[:-1], values[1:].clone()
        if not ends:
            return
        steps = torch.cat([torch.full_like(robots, t) for t, robots, _ in ends])
        robots = torch.cat([robots for _, robots, _ in ends])
        cut = ~rollout.terminated[steps, robots]
        final = {group: torch.cat([obs[group] for _, _, obs in ends])[cut] for group in groups}
        rollout.next_value[steps[cut], robots[cut]] = evaluate_rows(self.model.value, final)

    def _bad_observation(self, first: int = 0) -> DivergedError | None:
        """What is not finite in the observations from step `first` on; those not yet seen are of the last rollout."""
        groups = ((group, states[first:]) for group, states in self.rollout.states.items())
        faults = (find_fault("observation", f"the observation group '{name}'", x, first) for name, x in groups)
        return next((fault for fault in faults if fault), None)

    def _fault(self) -> DivergedError | None:
        """What is not finite in a complete rollout."""
        rollout = self.rollout
        return (
            self._bad_observation()
            or find_fault("reward", "the reward", rollout.reward)
            or find_fault("value", "the value", rollout.value)
            or find_fault("value", "the value of the next state", rollout.next_value)
        )

    def _stop(self, fault: DivergedError | None) -> None:
        """Raise `fault`, and see to it that all processes stop if one does."""
        elsewhere = self.group is not None and self.group.any(fault is not None)
        if fault is not None:
            raise fault
        if elsewhere:
            raise DivergedError("another process that trains this policy met something that is not finite")

    # ------------------------------------------------------------------- update

    def update(self) -> dict[str, float]:
        """Improve policy and value function on the collected rollout.

        Returns:
            Mean losses, KL divergence and gradient norm, noise and learning rate, and what the hooks report.

        Raises:
            DivergedError: a loss or the gradient is not finite; all is left as it was before that minibatch.
        """
        config, rollout = self.config, self.rollout
        stats = {f"{hook.name}/{key}": x for hook in self.hooks for key, x in hook.end(rollout).items()}
        mean, std = mean_and_std(rollout.advantage, self.group)
        rollout.advantage = (rollout.advantage - mean) / (std + 1e-8)
        old_std = self.model.std().detach().clone()
        with self._backward() as backward:
            rows = [
                self._step(minibatch, old_std, backward)
                for _ in range(config.epochs)
                for minibatch in rollout.shuffle(config.minibatches, self.generator)
            ]
        stats |= {name: sum(row[name] for row in rows) / len(rows) for name in rows[0]}
        stats |= self._regulariser.after_update(rollout)
        stats |= {"action_std": float(self.model.std().detach().mean()), "learning_rate": self.learning_rate}
        self.iteration += 1
        return stats

    def _backward(self) -> Backward:
        """How gradients are computed; hooks are not asked to stand several threads."""
        parameters = self._descent.parameters
        return Backward(parameters, 1) if self.hooks else Backward.on(self.model.log_std.device, parameters)

    def _step(self, minibatch: Tensor, old_std: Tensor, backward: Backward) -> dict[str, float]:
        """One step of the optimiser, on these rows of the rollout; losses, KL divergence and gradient norm."""
        numbers = backward(lambda rows: self._loss(self.rollout.pick(rows), old_std), minibatch)
        found = self._descent.settle(**numbers)
        self._adapt(found["kl"])
        self.optimizer.step()
        return found

    def _loss(self, batch: Minibatch, old_std: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss (), and what is to be known of it, () each."""
        config, model, rows = self.config, self.model, len(batch.action)
        if self.mirror is not None:
            batch = batch.with_mirror_image(self.mirror)
        mean, value = torch.cat([model.act(seen) for seen in batch.seen]), model.value(batch.obs)
        surrogate = clipped_surrogate(model.log_prob(mean, batch.action), batch, config.clip)
        value_loss = clipped_value_loss(value, batch, config.clip)
        with torch.no_grad():  # of the policy that acted: its mirror image may be another one
            kl = gaussian_kl(mean[:rows], model.std(), batch.mean[:rows], old_std)
        loss = surrogate + config.value_weight * value_loss - config.entropy * model.entropy()
        for extra in (self._regulariser.penalty(value), *(hook.loss(batch) for hook in self.hooks)):
            if extra is not None:
                loss = loss + extra
        return loss, {"surrogate_loss": surrogate, "value_loss": value_loss, "kl": kl}

    def _adapt(self, kl: float) -> None:
        config = self.config
        if kl > 2.0 * config.desired_kl:
            self.learning_rate = max(config.min_learning_rate, self.learning_rate / 1.5)
        elif 0.0 < kl < 0.5 * config.desired_kl:
            self.learning_rate = min(config.max_learning_rate, self.learning_rate * 1.5)
        for group in self.optimizer.param_groups:
            group["lr"] = self.learning_rate

    # -------------------------------------------------------------------- state

    def state_dict(self) -> dict[str, Any]:
        """Optimiser, random stream, hooks and regulariser; the model is saved by its owner."""
        return {
            "optimizer": self.optimizer.state_dict(),
            "learning_rate": self.learning_rate,
            "iteration": self.iteration,
            "generator": self.generator.get_state(),
            "hooks": {hook.name: hook.state_dict() for hook in self.hooks},
            "regulariser": self._regulariser.state_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go back to a saved state.

        Raises:
            ValueError: it was saved with other hooks; nothing has changed then.
        """
        saved, here = sorted(state["hooks"]), sorted(hook.name for hook in self.hooks)
        if saved != here:
            raise ValueError(f"this training was saved with the hooks {saved}, and now has {here}: give it the same")
        self.optimizer.load_state_dict(state["optimizer"])
        self.learning_rate = float(state["learning_rate"])
        self.iteration = int(state["iteration"])
        self.generator.set_state(state["generator"].cpu())
        for hook in self.hooks:
            hook.load_state_dict(state["hooks"][hook.name])
        self._regulariser.load_state_dict(state["regulariser"])
