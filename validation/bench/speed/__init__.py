"""Seconds and memory of the MPM and of the surrogate."""
