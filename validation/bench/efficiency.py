"""`python -m validation.bench efficiency`: what a gradient costs by surrogate, adjoint and differences.

The paper's column of ten layers is cut into 1 to 100 blocks of unknown velocity. Gradients are compared with the
MPM's differences averaged over `JITTERS` seeds: along the path of one run the adjoint has its corners, which the mean
over runs has not. So has that of two baffles in 3D.
"""

import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

import gns
from datasets.processes import processors
from datasets.scene import Mass
from datasets.scene.library import read_scene
from gns.simulator import Simulator
from inverse.forward import Forward
from inverse.forward.adjoint import AdjointForward
from inverse.forward.gns import GnsForward
from inverse.forward.mpm import MpmForward
from inverse.observations import DepositSettings, Values
from inverse.parameters import Parameter, Vector
from inverse.problem import Problem, read_problem
from inverse.settings import TargetSettings
from inverse.target import read_target
from mpm import simulate, simulate_many
from validation.bench.measuring import Found
from validation.bench.page import Out, formatted, write_page

SCENE = "layers-10"
CUTS = ((1, 1), (1, 10), (10, 10))
"""Blocks along x and along y."""
AT_FLOOR, AT_TOP = 1.5, 0.15
"""True velocities [m/s], about the paper's; a block has that of its middle."""
FRACTION = 0.5
"""Of the true velocities: where the gradient is evaluated."""
STEP = 0.05
"""Of the differences of blocks [m/s]. At 0.5 m/s those of a hundred, which move at 0.08 to 0.75, are of another slope:
the cosine of the adjoint to differences of 0.5 / 0.15 / 0.05 m/s is 0.88 / 0.97 / 0.99."""
MOST_COLUMNS = 10
"""Unknowns whose differences are run; the seconds of more are multiplied."""
BLOCKS, BAFFLES = "blocks", "baffles-2"
BAFFLE_STEP = 0.02
"""Step of the differences of two baffles [m]."""
JITTERS, BAFFLE_JITTERS = 4, 12
"""Jitter seeds over which gradients of the MPM are averaged: by the place of a baffle one adjoint scatters by half."""
SURROGATE, ADJOINT, DIFFERENCES = "surrogate", "adjoint of the MPM", "differences of the MPM"
"""Methods; that of the surrogate is the reverse mode through its rollout."""
SCATTER = "scatter of one jitter"
GRADIENT = {"unknowns": ",", "seconds": ".2f", "cosine": ".3f", "length": ".2f", SCATTER: ".2f"}
"""Forms of the columns. Cosine and length are those of the gradient's mean over the jitters to that of the MPM's
differences, over the unknowns of which these were run; the scatter is rms over the length of the mean."""
Slope = tuple[float, Vector]
"""Seconds of a gradient, and the gradient of the loss, the mean of the squared distances of what is compared."""


def by_runs(forward: Forward, target: Values, components: int, at: Vector, moves: NDArray[np.float64]) -> Slope:
    """Along each of `moves` [k, U] by central differences, shape [k]."""
    began = time.perf_counter()
    first, *rows = forward.observe([at, *(at + moves), *(at - moves)])
    seconds, residual = time.perf_counter() - began, first - target
    ahead, behind = np.split(np.reshape(rows, (2 * len(moves), len(first))).T.copy(), 2, axis=1)
    jacobian = (ahead - behind) / (2.0 * np.linalg.norm(moves, axis=1))
    return seconds, 2.0 * components * residual @ jacobian / len(residual)


def blocks(columns: int, layers: int) -> Problem:
    """The velocities of the layers' sand in so many blocks from its deposit; it starts at `FRACTION` of the true ones.

    However it is cut, its particles are the same: no cut goes through a particle's share of a cell.
    """
    whole = read_scene(SCENE)
    spacing = whole.particle_spacing
    across = round(whole.masses[0].size[0] / spacing)
    up = round(max(mass.lower[1] + mass.size[1] for mass in whole.masses) / spacing)
    x, y = (np.round(np.linspace(0, count, parts + 1)) for count, parts in ((across, columns), (up, layers)))
    boxes = [*product(pairwise(y), pairwise(x))]
    speeds = [AT_FLOOR + (AT_TOP - AT_FLOOR) * float((low + high) / 2.0 / up) for (low, high), _ in boxes]
    masses = tuple(
        Mass(
            lower=(float(left * spacing), float(low * spacing)),
            size=(float((right - left) * spacing), float((high - low) * spacing)),
            velocity=(speed, 0.0),
        )
        for speed, ((low, high), (left, right)) in zip(speeds, boxes, strict=True)
    )
    return Problem(
        name=f"blocks-{len(masses)}",
        scene=replace(whole, masses=masses),
        parameters=tuple(
            Parameter(name=f"masses[{index}].velocity_x", initial=FRACTION * speed, lower=-3.0, upper=3.0)
            for index, speed in enumerate(speeds)
        ),
        observations=(DepositSettings(),),
        target=TargetSettings(twin=True),
    )


def bench(*, out: Out) -> str:
    """Gradients over the number of unknowns by every method; some minutes."""
    torch.set_num_threads(processors())
    simulator = gns.load("flow2d")
    gradients = [
        each
        for cut in tqdm(CUTS, desc="gradients", unit="cut")
        for each in gradients_of(BLOCKS, blocks(*cut), STEP, simulator, JITTERS)
    ]
    network = gns.load("obstacle3d")
    gradients += gradients_of(BAFFLES, read_problem(BAFFLES), BAFFLE_STEP, network, BAFFLE_JITTERS)
    return write_page(
        out,
        "efficiency",
        conclusion(gradients),
        fraction=FRACTION,
        columns=MOST_COLUMNS,
        jitters=JITTERS,
        baffle_jitters=BAFFLE_JITTERS,
        gradients=formatted(gradients, GRADIENT),
    )


def gradients_of(name: str, problem: Problem, step: float, simulator: Simulator, jitters: int) -> list[Found]:
    """One gradient by each method at the problem's start, timed and compared with the MPM's mean differences."""
    target, start = read_target(problem, simulate), problem.initial
    observation, unknowns = target.observation, len(problem.numbers)
    # All, or some along the diagonal of the cuts.
    chosen = np.unique(np.linspace(0, unknowns - 1, min(unknowns, MOST_COLUMNS)).round().astype(np.int64))
    moves = step * np.eye(unknowns)[chosen]
    seeds = [problem.scene.seed, *range(20_003, 20_002 + jitters)]
    seeded = [replace(problem, scene=replace(problem.scene, seed=seed)) for seed in seeds]

    def reverse(*forwards: GnsForward | AdjointForward) -> list[Slope]:
        """By one backward pass each; one before compiles kernels."""
        found = []
        for each in (forwards[0], *forwards):
            began, point = time.perf_counter(), torch.tensor(start, dtype=torch.float64, requires_grad=True)
            residual = each.predict(point) - torch.from_numpy(each.select(target.values))
            loss = observation.components * residual.square().mean()
            (slope,) = torch.autograd.grad(loss, point)
            found.append((time.perf_counter() - began, slope.numpy()[chosen]))
        return found[1:]

    runs = [MpmForward(each, observation, simulate_many) for each in seeded]
    own = runs[0].select(target.values)
    differences = [by_runs(each, own, observation.components, start, moves) for each in runs]
    found = {
        SURROGATE: reverse(GnsForward(simulator, problem, observation)),
        ADJOINT: reverse(*(AdjointForward(each, observation, simulate_many) for each in seeded)),
        DIFFERENCES: differences,
    }
    expected = np.mean([slope for _, slope in differences], axis=0)
    gradients = []
    for method, slopes in found.items():
        mean = np.mean([slope for _, slope in slopes], axis=0)
        length, off = float(np.linalg.norm(mean)), [np.linalg.norm(slope - mean) for _, slope in slopes]
        # The differences of the unknowns that were not chosen would take as long as the others.
        more = (1 + 2 * unknowns) / (1 + 2 * len(chosen)) if method == DIFFERENCES else 1.0
        gradients.append(
            {
                "problem": name,
                "unknowns": unknowns,
                "by": method,
                "seconds": slopes[0][0] * more,
                "cosine": float(mean @ expected / (length * np.linalg.norm(expected))),
                "length": length / float(np.linalg.norm(expected)),
                SCATTER: float(np.sqrt(np.sum(np.square(off)) / max(1, len(off) - 1))) / length,
            }
        )
    return gradients


def conclusion(gradients: Sequence[Found]) -> list[str]:
    largest = max(each["unknowns"] for each in gradients)
    shown = [each for each in gradients if each["unknowns"] == largest]
    prices = ", ".join(f"{each['seconds']:.2g} s by {each['by']}" for each in shown)
    cosines = [f"{each['cosine']:.2f} by {each['by']}" for each in shown if each["by"] != DIFFERENCES]
    scatter = {each["by"]: each[SCATTER] for each in gradients if each["problem"] == BAFFLES}
    return [
        f"A gradient with respect to {largest} unknown velocities takes {prices}.",
        f"Its cosine with the differences of the MPM, means over {JITTERS} jitters, is {' and '.join(cosines)}.",
        f"For the places of two baffles, the adjoint of one jitter scatters by {scatter[ADJOINT]:.0%} of the"
        f" mean gradient, differences over {1000.0 * BAFFLE_STEP:g} mm by {scatter[DIFFERENCES]:.0%}.",
    ]
