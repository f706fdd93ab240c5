"""Unknown fields: friction or velocity at hundreds of nodes over a body, from what the flow left.

>>> from inverse.fields import invert, read_problem
>>> result = invert(read_problem("slope-friction"), out="out/fields")
>>> result.fields[0].mean, result.fields[0].removed  # at the nodes; share of the prior's variance that was removed

    problem     scene, fields with their priors, observations: `inverse/fields/problems`
    prior       a Gaussian field by a sparse operator; `unknown`: its nodes, its bounds
    flow        runs of the MPM at fields; the Jacobian by the adjoint
    search      the most probable fields by Gauss-Newton
    posterior   what the observation tells of each value
"""

from inverse.fields.inversion import invert
from inverse.fields.problem import FieldProblem, read_problem

__all__ = ["FieldProblem", "invert", "read_problem"]
