"""The seeing student: depth encoder, estimator, history encoder and backbone in one module."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from distill import checkpoint
from distill.adaptation.modules import AdaptationConfig, AdaptationModule
from distill.errors import InterfaceError
from distill.interfaces import ACTIONS, VELOCITY, PrivilegedTeacher, Teacher, VisionEnv
from distill.networks import mlp
from distill.teachers import check_actor, copy_actor, has_scan
from distill.vision.config import Convolution, DepthEncoderConfig, VisionStudentConfig
from distill.vision.depth_encoder import NOTHING, DepthEncoder


class VisionStudent(nn.Module):
    """A policy on proprioception and depth (paper, section III-D and Fig. 3).

    The backbone reads [proprio, terrain latent, velocity, history latent], as the actor of a teacher with a scan
    does, with the headings in the proprioception replaced by predicted ones. Heading and velocity are detached
    there, so that they stay estimates in rad and m/s.

    Args:
        proprio: P, width of one frame.
        heading: columns of the headings in it.
        depth_shape: rows and columns of an image.
        depth_period: control steps between two images.
        config: sizes and timing.
        adaptation: estimator and history encoder.
        actor: backbone (B, P + S + 3 + L) -> (B, 12).
    """

    def __init__(
        self,
        proprio: int,
        heading: slice,
        depth_shape: tuple[int, int],
        depth_period: int,
        config: VisionStudentConfig,
        adaptation: AdaptationModule,
        actor: nn.Module,
    ) -> None:
        super().__init__()
        self.proprio, self.heading, self.config = proprio, heading, config
        self.depth_shape, self.depth_period = depth_shape, depth_period
        self.headings = heading.stop - heading.start
        self.depth_encoder = DepthEncoder(
            depth_shape, proprio, config.terrain_dim, self.headings, config.heading_limit, config.depth
        )
        self.adaptation, self.actor = adaptation, actor

    @property
    def history(self) -> int:
        """H, frames in the window of the history encoder."""
        return self.adaptation.config.history

    def features(self, depth: Tensor) -> Tensor:
        """Features (B, F) of images (B, rows, columns); of nothing, if the student is blind."""
        return self.depth_encoder.features(torch.full_like(depth, NOTHING) if self.config.blind else depth)

    def see(self, features: Tensor, proprio: Tensor, memory: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Take in an image; see `DepthEncoder.recall`. The headings in `proprio` (B, P) are not read."""
        return self.depth_encoder.recall(features, self.adaptation.frame(proprio), memory)

    def infer(self, proprio: Tensor, terrain: Tensor, heading: Tensor, velocity: Tensor, latent: Tensor) -> Tensor:
        """Action (B, 12) on all that the student knows; `heading` (B, K) takes the place of that in `proprio`."""
        before, after = proprio[:, : self.heading.start], proprio[:, self.heading.stop :]
        return self.actor(torch.cat((before, heading.detach(), after, terrain, velocity.detach(), latent), dim=1))

    def forward(
        self, obs: Tensor, terrain: Tensor, heading: Tensor, history_in: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """One control step, as exported.

        Args:
            obs: (B, P) the present frame of proprioception; its headings are not read.
            terrain: (B, S) terrain latent in use; zeros until the first one is due.
            heading: (B, K) headings in use, rad; zeros until the first ones are due.
            history_in: (B, H, P) `history_out` of the step before; zeros at the start of an episode.

        Returns:
            action (B, 12), estimated base linear velocity (B, 3) in the base frame in m/s,
            and history_out (B, H, P).
        """
        window = self.adaptation.push(history_in, obs)
        velocity, latent = self.adaptation.velocity(window), self.adaptation.latent(window)
        return self.infer(obs, terrain, heading, velocity, latent), velocity, window


def heading_columns(heading: slice, proprio: int) -> tuple[int, ...]:
    """Columns of the headings in a frame of `proprio` columns.

    Raises:
        InterfaceError: the slice is empty, or reaches beyond the frame.
    """
    columns = tuple(range(heading.start or 0, heading.stop if heading.stop is not None else proprio))
    if not columns or heading.step not in (None, 1) or columns[0] < 0 or columns[-1] >= proprio:
        raise InterfaceError(
            f"heading columns {heading} of a proprioception of {proprio} columns: expected slice(first, last + 1) "
            "of at least one of them"
        )
    return columns


def build_vision_student(
    env: VisionEnv, teacher: Teacher, config: VisionStudentConfig, adaptation: AdaptationModule | None = None
) -> VisionStudent:
    """Make a seeing student for a teacher.

    Its backbone starts as a copy of the actor of a teacher that sees the terrain; any other teacher is imitated with
    a fresh one.

    Args:
        env: gives the shapes.
        teacher: the policy to imitate.
        config: sizes and timing.
        adaptation: prepared estimator and history encoder, which are copied; None makes fresh ones.

    Raises:
        InterfaceError: environment, teacher and adaptation do not fit together.
    """
    proprio = env.group_dims["proprio"]
    columns = heading_columns(env.heading, proprio)
    return _assemble(
        proprio, slice(columns[0], columns[-1] + 1), env.depth_shape, env.depth_period, teacher, config, adaptation
    ).to(env.device)


def _assemble(
    proprio: int,
    heading: slice,
    depth_shape: tuple[int, int],
    depth_period: int,
    teacher: Teacher,
    config: VisionStudentConfig,
    prepared: AdaptationModule | None,
) -> VisionStudent:
    blank = tuple(range(heading.start, heading.stop))
    if isinstance(teacher, PrivilegedTeacher):
        config = replace(config, latent_dim=teacher.latent_dim)
    if prepared is not None:
        found = (prepared.proprio, prepared.latent_dim, prepared.blank)
        if found != (proprio, config.latent_dim, blank):
            raise InterfaceError(
                f"the prepared history encoder reads {found[0]} columns of which {found[2]} are blank and gives a "
                f"latent of {found[1]}; here it must be {proprio}, {blank} and {config.latent_dim}"
            )
        config = replace(config, adaptation=prepared.config)
    adaptation = AdaptationModule(proprio, config.latent_dim, config.adaptation, blank)
    if prepared is not None:
        adaptation.load_state_dict(prepared.state_dict())
    if has_scan(teacher):
        config = replace(config, terrain_dim=teacher.scan_latent_dim)
        actor = copy_actor(teacher).cpu()
        check_actor(actor, _inputs(proprio, config), "cpu")
    else:
        actor = mlp(sum(_inputs(proprio, config).values()), config.actor_hidden, ACTIONS)
    return VisionStudent(proprio, heading, depth_shape, depth_period, config, adaptation, actor)


def _inputs(proprio: int, config: VisionStudentConfig) -> dict[str, int]:
    return {
        "proprio": proprio,
        "scan latent": config.terrain_dim,
        "velocity": VELOCITY,
        "latent": config.latent_dim,
    }


def vision_payload(student: VisionStudent) -> dict[str, object]:
    """Weights, architecture and shapes of a seeing student."""
    made_with = {
        "proprio": student.proprio,
        "heading": [student.heading.start, student.heading.stop],
        "depth_shape": list(student.depth_shape),
        "depth_period": student.depth_period,
        "architecture": asdict(student.config),
    }
    return checkpoint.student_payload("seeing", student, made_with)


def load_vision_student(path: Path, teacher: Teacher, device: torch.device | str = "cpu") -> VisionStudent:
    """Rebuild a trained student from `student.pt` or `checkpoint.pt`.

    Args:
        path: the file.
        teacher: the teacher that it was trained with; it gives the shape of the backbone.
        device: where the student shall live.

    Raises:
        CheckpointError: the file is unreadable, or the student is blind or belongs to another teacher.
    """

    def make(table: Mapping[str, Any]) -> VisionStudent:
        heading, (rows, columns) = slice(*table["heading"]), table["depth_shape"]
        config = config_from(table["architecture"])
        return _assemble(table["proprio"], heading, (rows, columns), table["depth_period"], teacher, config, None)

    return checkpoint.rebuild_student(path, "seeing", make, device)


def config_from(table: Mapping[str, Any]) -> VisionStudentConfig:
    """The configuration that `dataclasses.asdict` made a table of."""
    depth = dict(table["depth"])
    convolutions = tuple(Convolution(**layer) for layer in depth.pop("convolutions"))
    return VisionStudentConfig(
        **{
            **table,
            "depth": DepthEncoderConfig(convolutions, **depth),
            "adaptation": AdaptationConfig(**table["adaptation"]),
        }
    )
