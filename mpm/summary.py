"""What a run came to and what it cost, as plain numbers for `summary.json`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.measures import front, runout, toe
from mpm.layout import Energy
from mpm.runtime import Precision


def summarise(
    deposit: NDArray[np.float32],
    *,
    energy: NDArray[np.float64],
    steps: int,
    clamped: int,
    wall_s: float,
    compile_s: float,
    precision: Precision,
) -> dict[str, Any]:
    """Summary of a run that ended in `deposit` [m], shape [N, D]; `energy` [J/m], shape [T, len(Energy)].

    Lengths in metres; `energy` is a series per frame; `clamped` counts how often a point was put back into the box;
    `wall_s` is the batch's, compilation apart.
    """
    return {
        "runout": runout(deposit),
        "front": front(deposit),
        "toe": list(toe(deposit)),
        "steps": steps,
        "particles": len(deposit),
        "clamped": clamped,
        "energy": {column.name.lower(): [float(f"{e:.6g}") for e in energy[:, column]] for column in Energy},
        "wall_s": wall_s,
        "compile_s": compile_s,
        "arch": "cpu",
        "precision": precision,
    }
