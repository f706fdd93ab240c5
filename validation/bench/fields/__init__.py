"""Unknown fields of friction and velocity, found from profiles by the adjoint, in twin experiments."""
