"""Trajectories as training data: samples of a dataset, their statistics, what its metadata says."""
