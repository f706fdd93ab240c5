"""The MPM's own adjoint: the price of a gradient over that of a run, and its agreement with central differences."""
