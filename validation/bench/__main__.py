"""`python -m validation.bench NAME --out DIR`: measure, write the page, print its conclusion."""

import sys
from collections.abc import Sequence

from datasets.command_line import run

PAGES = {
    "experiments": ("validation.bench.experiments:bench", "measured experiments, forward and backward"),
    "accuracy": ("validation.bench.accuracy.bench:bench", "error over seconds of the MPM, whether --tolerance holds"),
    "stability": ("validation.bench.stability.bench:bench", "hard cases, exact solutions and stiffness of the MPM"),
    "problems": ("validation.bench.problems:bench", "the shipped inverse problems beside the reference paper"),
    "coverage": ("validation.bench.coverage:bench", "how often the posterior contains the truth, in twin experiments"),
    "speed": ("validation.bench.speed:bench", "rates of MPM and network, baffles, a gradient, a large terrain"),
    "gpu": ("validation.bench.speed:gpu", "rates of MPM and network on a GPU, beside all processors"),
    "mountain": ("validation.bench.mountain:bench", "slides of kilometres beside other codes (data: ISeeSnow)"),
    "gns": ("validation.bench.gns:bench", "the shipped surrogates beside the MPM: error, price, bands, rest"),
}
"""Pages that can be measured: where each is, and what it shows."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the page that is named, and return the exit status."""
    return run(PAGES, "python -m validation.bench", arguments)


if __name__ == "__main__":
    sys.exit(main())
