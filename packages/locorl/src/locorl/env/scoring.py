"""What a control step earned."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from locorl.env.contacts import Contacts
from locorl.env.embodiment import Embodiment
from locorl.env.guidance import Guidance
from locorl.env.state import Motion, Stateful
from locorl.env.swing import Swing
from locorl.rewards.config import RewardConfig
from locorl.rewards.state import StepState
from locorl.rewards.total import active_terms, total_reward
from locorl.simulation.simulator import Simulator
from locorl.terrain.heights import HeightGrid


class Scoring(Stateful):
    """Gathers what the reward terms look at, and remembers what they compare it with.

    Args:
        config: weights.
        sim: the simulator.
        ground: heights, for edges.
        dt: control period, s.
    """

    _state = ("last_qd", "last_torque")

    def __init__(self, config: RewardConfig, sim: Simulator, ground: HeightGrid, dt: float) -> None:
        self.config, self._sim, self._ground, self._dt = config, sim, ground, dt
        self._terms = active_terms(config)
        self.last_qd, self.last_torque = (torch.zeros(sim.num_envs, 12, device=sim.device) for _ in range(2))
        self._swing = Swing(sim, dt) if self._looks_at("low_swing") else None
        self._nothing = torch.zeros(1, 1, device=sim.device)

    def _looks_at(self, term: str) -> bool:
        """Whether what `term` needs is measured; nobody knows what terms of one's own need."""
        return term in self._terms or bool(self.config.own)

    def reset(self, ids: Tensor, qd: Tensor) -> None:
        """Robots `ids` (m,) start with joint velocities `qd` (m, 12), rad/s, and without torque."""
        self.last_qd[ids] = qd
        self.last_torque[ids] = 0.0
        if self._swing is not None:
            self._swing.reset(ids)

    def state_dict(self) -> dict[str, Tensor]:
        """See `Stateful`."""
        return {**super().state_dict(), **({} if self._swing is None else self._swing.state_dict())}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """See `Stateful`."""
        super().load_state_dict(state)
        if self._swing is not None:
            self._swing.load_state_dict(state)

    def reward(
        self,
        now: Motion,
        body: Embodiment,
        contacts: Contacts,
        guidance: Guidance,
        direction: Tensor,
        action: Tensor,
        last_action: Tensor,
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Reward of the step that led to `now`, (N,), and the share of each term, name -> (N,)."""
        # what only some rewards look at
        edges = forces = heading = self._nothing
        if self._looks_at("clearance"):
            near = self._ground.near_edge(self._sim.foot_position[..., :2].float())
            edges = (contacts.touching & near).float()
        if self._looks_at("stumble"):
            forces = contacts.foot_forces()
        if self._looks_at("heading_tracking"):
            heading = guidance.heading_error(now)
        if self._swing is not None:
            self._swing.update(contacts.touching)
        torque = self._sim.torque.to(torch.float32, copy=True)
        state = StepState(
            velocity=now.velocity,
            rate=now.rate,
            command=guidance.velocity_command(now, direction),
            q_error=now.q - body.stance_q,
            joint_acceleration=(now.qd - self.last_qd) / self._dt,
            action=action,
            last_action=last_action,
            torque=torque,
            last_torque=self.last_torque,
            landed_air_time=contacts.air_time,
            landed=contacts.landed.float(),
            colliding_links=contacts.colliding_links(),
            specific_power=self._sim.positive_work.float() / self._dt / body.weight,
            velocity_world=now.velocity_world,
            goal_direction=direction,
            heading_error=heading,
            gravity=now.gravity,
            edge_feet=edges,
            foot_speed=self._nothing if self._swing is None else self._swing.speed,
            foot_rise=self._nothing if self._swing is None else self._swing.rise,
            foot_force=forces,
        )
        result = total_reward(state, self.config, self._dt)
        self.last_qd, self.last_torque = now.qd, torque
        return result
