"""Scale the legs of any quadruped and feed simulators with thousands of bodies."""

from morphgen.errors import MorphologyError
from morphgen.factory import BodyFactory, scale_urdf
from morphgen.inspection.findings import Inspection
from morphgen.inspection.inspect import inspect
from morphgen.robots import from_urdf, go2, lite3, load_robot
from morphgen.scaling.bodies import RULES, Rule
from morphgen.scaling.design import PARAMETERS, SCALE_NAMES, DesignSpace
from morphgen.simulation.batch import BodyBatch
from morphgen.simulation.drive import Drive
from morphgen.simulation.layout import Layout
from morphgen.simulation.mjcf import to_mjcf
from morphgen.simulation.model import flat_scene
from morphgen.skeleton import Skeleton
from morphgen.stance.gains import GainRule
from morphgen.stance.stance import Stance
from morphgen.views.dimensions import dimensions
from morphgen.views.drawing import draw_bodies

__all__ = [
    "PARAMETERS",
    "RULES",
    "SCALE_NAMES",
    "BodyBatch",
    "BodyFactory",
    "DesignSpace",
    "Drive",
    "GainRule",
    "Inspection",
    "Layout",
    "MorphologyError",
    "Rule",
    "Skeleton",
    "Stance",
    "dimensions",
    "draw_bodies",
    "flat_scene",
    "from_urdf",
    "go2",
    "inspect",
    "lite3",
    "load_robot",
    "scale_urdf",
    "to_mjcf",
]
