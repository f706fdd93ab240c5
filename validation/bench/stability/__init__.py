"""Scenes that break other solvers, each with what has to hold in it: `python -m validation.bench stability`."""
