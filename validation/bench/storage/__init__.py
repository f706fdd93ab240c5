"""What trajectories take on disk and in memory."""
