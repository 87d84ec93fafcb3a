"""The two networks that stand in for privileged state, prepared before a student is trained."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from distill import checkpoint
from distill.errors import CheckpointError, InterfaceError
from distill.history import begin, push
from distill.interfaces import VELOCITY, Observation, PrivilegedTeacher, Teacher
from distill.networks import HistoryEncoder, mlp
from distill.teachers import has_scan


@dataclass(frozen=True)
class AdaptationConfig:
    """Sizes of estimator and history encoder."""

    history: int = 11
    """Frames in the window, the newest included: ten past frames and the present one."""
    frame_features: int = 32
    """Width of the linear layer applied to each frame."""
    channels: tuple[int, ...] = (16, 16)
    """Channels of the convolutions over time."""
    features: int = 128
    """Width of the layer before the latent."""
    estimator: tuple[int, ...] = (128, 64)
    """Hidden layers of the estimator."""
    estimator_frames: int | None = None
    """Frames that the estimator reads, the newest; None: the whole window. The paper's reads one, which hardly tells
    the velocity: where the policy acts on it, the robot drifts off."""

    def __post_init__(self) -> None:
        if self.history < 1:
            raise ValueError(f"AdaptationConfig.history is {self.history}; it must be at least 1")
        if self.estimator_frames is not None and not 1 <= self.estimator_frames <= self.history:
            raise ValueError(
                f"AdaptationConfig.estimator_frames is {self.estimator_frames}; expected 1 to history, {self.history}"
            )


class AdaptationModule(nn.Module):
    """Estimator and history encoder (paper, section III-D).

    The estimator reads the base velocity from the newest frames of a window, the history encoder the privileged latent
    from all of them. Columns of the proprioception that no sensor of the robot gives are blanked in both.

    Args:
        proprio: P, width of one frame.
        latent_dim: L, width of the teacher's privileged latent.
        config: sizes.
        blank: columns of the proprioception to blank, such as oracle headings.
    """

    def __init__(self, proprio: int, latent_dim: int, config: AdaptationConfig, blank: Sequence[int] = ()) -> None:
        super().__init__()
        if wrong := [column for column in blank if not 0 <= column < proprio]:
            raise InterfaceError(f"columns {wrong} are to be blanked in a proprioception of {proprio} columns")
        self.proprio, self.latent_dim, self.config = proprio, latent_dim, config
        self.blank = tuple(blank)
        self._newest = config.estimator_frames or config.history
        self.estimator = mlp(self._newest * proprio, config.estimator, VELOCITY)
        self.encoder = nn.Sequential(
            HistoryEncoder(proprio, config.history, config.frame_features, config.channels, config.features),
            nn.Linear(config.features, latent_dim),
        )
        onboard = torch.ones(proprio)
        onboard[list(self.blank)] = 0.0
        self.register_buffer("_onboard", onboard)
        self._onboard: Tensor

    def frame(self, proprio: Tensor) -> Tensor:
        """What the sensors give of `proprio` (..., P)."""
        return proprio * self._onboard

    def push(self, history: Tensor, proprio: Tensor) -> Tensor:
        """The window (B, H, P) that ends with `proprio` (B, P), from that of the step before; zeros at a start."""
        frame = self.frame(proprio)
        return push(begin(history, frame), frame)

    def window(self, obs: Observation) -> Tensor:
        """The window (..., H, P) in the groups "history" (..., (H - 1) P), oldest first, and "proprio" (..., P).

        Raises:
            InterfaceError: the environment's history has another length, or there is none.
        """
        frame = self.frame(obs["proprio"]).unsqueeze(-2)
        past = self.config.history - 1
        width = obs["history"].shape[-1] if "history" in obs else 0
        if width != past * self.proprio:
            raise InterfaceError(
                f"observation group 'history' is {width} wide, expected {past} past frames of {self.proprio}: "
                f"have the environment observe {past} frames, or set AdaptationConfig.history"
            )
        if not past:
            return frame
        frames = self.frame(obs["history"].unflatten(-1, (past, self.proprio)))
        return torch.cat((frames, frame), dim=-2)

    def velocity(self, window: Tensor) -> Tensor:
        """Estimated base velocity (..., 3), base frame, m/s, of windows (..., H, P)."""
        return self.estimator(window[..., -self._newest :, :].flatten(-2))

    def latent(self, window: Tensor) -> Tensor:
        """History latent (..., L) of windows (..., H, P)."""
        leading = window.shape[:-2]
        return self.encoder(window.flatten(0, -3)).view(*leading, -1)


class AdaptedTeacher:
    """The teacher after the adaptation: on estimated velocity and history latent instead of simulator truth.

    It reads the groups "proprio", "history" and, with a scan, "scan".

    Args:
        teacher: one that opens its actor.
        adaptation: its estimator and history encoder.
    """

    def __init__(self, teacher: PrivilegedTeacher, adaptation: AdaptationModule) -> None:
        self._teacher, self._adaptation = teacher, adaptation

    @torch.no_grad()
    def act(self, obs: Observation) -> Tensor:
        """Mean action, (N, 12)."""
        proprio, window = obs["proprio"], self._adaptation.window(obs)
        scan = (self._teacher.scan_latent(obs),) if has_scan(self._teacher) else ()
        velocity, latent = self._adaptation.velocity(window), self._adaptation.latent(window)
        return self._teacher.actor(torch.cat((proprio, *scan, velocity, latent), dim=1))


def build_adaptation(
    proprio: int,
    teacher: Teacher,
    config: AdaptationConfig | None = None,
    blank: Sequence[int] = (),
    device: torch.device | str = "cpu",
) -> AdaptationModule:
    """Make the networks that are to stand in for what `teacher` is told.

    Raises:
        InterfaceError: the teacher has no privileged latent to be adapted to.
    """
    if not isinstance(teacher, PrivilegedTeacher):
        raise InterfaceError("this teacher opens no privileged latent; train the student without ROA (roa=False)")
    return AdaptationModule(proprio, teacher.latent_dim, config or AdaptationConfig(), blank).to(device)


def adaptation_payload(adaptation: AdaptationModule) -> dict[str, object]:
    """Weights and sizes."""
    return {
        "proprio": adaptation.proprio,
        "latent_dim": adaptation.latent_dim,
        "config": asdict(adaptation.config),
        "blank": list(adaptation.blank),
        "weights": adaptation.state_dict(),
    }


def save_adaptation(path: Path, adaptation: AdaptationModule) -> None:
    """Write estimator and history encoder to `path`, whole or not at all."""
    checkpoint.save(path, {"adaptation": adaptation_payload(adaptation)})


def load_adaptation(path: Path, device: torch.device | str = "cpu") -> AdaptationModule:
    """Read what `save_adaptation` wrote.

    Raises:
        CheckpointError: the file is unreadable, or holds something else.
    """
    table = checkpoint.load(path).get("adaptation")
    if not isinstance(table, dict):
        raise CheckpointError(f"{path}: holds no estimator and history encoder")
    return adaptation_from(table, path).to(device).eval()


def adaptation_from(table: Mapping[str, object], path: Path) -> AdaptationModule:
    """The networks of an `adaptation_payload` read from `path` (named in errors)."""
    proprio, latent_dim, config, blank, weights = (
        table.get(key) for key in ("proprio", "latent_dim", "config", "blank", "weights")
    )
    try:
        if not isinstance(config, dict) or not isinstance(weights, dict) or not isinstance(blank, list):
            raise TypeError("a part is missing")
        if not isinstance(proprio, int) or not isinstance(latent_dim, int):
            raise TypeError("its widths are missing")
        adaptation = AdaptationModule(proprio, latent_dim, AdaptationConfig(**config), blank)
        adaptation.load_state_dict(weights)
    except (RuntimeError, TypeError, ValueError) as error:
        raise CheckpointError(f"{path}: holds no complete estimator and history encoder: {error}") from error
    return adaptation
