"""The loop: runs of the MPM narrow the posterior, confirm its answers, and give the verdict."""
