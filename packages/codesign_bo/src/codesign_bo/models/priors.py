"""Priors of the surrogate's hyperparameters; MODEL.md says why these."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from codesign_bo.space import Array


@dataclass(frozen=True)
class Gamma:
    """A gamma distribution of a positive number."""

    shape: float
    rate: float

    def log_density(self, log: Array) -> tuple[Array, Array]:
        """Return the log density of exp(log), and its derivative by `log`; both have the shape of `log`."""
        value = np.exp(log)
        constant = self.shape * np.log(self.rate) - gammaln(self.shape)
        return constant + (self.shape - 1.0) * log - self.rate * value, self.shape - 1.0 - self.rate * value


@dataclass(frozen=True)
class LogNormal:
    """A distribution of a positive number whose logarithm is normal."""

    location: float
    scale: float

    def log_density(self, log: Array) -> tuple[Array, Array]:
        """Return the log density of exp(log), and its derivative by `log`; both have the shape of `log`."""
        z = (log - self.location) / self.scale
        return -0.5 * z**2 - log - np.log(self.scale * np.sqrt(2.0 * np.pi)), -z / self.scale - 1.0


@dataclass(frozen=True)
class Priors:
    """What is believed of the hyperparameters before any observation.

    Attributes:
        lengthscale: Of each length scale, in edges of the unit cube.
        variance: Of the variance of the standardised noise-free objective; None to hold it at 1.
        extra_variance: Of the variance of the noise beyond the known one.
        weight: Standard deviation of the weight of a standardised trend, around 0.
    """

    lengthscale: Gamma | LogNormal = Gamma(3.0, 6.0)
    variance: Gamma | LogNormal | None = None
    extra_variance: Gamma | LogNormal = Gamma(1.1, 30.0)
    weight: float = 1.0


PRIORS = Priors()
