"""The expected information of a further measurement.

    I = 1/2 ln(1 + var m(v) / (s^2 + d^2))

with m(v) the measurement's result over the samples of the posterior, s its scatter from flow to flow and d its reading
error: the expected gain in Shannon information of a Gaussian (Lindley, On a measure of the information
provided by an experiment, Ann. Math. Statist. 27 (1956) 986-1005). A factor of two in one interval is 0.69.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from datasets.flow import measures
from datasets.scene import Scene
from datasets.scene.particles import particle_volumes
from inverse.posterior import Matrix
from inverse.posterior.emulator import fitted
from inverse.posterior.sampling import Samples

STATIONS = 9  # places along x at which a height could be measured
ACROSS = 4  # places along z, in 3D
READING = 0.25  # error of reading a length, in cells


def measurements(scene: Scene, deposit: NDArray[np.floating], extent: float) -> dict[str, float]:
    """Possible measurements of a deposit of positions [m], shape [N, D]; extent: of the stations along x [m]."""
    toe, volumes = measures.toe(deposit), particle_volumes(scene, len(deposit))
    measured = {"the front": measures.front(deposit, volumes)}
    measured |= {f"{axis} of the toe": float(value) for axis, value in zip("xyz", toe, strict=False) if axis != "y"}
    edges = [np.linspace(0.0, extent, STATIONS + 1)]
    edges += [np.linspace(0.0, width, ACROSS + 1) for width in scene.domain.size[2:]]
    plan = deposit[:, [0, 2][: len(edges)]]
    area = np.prod([borders[1] - borders[0] for borders in edges])
    heights = np.histogramdd(plan, bins=edges, weights=volumes)[0] / area
    for index in np.ndindex(heights.shape):
        middles = (0.5 * (borders[number] + borders[number + 1]) for borders, number in zip(edges, index, strict=True))
        location = ", ".join(f"{axis} = {middle:.3g} m" for axis, middle in zip("xz", middles, strict=False))
        measured[f"the height around {location}"] = float(heights[index])
    return measured


def information(
    points: Matrix, shown: Mapping[str, Matrix], samples: Samples, *, cell: float, rng: np.random.Generator
) -> dict[str, float]:
    """I [nat] of each measurement, largest first; shown: name -> results [n] of runs at points [n, U]; cell: [m]."""
    where, gains = samples.drawn(400, rng), {}
    for name, numbers in shown.items():
        spread = float(numbers.std())
        if spread <= 1e-3 * cell:
            continue
        made = fitted(points, numbers[:, None] / spread, np.array([0.1]))
        varied = spread**2 * float(made.mean(where).var())
        noise = spread**2 * float(made.scatter[0, 0]) + (READING * cell) ** 2
        gains[name] = 0.5 * float(np.log1p(varied / noise))
    return dict(sorted(gains.items(), key=lambda item: -item[1]))
