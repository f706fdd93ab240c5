"""What `python -m validation.bench.speed.bench gns` measures: steps beside the textbook's, and the tall column's whole second."""

import time
from pathlib import Path

import torch

from datasets.files import write_text
from validation.bench.speed.gns_page import PICTURE, draw, page
from validation.bench.speed.gns_rates import families, measured
from validation.bench.speed.whole_second import seconds

LONGEST = 5.0
"""A step of the textbook's that would take longer [s] is left out unless told otherwise."""


def measure(out: Path, *, rounds: int, longest: float, threads: int) -> str:
    """Measure everything, leave OUT/speed-gns.md and its picture, and return the former."""
    begin = time.perf_counter()
    torch.set_num_threads(threads)
    torch.manual_seed(0)
    several = families()
    costs = measured(several, rounds, longest)
    text = page(several, costs, seconds(several, rounds), rounds=rounds, longest=longest)
    text += f"All of this took {time.perf_counter() - begin:.0f} s.\n"
    draw(out / PICTURE, several, costs)
    write_text(out / "speed-gns.md", text)
    return text
