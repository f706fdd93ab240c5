"""`python -m validation.bench efficiency`: what a gradient costs by surrogate, adjoint and differences.

The paper's column of ten layers is cut into 1 to 100 blocks of unknown velocity. Gradients are compared with the
MPM's differences averaged over `JITTERS` seeds: along the path of one run the adjoint has its corners, which the mean
over runs has not. So has that of two baffles in 3D.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import product
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

import gns
from datasets.library import read_scene
from datasets.processes import processors
from datasets.scene import Mass, Scene
from gns.simulator import Simulator
from inverse.forward import Differentiable, Forward
from inverse.forward.adjoint import AdjointForward
from inverse.forward.gns import GnsForward
from inverse.forward.mpm import MpmForward
from inverse.observations import DepositSettings, Values
from inverse.parameters import Parameter, Vector
from inverse.problem import Problem, read_problem
from inverse.settings import TargetSettings
from inverse.target import read_target
from mpm import simulate, simulate_many
from validation.report.page import GNS, MPM, Page, Row
from validation.report.plots import BLUE, INK, ORANGE, RED, figure

SCENE = "layers-10"
CUTS = {1: (1, 1), 10: (1, 10), 100: (10, 10)}
"""Blocks along x and along y, by the number of unknowns."""
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
QUICK_S = 0.2
"""How long flows last with `--quick` [s]."""
PICTURES, LINE = "pictures", "efficiency-line.png"
SEARCHES = Path(__file__).parent / "frozen" / "efficiency.md"
"""Whole searches, which were measured once."""


class Method(StrEnum):
    SURROGATE = "surrogate"
    """Reverse mode through the rollout."""
    ADJOINT = "adjoint of the MPM"
    DIFFERENCES = "differences of the MPM"


COLOURS = {Method.SURROGATE: ORANGE, Method.ADJOINT: RED, Method.DIFFERENCES: BLUE}


@dataclass(frozen=True, kw_only=True)
class Gradient:
    problem: str
    method: Method
    unknowns: int
    seconds: float
    columns: int
    """Unknowns whose differences were run; the seconds of the others are taken to be the same."""
    cosine: float
    """Of the angle between its mean over the jitters and that of the MPM's differences, over those unknowns."""
    length: float
    """Over that of the differences' mean."""
    scatter: float
    """Of the gradient of one jitter, rms over the length of their mean; of the surrogate, which has one, 0."""


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """The loss at one vector of parameters, mean of the squared distances of what is compared."""

    loss: float
    seconds: float
    slope: Vector
    """d(loss)/d(parameters), shape [U], or along k of them, shape [k]."""


Evaluate = Callable[[Vector], Evaluation]


def by_reverse(forward: Differentiable, target: Values, components: int) -> Evaluate:
    """Loss against `target` [m] and its gradient by one backward pass."""

    def evaluate(at: Vector) -> Evaluation:
        began = time.perf_counter()
        point = torch.tensor(at, dtype=torch.float64, requires_grad=True)
        loss = components * (forward.predict(point) - torch.from_numpy(target)).square().mean()
        loss.backward()  # type: ignore[no-untyped-call]
        assert point.grad is not None, "a leaf"
        seconds = time.perf_counter() - began
        return Evaluation(loss=loss.item(), slope=point.grad.numpy(), seconds=seconds)

    return evaluate


def by_runs(forward: Forward, target: Values, components: int, moves: NDArray[np.float64]) -> Evaluate:
    """Loss against `target` [m] and its slope along each of `moves` [k, U] by central differences."""

    def evaluate(at: Vector) -> Evaluation:
        began = time.perf_counter()
        first, *rows = forward.observe([at, *(at + moves), *(at - moves)])
        seconds, residual = time.perf_counter() - began, first - target
        ahead, behind = np.split(np.reshape(rows, (2 * len(moves), len(first))).T.copy(), 2, axis=1)
        jacobian = (ahead - behind) / (2.0 * np.linalg.norm(moves, axis=1))
        slope = 2.0 * components * residual @ jacobian / len(residual)
        return Evaluation(loss=components * float(np.mean(residual**2)), slope=slope, seconds=seconds)

    return evaluate


def blocks(columns: int, layers: int) -> Scene:
    """The layers' sand in `columns` times `layers` blocks at their true velocities, cut between its particles.

    However it is cut, its particles are the same: no cut goes through a particle's share of a cell.
    """
    whole = read_scene(SCENE)
    spacing = whole.particle_spacing
    across = round(whole.masses[0].size[0] / spacing)
    up = round(max(mass.lower[1] + mass.size[1] for mass in whole.masses) / spacing)
    x, y = (np.round(np.linspace(0, count, parts + 1)) for count, parts in ((across, columns), (up, layers)))
    masses = tuple(
        Mass(
            lower=(float(x[i] * spacing), float(y[j] * spacing)),
            size=(float((x[i + 1] - x[i]) * spacing), float((y[j + 1] - y[j]) * spacing)),
            velocity=(AT_FLOOR + (AT_TOP - AT_FLOOR) * float((y[j] + y[j + 1]) / 2.0 / up), 0.0),
        )
        for j, i in product(range(layers), range(columns))
    )
    return replace(whole, masses=masses)


def blocks_problem(unknowns: int) -> Problem:
    """The velocities of so many blocks from their deposit; it starts at `FRACTION` of the true ones."""
    scene = blocks(*CUTS[unknowns])
    return Problem(
        name=f"blocks-{unknowns}",
        scene=scene,
        parameters=tuple(
            Parameter(
                name=f"masses[{index}].velocity_x",
                initial=FRACTION * (mass.velocity or (0.0,))[0],
                lower=-3.0,
                upper=3.0,
            )
            for index, mass in enumerate(scene.masses)
        ),
        observations=(DepositSettings(),),
        target=TargetSettings(twin=True),
    )


def bench(out: Path, *, quick: bool, keep: Path) -> str:
    """Gradients over the number of unknowns by every method; some minutes.

    quick: short flows, at most ten unknowns. keep: not used, seconds are measured anew.
    """
    torch.set_num_threads(processors())
    simulator = gns.load("flow2d")

    def asked(problem: Problem) -> Problem:
        scene = replace(problem.scene, duration=QUICK_S) if quick else problem.scene
        return replace(problem, scene=scene)

    gradients = [
        each
        for number in tqdm([*CUTS][: 2 if quick else None], desc="gradients", unit="cut")
        for each in gradients_of(BLOCKS, asked(blocks_problem(number)), STEP, simulator, JITTERS)
    ]
    if not quick:
        baffles, network = read_problem(BAFFLES), gns.load("obstacle3d")
        gradients += gradients_of(BAFFLES, baffles, BAFFLE_STEP, network, BAFFLE_JITTERS)
        draw_line(out / PICTURES / LINE, baffles)
    draw_gradients(out / PICTURES / "efficiency-unknowns.png", gradients)
    return page(gradients, quick=quick).write(out / "efficiency.md")


def gradients_of(name: str, problem: Problem, step: float, simulator: Simulator, jitters: int) -> list[Gradient]:
    """One gradient by each method at the problem's start, timed and compared with the MPM's mean differences."""
    target = read_target(problem, simulate)
    observation, values, unknowns = target.observation, target.values, len(problem.numbers)
    mpm, surrogate = MpmForward(problem, observation, simulate_many), GnsForward(simulator, problem, observation)
    # All, or some along the diagonal of the cuts.
    chosen = np.unique(np.linspace(0, unknowns - 1, min(unknowns, MOST_COLUMNS)).round().astype(np.int64))
    own = mpm.select(values)

    def reverse(*forwards: GnsForward | AdjointForward) -> list[Evaluation]:
        evaluates = [by_reverse(each, each.select(values), observation.components) for each in forwards]
        # This one compiles kernels.
        evaluates[0](problem.initial)
        return [evaluate(problem.initial) for evaluate in evaluates]

    seeds = [problem.scene.seed, *range(20_003, 20_002 + jitters)]
    seeded = [replace(problem, scene=replace(problem.scene, seed=seed)) for seed in seeds]
    moves = step * np.eye(unknowns)[chosen]
    differences = [
        by_runs(MpmForward(each, observation, simulate_many), own, observation.components, moves)(problem.initial)
        for each in seeded
    ]
    runs, whole = (1 + 2 * count for count in (len(chosen), unknowns))
    adjoints = [AdjointForward(each, observation, simulate_many) for each in seeded]
    expected = np.mean([each.slope for each in differences], axis=0)

    def compared(method: Method, found: Sequence[Evaluation], share: float = 1.0) -> Gradient:
        slopes = np.stack([each.slope for each in found])
        slopes = slopes if method is Method.DIFFERENCES else slopes[:, chosen]
        mean = slopes.mean(axis=0)
        length, off = float(np.linalg.norm(mean)), np.linalg.norm(slopes - mean, axis=1)
        return Gradient(
            problem=name,
            method=method,
            unknowns=unknowns,
            seconds=found[0].seconds * share,
            columns=len(chosen) if method is Method.DIFFERENCES else unknowns,
            cosine=float(mean @ expected / (length * np.linalg.norm(expected))),
            length=length / float(np.linalg.norm(expected)),
            scatter=float(np.sqrt(np.sum(off**2) / max(1, len(found) - 1))) / length,
        )

    return [
        compared(Method.SURROGATE, reverse(surrogate)),
        compared(Method.ADJOINT, reverse(*adjoints)),
        compared(Method.DIFFERENCES, differences, whole / runs),
    ]


def conclusion(gradients: Sequence[Gradient]) -> list[str]:
    """The price of a gradient and its direction."""
    of_blocks = [each for each in gradients if each.problem == BLOCKS]
    seconds = {method: {e.unknowns: e.seconds for e in of_blocks if e.method is method} for method in Method}
    numbers = sorted(seconds[Method.SURROGATE])

    prices = [f"{method} {' / '.join(f'{seconds[method][n]:.2g} s' for n in numbers)}" for method in Method]
    cosines = [
        f"{method} {' / '.join(f'{e.cosine:.2f}' for e in of_blocks if e.method is method and e.unknowns > 1)}"
        for method in (Method.SURROGATE, Method.ADJOINT)
    ]
    sentences = [f"A gradient in {' / '.join(f'{n:,}' for n in numbers)} unknowns: {'; '.join(prices)}."]
    if many := " / ".join(f"{n:,}" for n in numbers if n > 1):
        sentences.append(
            f"Cosine to the MPM's differences (means of {JITTERS} jitters) in {many}: {'; '.join(cosines)}."
        )
    return sentences


def page(gradients: Sequence[Gradient], *, quick: bool) -> Page:
    said = conclusion(gradients)
    result = Page("What a gradient costs", "efficiency --out docs", said, packages=MPM | GNS, quick=quick)
    result.section("Over the unknowns")
    result.text(f"""
        The paper's sand of ten layers, cut into blocks between its particles; the velocity of each along x is unknown.
        True ones fall from {AT_FLOOR:g} m/s at the floor to {AT_TOP:g} at the top; the gradient of the deposit's loss
        is evaluated at {FRACTION:g} of them. "≈": the differences of {MOST_COLUMNS} unknowns were run and their seconds
        multiplied; cosine and length are over those unknowns, of the mean over {JITTERS} jitters
        ({BAFFLE_JITTERS} by baffles) to that of the differences; the scatter is how far the gradient of one jitter
        lies from this mean, over its length. Seconds are those of one jitter. `{BAFFLES}`: the places of two baffles
        by the toe, differences of {BAFFLE_STEP:g} m.
    """)
    result.table([gradient_row(each) for each in gradients])
    result.picture(f"{PICTURES}/efficiency-unknowns.png", "seconds of a gradient over unknowns")
    if not quick:
        result.text(f"""
            Along one parameter the loss of one jitter has slopes of its own over some 10 mm, a third of a cell,
            which the adjoint shows and differences of {1000.0 * BAFFLE_STEP:g} mm do not; a mean over jitters has not.
        """)
        result.picture(f"{PICTURES}/{LINE}", "loss of one jitter over the place of a baffle")
    result.frozen(SEARCHES)
    return result


def gradient_row(each: Gradient) -> Row:
    return {
        "problem": each.problem,
        "unknowns": f"{each.unknowns:,}",
        "by": each.method,
        "seconds": f"{'≈ ' if each.columns < each.unknowns else ''}{each.seconds:.2f}",
        "cosine": f"{each.cosine:.3f}",
        "length": f"{each.length:.2f}",
        "scatter of one jitter": "-" if each.method is Method.SURROGATE else f"{each.scatter:.2f}",
    }


def draw_gradients(path: Path, gradients: Sequence[Gradient]) -> None:
    """Seconds per gradient over the unknowns; a ring where they were multiplied."""
    with figure(path, size=(6.0, 4.0)) as axes:
        axis = axes[0, 0]
        for method, colour in COLOURS.items():
            curve = [each for each in gradients if each.method is method and each.problem == BLOCKS]
            axis.plot([e.unknowns for e in curve], [e.seconds for e in curve], color=colour, lw=1.2, label=method)
            for each in curve:
                fill = "none" if each.columns < each.unknowns else colour
                axis.plot(each.unknowns, each.seconds, "o", color=colour, mfc=fill)
        axis.set(xscale="log", yscale="log", xlabel="unknowns", ylabel="seconds per gradient")
        axis.legend(fontsize=7)


def draw_line(path: Path, problem: Problem) -> None:
    """Loss of one jitter along the first number and its slopes at the start."""
    start, along = problem.initial, np.linspace(-BAFFLE_STEP, BAFFLE_STEP, 41)
    target = read_target(problem, simulate)
    observation, values = target.observation, target.values
    mpm = MpmForward(problem, observation, simulate_many)
    adjoint = AdjointForward(problem, observation, simulate_many)
    evaluate = by_reverse(adjoint, adjoint.select(values), observation.components)
    seen = np.stack(mpm.observe([start + at * np.eye(len(start))[0] for at in along]))
    losses = observation.components * np.mean((seen - mpm.select(values)) ** 2, axis=1)
    differences = (losses[-1] - losses[0]) / (along[-1] - along[0])
    slopes = {Method.ADJOINT: evaluate(start).slope[0], Method.DIFFERENCES: differences}
    with figure(path, size=(6.0, 4.0)) as axes:
        axes[0, 0].plot(1000.0 * along, losses, "o-", color=INK, lw=0.8, markersize=3, label="one jitter")
        for method, slope in slopes.items():
            axes[0, 0].plot(1000.0 * along, losses[20] + slope * along, color=COLOURS[method], lw=1.2, label=method)
        axes[0, 0].set(xlabel=f"{problem.names[0]} - start [mm]", ylabel="loss [m²]")
        axes[0, 0].legend(fontsize=7)
