"""The bodies of N robots as the environment uses them: stances, weights, and what the policy is told of them."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import torch
from torch import Tensor

from locorl.env.observation import ObsLayout
from locorl.env.randomisation import Perturbation, RandomisationConfig, perturbed_fields
from locorl.interfaces import Array, BodyBatch, BodyFactory, DesignSpace

GRAVITY = 9.81


def make_bodies(factory: BodyFactory, designs: Array, scene: mujoco.MjSpec) -> BodyBatch:
    """The bodies of `designs` (N, d) in `scene`.

    Raises:
        ValueError: a design has no stance, or the shape does not fit the design space.
    """
    designs = np.asarray(designs, dtype=np.float64)
    if designs.ndim != 2 or designs.shape[1] != len(factory.space.names) or not len(designs):
        raise ValueError(f"designs must be (n, {len(factory.space.names)}), got {designs.shape}")
    bodies = factory.batch(designs, scene)
    if not bodies.feasible.all():
        bad = int(np.flatnonzero(~bodies.feasible)[0])
        raise ValueError(f"robot {bad} with design {designs[bad]} has no stance; sample feasible designs")
    return bodies


@dataclass(frozen=True)
class Embodiment:
    """N bodies with what was drawn for each.

    Attributes:
        bodies: as the factory made them.
        drawn: friction, payload, motors.
        stance_qpos: standing at the origin of level ground, (N, 19), double precision.
        stance_q: joint angles of the stance, (N, 12), rad.
        stance_ctrl: targets that hold it, (N, 12), rad.
        stance_height: base above ground, (N,), m.
        mass: payload included, (N,), kg, double precision.
        weight: the same, N, single precision.
    """

    bodies: BodyBatch
    drawn: Perturbation
    stance_qpos: Tensor
    stance_q: Tensor
    stance_ctrl: Tensor
    stance_height: Tensor
    mass: Tensor
    weight: Tensor

    @classmethod
    def of(cls, bodies: BodyBatch, drawn: Perturbation) -> Embodiment:
        """Tensors of `bodies` on the device of `drawn`."""
        device = drawn.friction.device

        def tensor(values: Array) -> Tensor:
            return torch.from_numpy(np.array(values, dtype=np.float64)).to(device)

        stance = tensor(bodies.stance_qpos)
        mass = tensor(bodies.total_mass) + drawn.payload
        return cls(
            bodies=bodies,
            drawn=drawn,
            stance_qpos=stance,
            stance_q=stance[:, 7:].float(),
            stance_ctrl=tensor(bodies.stance_ctrl).float(),
            stance_height=stance[:, 2].float(),
            mass=mass,
            weight=mass.float() * GRAVITY,
        )

    def fields(self, config: RandomisationConfig) -> dict[str, Array]:
        """Model fields that the perturbation changes, on top of the bodies' own."""
        return perturbed_fields(self.bodies, self.drawn, config)

    def describe(self, layout: ObsLayout, space: DesignSpace, centre_of_mass: Tensor) -> Tensor:
        """The implicit privileged state e_t (section III-A), (N, dim).

        Args:
            layout: names and scales of its terms.
            space: the design space.
            centre_of_mass: relative to the base in the stance, (N, 3), m.
        """
        half_range = np.maximum((np.asarray(space.high) - np.asarray(space.low)) / 2, 1e-9)
        design = (np.asarray(self.bodies.designs) - np.asarray(space.nominal)) / half_range
        nominal_mass = float(self.bodies.model.body_mass.sum())
        drawn = self.drawn
        values = {
            "design": torch.from_numpy(design).to(self.mass.device),
            "mass_ratio": (self.mass / nominal_mass - 1.0)[:, None],
            "centre_of_mass": centre_of_mass,
            "stance_height": self.stance_qpos[:, 2:3],
            "friction": drawn.friction[:, None],
            "joint_damping": drawn.joint_damping[:, None],
            "payload": drawn.payload[:, None],
            "motor_strength": drawn.motor_strength - 1.0,
            "motor_damping": drawn.motor_damping - 1.0,
        }
        return torch.cat([(term.scale * values[term.name]).float() for term in layout.implicit], dim=1)
