"""Depth encoder: from images and proprioception to a latent of the terrain and the way to go."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import pad

from distill.errors import InterfaceError
from distill.vision.config import DepthEncoderConfig

NOTHING = 0.5
"""Pixel of a ray that meets nothing within the camera's range."""


_WINDOW, _GAIN, _CLIP, _NEAREST = (3, 7), 30.0, 3.0, 0.1
"""Of the contrast: rows and columns of the mean, factor and limit of the difference, nearest depth of all depths."""


def contrast(image: Tensor) -> Tensor:
    """How inverse depth differs from its mean around, (..., rows, columns), about 1 in size at edges.

    The inverse depth of a plane is affine in the image, so ground and walls read 0 whatever way the camera looks.

    Args:
        image: (..., rows, columns), from -0.5 (no distance) to 0.5 (far).
    """
    inverse = (image + NOTHING).clamp(min=_NEAREST).reciprocal()
    around = _window_sum(inverse) / _window_sum(torch.ones_like(inverse))
    return (_GAIN * (inverse - around)).clamp(-_CLIP, _CLIP)


def _window_sum(image: Tensor) -> Tensor:
    """Sum over the window about each pixel, (..., rows, columns), in an order that is the same in every runtime.

    Pooling adds up as it likes, and the gain would make that difference thirty times as large.
    """
    rows, columns = (size // 2 for size in _WINDOW)
    image = pad(image, (columns, columns, rows, rows))
    for dim, size in zip((-2, -1), _WINDOW, strict=True):
        length = image.shape[dim] - size + 1
        shifted = [image.narrow(dim, first, length) for first in range(size)]
        image = shifted[0]
        for each in shifted[1:]:
            image = image + each
    return image


class DepthEncoder(nn.Module):
    """CNN over the image, joined with proprioception, then a GRU (paper, Fig. 3).

    Pixels that are not finite read as nothing, others are clipped to the camera's range: an image that got lost on
    the way does no lasting harm to the memory.

    Args:
        shape: rows and columns of the image.
        proprio: P, width of a frame of proprioception, headings blanked.
        terrain_dim: S, width of the terrain latent.
        headings: K, number of headings.
        limit: largest heading, rad.
        config: sizes.

    Raises:
        InterfaceError: the image is too small for the convolutions.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        proprio: int,
        terrain_dim: int,
        headings: int,
        limit: float,
        config: DepthEncoderConfig,
    ) -> None:
        super().__init__()
        self.shape, self.terrain_dim, self.limit, self.memory = shape, terrain_dim, limit, config.memory
        self._contrast = config.contrast
        self.image = _image_network(shape, config)
        fusion: list[nn.Module] = []
        width = config.image_features + proprio
        for size in config.fusion:
            fusion += [nn.Linear(width, size), nn.ELU()]
            width = size
        self.fusion = nn.Sequential(*fusion)
        self.gru = nn.GRUCell(width, config.memory)
        self.head = nn.Linear(config.memory, terrain_dim + headings)

    def features(self, image: Tensor) -> Tensor:
        """Features (B, F) of images (B, rows, columns) from -0.5 (near) to 0.5 (far)."""
        image = torch.where(torch.isnan(image), NOTHING, image).clamp(-NOTHING, NOTHING)
        image = image.unsqueeze(1)
        return self.image(torch.cat((image, contrast(image)), dim=1) if self._contrast else image)

    def recall(self, features: Tensor, frame: Tensor, memory: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Take in what one image shows.

        Args:
            features: (B, F) of the image.
            frame: (B, P) proprioception of the same instant.
            memory: (B, M) after the image before; zeros at the start of an episode.

        Returns:
            Terrain latent (B, S) within +-1, headings (B, K), rad, and memory (B, M).
        """
        fused = self.fusion(torch.cat((features, frame), dim=1))
        memory = self.gru(fused, memory)
        terrain, heading = torch.tanh(self.head(memory)).tensor_split((self.terrain_dim,), dim=1)
        return terrain, self.limit * heading, memory


def _image_network(shape: tuple[int, int], config: DepthEncoderConfig) -> nn.Sequential:
    layers: list[nn.Module] = []
    channels, size = 1 + config.contrast, shape
    for layer in config.convolutions:
        layers += [nn.Conv2d(channels, layer.channels, layer.kernel, layer.stride), nn.ELU()]
        size = tuple(((length - layer.kernel) // layer.stride + 1) // layer.pool for length in size)
        channels = layer.channels
        if layer.pool > 1:
            layers.append(nn.MaxPool2d(layer.pool))
        if min(size) < 1:
            raise InterfaceError(
                f"images of {shape[0]} x {shape[1]} pixels are too small for the convolutions {config.convolutions}"
            )
    rows, columns = size
    layers += [nn.Flatten(), nn.Linear(channels * rows * columns, config.image_hidden), nn.ELU()]
    return nn.Sequential(*layers, nn.Linear(config.image_hidden, config.image_features), nn.ELU())
