"""Errors that users meet; each message names the cause and the way out."""


class DistillError(RuntimeError):
    """Base class of the errors raised by distill."""


class InterfaceError(DistillError):
    """An environment or teacher does not keep its contract (`distill.interfaces`)."""


class CheckpointError(DistillError):
    """A checkpoint is unreadable, or belongs to another run."""


class TrainingDiverged(DistillError):
    """A loss or an observation stopped being finite; the last checkpoint is kept."""


class BundleError(DistillError):
    """A bundle is incomplete, altered, or does not reproduce its golden trace."""


class ProviderError(DistillError):
    """No installed package provides the named environment or teacher."""
