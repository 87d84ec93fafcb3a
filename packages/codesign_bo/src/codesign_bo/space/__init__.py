"""What is searched: kinds of parameters, linear constraints, the space they make, and points spread over it."""

from codesign_bo.space.box import BoxSpace
from codesign_bo.space.constraints import LinearConstraint
from codesign_bo.space.parameters import AnyParameter, Categorical, Continuous, Integer, Parameter
from codesign_bo.space.sampling import Feasible, is_feasible, sobol_designs, sobol_points
from codesign_bo.space.signature import ParameterSignature, SignatureEntry
from codesign_bo.space.values import Array, Value

__all__ = [
    "AnyParameter",
    "Array",
    "BoxSpace",
    "Categorical",
    "Continuous",
    "Feasible",
    "Integer",
    "LinearConstraint",
    "Parameter",
    "ParameterSignature",
    "SignatureEntry",
    "Value",
    "is_feasible",
    "sobol_designs",
    "sobol_points",
]
