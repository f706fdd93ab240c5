"""The ground truth: explicit MLS-MPM of Mohr-Coulomb sand, in Taichi."""

import os

# Commands of Talus print what they found, not which libraries they found it with.
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
