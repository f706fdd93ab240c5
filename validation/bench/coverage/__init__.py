"""Simulation-based calibration of the posterior: `python -m validation.bench coverage`."""
