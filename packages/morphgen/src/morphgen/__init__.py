"""Scale the legs of a quadruped and feed simulators with thousands of bodies."""

from morphgen.batch import BodyBatch
from morphgen.design import SCALE_NAMES, DesignSpace
from morphgen.dimensions import dimensions
from morphgen.drawing import draw_bodies
from morphgen.errors import MorphologyError
from morphgen.factory import BodyFactory
from morphgen.layout import Layout
from morphgen.mjcf import to_mjcf
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
    "dimensions",
    "draw_bodies",
    "flat_scene",
    "go2",
    "load_robot",
    "scale_urdf",
    "to_mjcf",
]
