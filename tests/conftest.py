"""All tests: one thread per process for torch and BLAS, so that workers side by side do not wait for each other."""

import os

# Before torch and NumPy are imported: they read these once.
for variable in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
