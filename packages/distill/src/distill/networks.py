"""Building blocks that several students share."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor, nn


class HistoryEncoder(nn.Module):
    """Features of a window of frames: (B, H, P) -> (B, F).

    A linear layer per frame, then convolutions over time, after Kumar et al. (RMA).

    Args:
        proprio: P, width of a frame.
        history: H, frames in the window.
        frame_features: width of the linear layer applied to each frame.
        channels: of the convolutions over time.
        features: F.
    """

    kernels = (4, 3)
    stride = 2

    def __init__(self, proprio: int, history: int, frame_features: int, channels: Sequence[int], features: int) -> None:
        super().__init__()
        self.frame = nn.Sequential(nn.Linear(proprio, frame_features), nn.ELU())
        layers: list[nn.Module] = []
        inputs, length = frame_features, history
        for index, width in enumerate(channels):
            kernel = min(self.kernels[min(index, len(self.kernels) - 1)], length)
            # Padded at the old end, so that the stride never leaves out the newest frames.
            padding = -(length - kernel) % self.stride
            layers += [nn.ConstantPad1d((padding, 0), 0.0), nn.Conv1d(inputs, width, kernel, self.stride), nn.ELU()]
            inputs, length = width, (length + padding - kernel) // self.stride + 1
        self.time = nn.Sequential(*layers)
        self.features = nn.Sequential(nn.Linear(inputs * length, features), nn.ELU())

    def forward(self, history: Tensor) -> Tensor:
        """Encode `history` (B, H, P), oldest first."""
        return self.features(self.time(self.frame(history).transpose(1, 2)).flatten(1))


def mlp(inputs: int, hidden: Sequence[int], outputs: int) -> nn.Sequential:
    """A fully connected network with ELU between its layers."""
    layers: list[nn.Module] = []
    for width in hidden:
        layers += [nn.Linear(inputs, width), nn.ELU()]
        inputs = width
    return nn.Sequential(*layers, nn.Linear(inputs, outputs))
