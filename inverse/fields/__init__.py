"""Unknown fields: their search by the MPM's adjoint, led by a surrogate where one is asked, and their posterior."""
