"""Measured experiments, forward and backward."""
