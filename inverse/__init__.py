"""Inverse analysis: from where a flow came to rest to the parameters that put it there.

    from inverse import invert, read_problem

    result = invert(read_problem("friction-tall-42"))
    print(result.unknowns)  # {'friction_deg': 41.59}; the truth of this twin experiment is 42 degrees

A problem is a TOML file (docs/formats.md) or a `Problem` built in Python.
"""

import gns  # noqa: F401  (sets what torch reads when it is loaded, before a module here loads torch)
from inverse.inversion import invert
from inverse.problem import Problem, read_problem
from inverse.result import Result
from inverse.settings import ObservationSettings, Parameter, TargetSettings

__all__ = ["ObservationSettings", "Parameter", "Problem", "Result", "TargetSettings", "invert", "read_problem"]
