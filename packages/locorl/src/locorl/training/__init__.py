"""Training runs: from scratch and from a generalist, with metrics, checkpoints and resume."""
