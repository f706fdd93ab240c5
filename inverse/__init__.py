"""From a deposit back to what caused it: unknowns, observations, gradients through the surrogate, optimisers."""
