"""The graph network simulator: a differentiable surrogate of the MPM, learned from its trajectories.

simulator = gns.load("flow2d")
trajectory = gns.simulate("column-tall-42", model=simulator)
prediction = gns.predict("column-tall-42")  # with its band
"""

import os
from typing import TYPE_CHECKING

from datasets import lazily

# Torch reads both when it is loaded, so they must precede it.
# Huge pages for large tensors: page faults dominate otherwise (2.5 times the time of a step).
os.environ.setdefault("THP_MEM_ALLOC_ENABLE", "1")
# One thread: on a thousand particles a second thread gains a fifth if its core is free. If the core was busy, a step
# took 200 times longer, because threads spin at their barriers.
os.environ.setdefault("OMP_NUM_THREADS", "1")

if TYPE_CHECKING:
    from gns.inference import load, predict, simulate

__all__ = ["load", "predict", "simulate"]

__getattr__, __dir__ = lazily("gns", dict.fromkeys(__all__, "gns.inference"))
