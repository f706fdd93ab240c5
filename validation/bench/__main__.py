"""`python -m validation.bench NAME --out DIR`: measure, write the page, print its conclusion."""

import sys
from collections.abc import Sequence

from datasets.command_line import run

PAGES = {
    "experiments": ("validation.bench.experiments:bench", "measured experiments, forward and backward"),
    "accuracy": ("validation.bench.accuracy.bench:bench", "error over seconds of the MPM, whether --tolerance holds"),
    "stability": ("validation.bench.stability.bench:bench", "hard cases, exact solutions and stiffness of the MPM"),
    "problems": ("validation.bench.problems:bench", "the shipped inverse problems compared with the reference paper"),
    "coverage": ("validation.bench.coverage:bench", "how often the posterior contains the truth, in twin experiments"),
    "speed": ("validation.bench.speed:bench", "rates of MPM and network, baffles, a gradient, a large terrain"),
    "gpu": ("validation.bench.speed:gpu", "rates of MPM and network on a GPU, compared with all processors"),
    "mountain": ("validation.bench.mountain:bench", "kilometre-long slides compared with other codes (data: ISeeSnow)"),
    "gns": ("validation.bench.gns:bench", "the shipped surrogates compared with the MPM: error, cost, bands, rest"),
}
"""Name of a page -> its function and its content."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the named page, and return the exit status."""
    return run(PAGES, "python -m validation.bench", arguments)


if __name__ == "__main__":
    sys.exit(main())
