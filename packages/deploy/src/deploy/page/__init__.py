"""Figures of runs and a page for a log; needs the extra `plot`."""

from importlib.util import find_spec

from deploy.errors import DeployError

if find_spec("matplotlib") is None:
    raise DeployError("matplotlib is missing: pip install 'legged-deploy[plot]'")
