import sys
from pathlib import Path

import numpy as np
import pytest
from lxml import etree
from morphgen import BodyFactory, go2
from morphgen.robots import GO2
from morphgen.robots.description import build_urdf

sys.path.insert(0, str(Path(__file__).parent))  # importlib mode does not

CORNERS = np.array(np.meshgrid(*[(0.6, 1.4)] * 4, indexing="ij")).reshape(4, -1).T


@pytest.fixture(scope="session")
def factory() -> BodyFactory:
    return go2()


@pytest.fixture(scope="session")
def designs() -> np.ndarray:
    """Nominal, the 16 corners of the box and 23 random designs."""
    random = np.random.default_rng(7).uniform(0.6, 1.4, (23, 4))
    return np.vstack([np.ones(4), CORNERS, random])


@pytest.fixture
def go2_tree():
    """A fresh, editable element tree of the built-in Go2."""
    return etree.fromstring(build_urdf(GO2).encode())


@pytest.fixture
def as_text():
    return lambda tree: etree.tostring(tree, encoding="unicode")
