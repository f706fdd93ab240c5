"""The confirmed inversion: the surrogate proposes, the MPM confirms or corrects, and a verdict ends it."""
