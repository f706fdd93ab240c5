"""From a deposit back to what caused it: unknowns, observations, gradients through the surrogate, optimisers."""

import gns  # noqa: F401  (sets what torch reads when it is loaded, before a module here loads torch)
