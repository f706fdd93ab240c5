"""What a run came to and what it cost, as plain numbers for `summary.json`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.measures import front, runout, toe
from datasets.scene import SIDES
from mpm.arrays.layout import Energy, Precision
from mpm.runtime import Arch


def summarise(
    deposit: NDArray[np.float32],
    *,
    energy: NDArray[np.float64],
    steps: int,
    clamped: int,
    rest_time: float | None,
    end_time: float,
    relaxation_time: float,
    release_time: list[float | None] | None,
    wall_impulse: NDArray[np.float64] | None,
    outflow: dict[str, float] | None,
    wall_s: float,
    compile_s: float,
    arch: Arch,
    precision: Precision,
) -> dict[str, Any]:
    """Summary of a run that ended in `deposit` [m], shape [N, D]; `energy` [J/m], shape [T, len(Energy)].

    Lengths in metres; `energy` is a series with a value at every frame of the scene; `clamped` counts how often a
    particle was put back into the box; `rest_time` [s] is when the deposit came to rest, where the run may end there,
    and `end_time` [s] until when it was computed; `release_time` [s] when each mass was let go, where gates hold one;
    `relaxation_time` [s] that of the scene, its default worked out; `wall_impulse` [N s] the momentum that the sides of
    the box and the gates have taken up to each frame, shape [T, 2 D + 1, D], where asked for: their sum and, as
    `side_impulse`, each; `outflow` [kg] what left through each open side; `wall_s` is that of all scenes that ran
    together, compilation apart.
    """
    summary = {
        "runout": runout(deposit),
        "front": front(deposit),
        "toe": list(toe(deposit)),
        "steps": steps,
        "particles": len(deposit),
        "clamped": clamped,
        "rest_time": rest_time,
        "end_time": end_time,
        "relaxation_time": relaxation_time,
        "energy": {
            column.name.lower(): [float(f"{e:.6g}") for e in energy[:, column]]
            for column in (Energy.KINETIC, Energy.POTENTIAL, Energy.ELASTIC)
        },
        "wall_s": wall_s,
        "compile_s": compile_s,
        "arch": arch,
        "precision": precision,
    }
    if release_time is not None:
        summary["release_time"] = release_time
    if wall_impulse is not None:
        summary["wall_impulse"] = rounded(wall_impulse.sum(axis=1))
        sides = SIDES[: 2 * deposit.shape[1]]
        summary["side_impulse"] = {side: rounded(wall_impulse[:, number]) for number, side in enumerate(sides)}
    if outflow is not None:
        summary["outflow"] = outflow
    return summary


def rounded(series: NDArray[np.float64]) -> list[list[float]]:
    """A series of vectors, shape [T, D], with six digits."""
    return [[float(f"{p:.6g}") for p in row] for row in series]
