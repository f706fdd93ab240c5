"""`docs/speed.md`: the tables, and what has to be said with them."""

from collections.abc import Mapping, Sequence
from datetime import date

from validation.bench.speed import gains, rates
from validation.report.machine import machine
from validation.report.timing import Took

RATES = """\
## Million point-steps a second

2D: the paper's tall column (42°, damped, cohesive), 4 points per cell. 3D: a cube of its 3D sand, 8 points per cell.
Small scenes are timed until the flow is well under way, large ones over its first frames, one sort by cell included
(in use it comes every 20 frames). One scene of fewer than 20,000 points runs on one thread, several on a thread each.
The aims, and half of what vector code written by hand does on as many threads, are for f32 on two cores of an AMD EPYC.
"""

OTHERS = """
Other codes, on two cores of an AMD EPYC, measured before and not in this run (`validation/speed.toml`):
"""

NEEDS = """
## What a scene does not need costs nothing

Seconds of a column with one thing more, over those of the same column with nothing but friction. The thing is
switched on with a value too small to change the flow, so that only its cost is seen.
"""

GRID = """
The whole grid is made active by one cell of material in the far upper corner.

## Shortcuts

Seconds over those of the scene as it ships (its full time, step 0.9 of the stability limit), and what becomes of the
front. Ending at rest is on request (`until_rest`): below a thousandth of the greatest kinetic energy.
"""

WHY = """\
## What makes it fast

Scalar code for the same equations did 16 to 18 million point-steps a second and core in 2D. What was added:

- **Vectors of lanes** (`mpm/arrays/access.py`). Points live in blocks as wide as a vector register, 16 in f32 and 8 in f64. All
  that belongs to a point (stress, return mapping, weights, motion) is computed for a block at once, without branches;
  Taichi is told to leave its vectors whole (`real_matrix_scalarize=False`), so LLVM sees vector values and uses the
  registers.
- **Nodes as short vectors** (`mpm/physics/transfer.py`). Where point meets node, a node (momentum, mass, force) is one vector
  of four or eight numbers. What a point gives is linear in the node's place: a value at the lowest node and one slope
  per axis. What it takes is summed along the innermost axis first, because those nodes share the other weights.
- **Bounded indices** (`mpm/arrays/access.py`). Taichi counts in 32 bits, and each sum of an index and a constant would be
  extended anew; cut to 30 bits, which changes none, it becomes part of an address.
- **No atomics, few launches** (`mpm/kernel.py`). A small scene runs on one thread, many small ones side by side; a
  large one has a grid per thread, summed where they overlap. Up to 20 frames with all their steps are one launch.
- **Points in the order of their cells** from 50,000 on, sorted anew at every launch.
- **Nothing that a scene does not need**: the kernel is compiled for what the scenes of a batch need, and only the
  bounding box of the material is cleared and updated. The tables above say what that is worth.
"""


def page(
    speeds: Mapping[tuple[rates.Case, rates.Way], Sequence[Took]],
    needs: gains.Measured,
    shortcuts: Mapping[tuple[str, str], Sequence[Took]],
    *,
    rounds: int,
    training: str = "",
) -> str:
    """The page, from what was measured in `rounds` rounds; `training` is a section of its own."""
    parts: list[str | list[str]] = [
        "# The speed of the MPM\n",
        f"`python -m validation.bench.speed.bench mpm --rounds {rounds}`, {date.today().isoformat()}, on",
        f"{machine()}.",
        f"Medians of rounds (here {rounds}) in which all are measured in turn, in brackets the least and the greatest.",
        "Compilation is apart: 0.5 to 3 s the first time, cached on disk from then on.\n",
        RATES,
        rates.rates_table(speeds),
        OTHERS,
        rates.others_table(),
        NEEDS,
        gains.needs_table(needs),
        GRID,
        gains.shortcuts_table(shortcuts),
        "",
        *([training] if training else []),
        WHY,
    ]
    return "\n".join("\n".join(part) if isinstance(part, list) else part for part in parts)
