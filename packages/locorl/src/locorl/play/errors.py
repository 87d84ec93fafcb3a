"""What `locorl play` cannot do here."""


class PlayError(RuntimeError):
    """A package or a library that playing needs is missing; the message says how to get it."""


def missing_extra(error: ModuleNotFoundError) -> PlayError:
    """What to say when a package of the extra `play` is not installed."""
    return PlayError(f"this needs {error.name}: pip install 'legged-locorl[play]'")
