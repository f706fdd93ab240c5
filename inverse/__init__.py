"""Inverse analysis: from the deposit of a flow to the parameters that caused it.

    from inverse import invert, read_problem

    result = invert(read_problem("friction-tall-42"))
    print(result.unknowns, result.interval)  # from the surrogate alone; the truth of this twin experiment is 42 degrees

A problem is a TOML file (docs/formats.md) or a `Problem` built in Python; its unknowns are numbers or fields.
"""

from typing import TYPE_CHECKING

import gns  # noqa: F401  (sets what torch reads when it is loaded, before a module here loads torch)
from datasets import lazily

if TYPE_CHECKING:
    from inverse.adaptation import adapt as adapt
    from inverse.inversion import invert as invert
    from inverse.parameters import Parameter as Parameter
    from inverse.parameters.prior import Correlation as Correlation
    from inverse.parameters.prior import Prior as Prior
    from inverse.pictures import plot as plot
    from inverse.problem import Problem as Problem
    from inverse.problem import read_problem as read_problem
    from inverse.result import Result as Result
    from inverse.saving import save as save
    from inverse.settings import TargetSettings as TargetSettings

_MODULES = {
    "Correlation": "inverse.parameters.prior",
    "Parameter": "inverse.parameters",
    "Prior": "inverse.parameters.prior",
    "Problem": "inverse.problem",
    "Result": "inverse.result",
    "TargetSettings": "inverse.settings",
    "adapt": "inverse.adaptation",
    "invert": "inverse.inversion",
    "plot": "inverse.pictures",
    "read_problem": "inverse.problem",
    "save": "inverse.saving",
}

__all__ = [*_MODULES]

__getattr__, __dir__ = lazily("inverse", _MODULES)
