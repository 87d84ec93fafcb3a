"""Hyperparameters of PPO and of its regularisers."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

RegulariserName = Literal["discount", "activation", "ppg", "none"]


@dataclass(frozen=True)
class PPGConfig:
    """Auxiliary phase of phasic policy gradient, from its authors' published settings.

    Theirs are for iterations of 64 x 256 samples, ours have 1024 x 24, which is 1.5 times as many. Rescaled are

    - the iterations between auxiliary phases, 32 / 1.5 = 21, for the same samples in a phase;
    - the auxiliary minibatches: theirs have 1024 rows, half of a minibatch of their policy phase, and so have ours.

    Kept are the six auxiliary epochs, the weights 1 of cloning and of both value losses, and the rate of the
    auxiliary optimiser. The policy phase stays that of PPO, with its epochs and its adaptive rate, so that
    regularisers are compared on the same algorithm.
    """

    policy_iterations: int = 21
    """Iterations of PPO between auxiliary phases (N_pi)."""
    epochs: int = 6
    """Passes over the samples of those iterations (E_aux)."""
    minibatches: int = 8
    """Auxiliary minibatches for each stored rollout in a pass."""
    clone_weight: float = 1.0
    """Weight of the KL divergence from the policy before the phase (beta_clone)."""
    value_weight: float = 1.0
    """Weight of the critic's own loss in the phase."""
    learning_rate: float = 5e-4
    """Of the phase's own Adam."""

    def __post_init__(self) -> None:
        """Refuse impossible settings before anything runs."""
        if min(self.policy_iterations, self.epochs, self.minibatches) < 1:
            raise ValueError("PPGConfig: policy_iterations, epochs and minibatches must be at least 1")


@dataclass(frozen=True)
class PPOConfig:
    """Hyperparameters of PPO."""

    gamma_reg: float = 0.98
    """Regularised discount (section III-B2), in force with the regulariser "discount"."""
    lam: float = 0.95
    """Lambda of the advantage estimator."""
    steps: int = 24
    """Control steps of each robot in one rollout."""
    epochs: int = 5
    """Passes over a rollout."""
    minibatches: int = 4
    """Minibatches in a pass."""
    clip: float = 0.2
    """Clipping of the likelihood ratio and of the value step."""
    entropy: float = 0.002
    """Weight of the entropy bonus."""
    value_weight: float = 1.0
    """Weight of the value loss."""
    learning_rate: float = 1e-3
    """Initial learning rate of Adam; it then adapts to the KL divergence."""
    min_learning_rate: float = 1e-5
    max_learning_rate: float = 1e-2
    desired_kl: float = 0.01
    """The learning rate falls above twice and rises below half this divergence."""
    max_grad_norm: float = 1.0
    """Gradients are clipped to this norm."""
    regulariser: RegulariserName = "discount"
    """What keeps the critic from overfitting (section IV-B2); "none" is the paper's baseline "normal"."""
    gamma: float = 0.99
    """Discount with any other regulariser than "discount"."""
    activation_weight: float = 1.0
    """Weight of the activation regulariser's penalty on values above `v_max`."""
    v_max: float = 6.0
    """The highest value that an estimate may have; the default is that of tracking perfectly for ever at discount
    0.99 under the default reward, (2 + 1)/s x 0.02 s / (1 - 0.99)."""
    ppg: PPGConfig = field(default_factory=PPGConfig)
    """The auxiliary phase of the regulariser "ppg"."""
    mirror: bool = False
    """Train each minibatch together with its left-right mirror image."""

    def __post_init__(self) -> None:
        """Refuse impossible settings before anything runs."""
        if not 0.0 < min(self.gamma_reg, self.gamma) <= max(self.gamma_reg, self.gamma) < 1.0:
            raise ValueError(f"PPOConfig: need 0 < gamma_reg, gamma < 1, got {self.gamma_reg}, {self.gamma}")
        if not 0.0 <= self.lam <= 1.0:
            raise ValueError(f"PPOConfig: need 0 <= lam <= 1, got {self.lam}")
        if min(self.steps, self.epochs, self.minibatches) < 1:
            raise ValueError("PPOConfig: steps, epochs and minibatches must be at least 1")
        if self.activation_weight < 0.0:
            raise ValueError(f"PPOConfig: activation_weight must be 0 or more, got {self.activation_weight}")

    @property
    def discount(self) -> float:
        """The discount in force."""
        return self.gamma_reg if self.regulariser == "discount" else self.gamma
