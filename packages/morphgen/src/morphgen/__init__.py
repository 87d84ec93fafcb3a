"""Scale the legs of a quadruped and feed simulators with thousands of bodies."""

from morphgen.errors import MorphologyError
from morphgen.factory import BodyFactory
from morphgen.robots import go2, load_robot
from morphgen.scaling.design import SCALE_NAMES, DesignSpace
from morphgen.scaling.table2 import scale_urdf
from morphgen.simulation.batch import BodyBatch
from morphgen.simulation.layout import Layout
from morphgen.simulation.mjcf import to_mjcf
from morphgen.simulation.model import Drive, flat_scene
from morphgen.stance.skeleton import Skeleton
from morphgen.stance.solve import Stance
from morphgen.views.dimensions import dimensions
from morphgen.views.drawing import draw_bodies

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
