"""Scale the legs of a quadruped and feed simulators with thousands of bodies."""

from morphgen.batch import BodyBatch
from morphgen.design import SCALE_NAMES, DesignSpace
from morphgen.errors import MorphologyError
from morphgen.factory import BodyFactory
from morphgen.layout import Layout
from morphgen.model import Drive, flat_scene
from morphgen.robots import go2, load_robot
from morphgen.skeleton import Skeleton
from morphgen.stance import Stance
from morphgen.table2 import scale_urdf

__all__ = [
    "SCALE_NAMES",
    "BodyBatch",
    "BodyFactory",
    "DesignSpace",
    "Drive",
    "Layout",
    "MorphologyError",
    "Skeleton",
    "Stance",
    "flat_scene",
    "go2",
    "load_robot",
    "scale_urdf",
]
