"""The graph network simulator: a differentiable stand-in for the MPM that learned from its trajectories."""

import os

# Huge pages for large tensors: page faults dominate otherwise (2.5 times the time of a step). Must precede torch.
os.environ.setdefault("THP_MEM_ALLOC_ENABLE", "1")
