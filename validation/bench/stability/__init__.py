"""Scenes that break other solvers, each with its requirements: `python -m validation.bench stability`."""
