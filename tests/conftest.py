"""All tests: one thread a process for torch and BLAS, few examples of each property, and what stays on one worker."""

import os
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

# Before torch and NumPy are imported: they read these once.
for variable in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

# The same examples every time, few enough for every run, none of them kept on disk.
settings.register_profile(
    "fast",
    max_examples=30,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
settings.load_profile("fast")

SHARED = {
    "tests/inverse/forward/": "adjoint",
    "tests/mpm/adjoint/": "adjoint",
    "tests/mpm/": "mpm",
    "tests/inverse/test_command.py": "inversions",
    "tests/inverse/test_fields.py": "inversions",
}
"""Where tests share kernels, and what these are called together."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """A worker gets all tests of a file, or all that share kernels: each worker compiles its own."""
    from xdist.scheduler import LoadFileScheduling

    class Scheduling(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            shared = next((name for place, name in SHARED.items() if nodeid.startswith(place)), None)
            return shared or super()._split_scope(nodeid)

    return Scheduling(config, log)
