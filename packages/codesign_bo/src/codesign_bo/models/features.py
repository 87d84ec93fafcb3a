"""What models see of a point of the unit cube, in torch and differentiable."""

from __future__ import annotations

import numpy as np
import torch

from codesign_bo.space import BoxSpace, Continuous


class Features:
    """Maps points (..., dim) of a space's unit cube to `BoxSpace.features` (..., f).

    Gradients pass through continuous coordinates; along integers and categoricals the features are constant
    but for steps.

    Args:
        space: The space.
    """

    def __init__(self, space: BoxSpace) -> None:
        self.space = space
        slices = space.feature_slices
        self.groups = [i for i, columns in enumerate(slices) for _ in range(columns.start, columns.stop)]
        """To which unit coordinate each feature belongs."""
        self.continuous = np.array([isinstance(p, Continuous) for p in space.free])
        """Which unit coordinates are continuous (dim,)."""
        smooth = np.flatnonzero(self.continuous)
        self._to = torch.as_tensor([slices[i].start for i in smooth], dtype=torch.long)
        self._from = torch.as_tensor(smooth)

    def __call__(self, points: torch.Tensor) -> torch.Tensor:
        """Return the features of points (..., dim)."""
        if self.continuous.all():
            return points
        flat = self.space.features(points.detach().reshape(-1, points.shape[-1]).numpy())
        fixed = torch.as_tensor(flat).reshape(*points.shape[:-1], -1)
        return fixed.index_copy(-1, self._to, points.index_select(-1, self._from))
