"""Flows: trajectories in memory and on disk, their fields and measures."""
