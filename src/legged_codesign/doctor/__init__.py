"""Is this machine fit for a run? Findings in words, each with its way out."""

from legged_codesign.doctor.examine import Probes, examine
from legged_codesign.doctor.finding import Finding

__all__ = ["Finding", "Probes", "examine"]
