"""What a run came to and what it cost, as plain numbers for `summary.json`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.measures import front, runout, toe
from mpm.layout import Energy, Precision
from mpm.runtime import Arch


def summarise(
    deposit: NDArray[np.float32],
    *,
    energy: NDArray[np.float64],
    steps: int,
    clamped: int,
    rest_time: float | None,
    release_time: list[float | None] | None,
    wall_impulse: NDArray[np.float64] | None,
    wall_s: float,
    compile_s: float,
    arch: Arch,
    precision: Precision,
) -> dict[str, Any]:
    """Summary of a run that ended in `deposit` [m], shape [N, D]; `energy` [J/m], shape [T, len(Energy)].

    Lengths in metres; `energy` is a series per frame; `clamped` counts how often a particle was put back into the box;
    `rest_time` [s] is when the deposit came to rest, where the run was to end there; `release_time` [s]
    when each mass was let go, where gates hold one; `wall_impulse` [N s] the momentum
    that floor and walls have taken up to each frame, where fields are recorded; `wall_s` is the batch's, compilation
    apart.
    """
    summary = {
        "runout": runout(deposit),
        "front": front(deposit),
        "toe": list(toe(deposit)),
        "steps": steps,
        "particles": len(deposit),
        "clamped": clamped,
        "rest_time": rest_time,
        "energy": {column.name.lower(): [float(f"{e:.6g}") for e in energy[:, column]] for column in Energy},
        "wall_s": wall_s,
        "compile_s": compile_s,
        "arch": arch,
        "precision": precision,
    }
    if release_time is not None:
        summary["release_time"] = release_time
    if wall_impulse is not None:
        summary["wall_impulse"] = [[float(f"{p:.6g}") for p in row] for row in wall_impulse]
    return summary
