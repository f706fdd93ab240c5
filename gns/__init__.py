"""The graph network simulator: a differentiable stand-in for the MPM that learned from its trajectories."""

import os

# Torch reads both when it is loaded, so they must precede it.
# Huge pages for large tensors: page faults dominate otherwise (2.5 times the time of a step).
os.environ.setdefault("THP_MEM_ALLOC_ENABLE", "1")
# Threads that wait at a barrier sleep instead of spinning: beside another busy process a step took 200 times longer.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
