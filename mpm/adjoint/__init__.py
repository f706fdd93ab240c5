"""mpm.adjoint"""
