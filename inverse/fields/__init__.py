"""Unknown fields: their search with the MPM's adjoint, optionally led by a surrogate, and their posterior."""
