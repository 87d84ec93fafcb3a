"""Sizes of a seeing student, and hyperparameters of its training."""

from __future__ import annotations

from dataclasses import dataclass, field

from distill.adaptation.modules import AdaptationConfig
from distill.training import ScheduleConfig


@dataclass(frozen=True)
class Convolution:
    """One layer of the image network, ELU behind it."""

    channels: int
    """Channels that it gives."""
    kernel: int
    """Height and width of the kernel, px."""
    stride: int = 1
    """Step of the kernel, px."""
    pool: int = 1
    """Height and width of the maximum pooling after it; 1: none."""


@dataclass(frozen=True)
class DepthEncoderConfig:
    """Sizes of the depth encoder; the defaults suit images of 24 x 36 pixels on a CPU."""

    convolutions: tuple[Convolution, ...] = (Convolution(16, 5, stride=2), Convolution(32, 3, stride=2))
    """Layers of the image network."""
    image_hidden: int = 64
    """Width of the layer between the last convolution and the image's features."""
    image_features: int = 32
    """Width of the image's features."""
    fusion: tuple[int, ...] = (128, 32)
    """Layers that join the image's features with proprioception; the last one feeds the memory."""
    memory: int = 128
    """Width of the recurrent state (GRU)."""
    contrast: bool = True
    """Whether the image network is also shown the contrast of inverse depth, in which edges of low obstacles stand out
    and level ground does not; without it, it takes a network long to see them at all."""

    @classmethod
    def large(cls) -> DepthEncoderConfig:
        """Sizes of the reference implementation (Extreme Parkour), for images of 58 x 87 pixels on a GPU."""
        return cls((Convolution(32, 5, pool=2), Convolution(64, 3)), image_hidden=128, memory=512, contrast=False)

    def __post_init__(self) -> None:
        if not self.convolutions or not self.fusion:
            raise ValueError("DepthEncoderConfig needs at least one convolution and one layer of fusion")


@dataclass(frozen=True)
class VisionStudentConfig:
    """Architecture and timing of a seeing student."""

    depth: DepthEncoderConfig = field(default_factory=DepthEncoderConfig)
    """The depth encoder."""
    adaptation: AdaptationConfig = field(default_factory=AdaptationConfig)
    """Estimator and history encoder; prepared ones bring their own."""
    latency: int = 5
    """Control steps from an image to the first action that what it shows has part in."""
    heading_limit: float = 1.5
    """Largest heading that can be predicted, rad."""
    blind: bool = False
    """Ablation: whatever the camera shows, the encoder is given an image of nothing."""
    terrain_dim: int = 32
    """Width of the terrain latent; a teacher with a scan encoder overrules it."""
    latent_dim: int = 20
    """Width of the history latent; a teacher with an encoder of its own overrules it."""
    actor_hidden: tuple[int, ...] = (256, 128, 64)
    """Hidden layers of the backbone; a teacher that opens its actor overrules them."""

    def __post_init__(self) -> None:
        if self.latency < 0 or self.heading_limit <= 0.0:
            raise ValueError(
                f"VisionStudentConfig: need latency >= 0 and heading_limit > 0, "
                f"got {self.latency} and {self.heading_limit}"
            )


@dataclass(frozen=True)
class VisionTrainConfig(ScheduleConfig):
    """Hyperparameters of the training of a seeing student (paper, section III-D)."""

    iterations: int = 300
    """Rollouts, each followed by gradient steps."""
    rollout_steps: int = 60
    """Control steps per robot and rollout, a multiple of the camera's period; gradients flow back through as many."""
    segment: int = 25
    """Iterations between restarts of the environment; a checkpoint is written at each restart."""
    memory: int = 4
    """Rollouts that gradient steps draw from; older ones are dropped."""
    updates: int = 8
    """Gradient steps per iteration."""
    batch: int = 32
    """Robots whose part of a rollout makes up a gradient step; all of them if there are fewer."""
    heading_weight: float = 1.0
    """Weight of the squared error of the headings, rad^2; that of the actions has weight 1."""
    mts: bool = True
    """Mixture of teacher and student: the predicted heading is used only where it is near the oracle. False, an
    ablation: it is always used."""
    threshold: float = 0.6
    """How near, rad."""
    roa: bool = True
    """Use a prepared estimator and history encoder as they are. False, an ablation: both are trained from scratch
    with the student, the one on the base velocity, the other through the actions alone."""
    latent_supervision: bool = False
    """Ablation: the terrain latent is also drawn to the teacher's scan latent."""
    terrain_weight: float = 1.0
    """Weight of the squared error of the terrain latent, if it is supervised."""
    velocity_weight: float = 1.0
    """Weight of the squared error of the base velocity, (m/s)^2, without ROA."""

    def __post_init__(self) -> None:
        """Refuse a training that does nothing."""
        super().__post_init__()
        self._at_least_one("memory", "batch")
        if self.threshold <= 0.0:
            raise ValueError(f"VisionTrainConfig.threshold is {self.threshold} rad; it must be above 0")
