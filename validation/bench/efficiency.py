"""`python -m validation.bench efficiency`: what a gradient costs by surrogate, adjoint and differences, and a search.

The paper's column of ten layers is cut into 1 to 100 blocks of unknown velocity. Gradients are compared with the
MPM's differences averaged over `JITTERS` seeds: along the path of one run the adjoint has its corners, which the mean
over runs has not. So has that of two baffles in 3D.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import product
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

import gns
from datasets.library import read_scene
from datasets.processes import processors
from datasets.scene import Mass, Scene
from gns.simulator import Simulator
from inverse.forward.adjoint import AdjointForward
from inverse.forward.gns import GnsForward
from inverse.forward.mpm import MpmForward
from inverse.parameters import Parameter
from inverse.problem import Problem, read_problem
from inverse.settings import ObservationSettings, TargetSettings
from mpm import simulate_many
from validation.bench.searches import By, Evaluation, Models, Searched, by_reverse, by_runs, methods, search
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
HUNDRED = "velocity-blocks-100"
"""The problem of a hundred blocks; a start of 0.75 m/s and the bounds of `velocity-layers-10`."""
BLOCKS, BAFFLES = "blocks", "baffles-2"
BAFFLE_STEP = 0.02
"""Step of the differences of two baffles [m]."""
JITTERS, BAFFLE_JITTERS = 4, 12
"""Jitter seeds over which gradients of the MPM are averaged: by the place of a baffle one adjoint scatters by half."""
LIMITS = {"friction-tall-42": 15.0, "velocity-layers-10": 40.0, HUNDRED: 50.0}
"""Seconds for each method, by problem."""
QUICK_S, QUICK_LIMIT = 0.2, 3.0
"""How long flows last and seconds for each method, with `--quick` [s]."""
SAME = 1.5
"""Losses whose ratio is less than this do not differ: a check run scatters too."""
PICTURES, LINE = "pictures", "efficiency-line.png"


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
class Compared:
    problem: str
    limit: float
    """Seconds that each method may use."""
    floor: float
    """Loss that the MPM shows at the truth, by its own scatter."""
    searches: tuple[Searched, ...]

    @property
    def level(self) -> float:
        """The loss below which no answer is better than another, by the MPM's own scatter."""
        return SAME * max(self.floor, min(each.loss for each in self.searches))


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
        observations=(ObservationSettings(kind="deposit"),),
        target=TargetSettings(twin=True),
    )


def hundred_problem() -> Problem:
    """As `velocity-layers-10`, of a hundred blocks."""
    problem = blocks_problem(100)
    numbers = tuple(replace(each, initial=0.75, lower=-1.0, upper=3.0) for each in problem.parameters)
    return replace(problem, name=HUNDRED, parameters=numbers)


def bench(out: Path, *, quick: bool, keep: Path) -> str:
    """Gradients over the number of unknowns, and whole searches, by every method; some seven minutes.

    quick: short flows, ten unknowns, one problem. keep: not used, seconds are measured anew.
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
        gradients += gradients_of(BAFFLES, read_problem(BAFFLES), BAFFLE_STEP, gns.load("obstacle3d"), BAFFLE_JITTERS)
    compared = []
    for name in [*LIMITS][: 1 if quick else None]:
        problem = asked(hundred_problem() if name == HUNDRED else read_problem(name))
        models, limit = Models.build(problem, simulator), QUICK_LIMIT if quick else LIMITS[name]
        searches = [search(by, models, limit) for by in tqdm(methods(problem), desc=name, unit="method")]
        compared.append(
            Compared(problem=name, limit=limit, floor=models.checked(models.truth), searches=tuple(searches))
        )
        draw_line(out / PICTURES / LINE, Models.build(read_problem(BAFFLES), gns.load("obstacle3d")))
    draw_gradients(out / PICTURES / "efficiency-unknowns.png", gradients)
    draw_searches(out / PICTURES / "efficiency-searches.png", compared)
    return page(gradients, compared, quick=quick).write(out / "efficiency.md")


def gradients_of(name: str, problem: Problem, step: float, simulator: Simulator, jitters: int) -> list[Gradient]:
    """One gradient by each method at the problem's start, timed and compared with the MPM's mean differences."""
    models = Models.build(problem, simulator)
    observation, values, unknowns = models.target.observation, models.target.values, len(problem.numbers)
    # All, or some along the diagonal of the cuts.
    chosen = np.unique(np.linspace(0, unknowns - 1, min(unknowns, MOST_COLUMNS)).round().astype(np.int64))
    own = models.mpm.select(values)

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
        compared(Method.SURROGATE, reverse(models.surrogate)),
        compared(Method.ADJOINT, reverse(*adjoints)),
        compared(Method.DIFFERENCES, differences, whole / runs),
    ]


def conclusion(gradients: Sequence[Gradient], compared: Sequence[Compared]) -> list[str]:
    """The price of a gradient, its direction, and who gets first to the MPM's own scatter."""
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
    for each in compared[: 5 - len(sentences)]:
        there = {s.by: s.seconds_to(each.level) for s in each.searches}
        ranked = sorted((seconds, by) for by, seconds in there.items() if math.isfinite(seconds))
        got = ", ".join(f"{by} {seconds:.2g} s" for seconds, by in ranked)
        never = ", ".join(by for by, seconds in there.items() if math.isinf(seconds))
        sentences.append(
            f"`{each.problem}` to the MPM's own scatter: {got}"
            + (f"; not within {each.limit:g} s: {never}." if never else ".")
        )
    return sentences


def page(gradients: Sequence[Gradient], compared: Sequence[Compared], *, quick: bool) -> Page:
    said = conclusion(gradients, compared)
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
    result.section("To the MPM's own scatter")
    result.text(f"""
        Whole searches from the problem's start. The loss is that of an MPM run at the answer, with a jitter that
        neither target nor search used. The scatter: {SAME:g} times the least loss of any, or that at the truth. The
        paper's descent: gradient descent for the angle, Adam for velocities, by the surrogate. Optuna uses no gradient.
    """)
    for each in compared:
        result.section(each.problem, level=3)
        result.text(f"Loss at the truth {each.floor:.1e}; each method has {each.limit:g} s.")
        result.table([search_row(one, each.level) for one in each.searches])
    if compared:
        result.picture(f"{PICTURES}/efficiency-searches.png", "MPM loss over seconds")
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


def search_row(each: Searched, level: float) -> Row:
    there = each.seconds_to(level)
    return {
        "method": each.by,
        "evaluations": len(each.losses),
        "MPM runs": each.mpm_runs,
        "seconds": f"{each.seconds[-1]:.1f}",
        "seconds to the scatter": "-" if math.isinf(there) else f"{there:.1f}",
        "MPM loss": f"{each.loss:.1e}",
        "rms error": f"{each.error:.3g}",
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


def draw_line(path: Path, models: Models) -> None:
    """Loss of one jitter along the first number and its slopes at the start."""
    start, along = models.problem.initial, np.linspace(-BAFFLE_STEP, BAFFLE_STEP, 41)
    own, evaluate = models.mpm.select(models.target.values), models.evaluate(By.ADJOINT)
    seen = np.stack(models.mpm.observe([start + at * np.eye(len(start))[0] for at in along]))
    losses = models.target.observation.components * np.mean((seen - own) ** 2, axis=1)
    differences = (losses[-1] - losses[0]) / (along[-1] - along[0])
    slopes = {Method.ADJOINT: evaluate(start).slope[0], Method.DIFFERENCES: differences}
    with figure(path, size=(6.0, 4.0)) as axes:
        axes[0, 0].plot(1000.0 * along, losses, "o-", color=INK, lw=0.8, markersize=3, label="one jitter")
        for method, slope in slopes.items():
            axes[0, 0].plot(1000.0 * along, losses[20] + slope * along, color=COLOURS[method], lw=1.2, label=method)
        axes[0, 0].set(xlabel=f"{models.problem.names[0]} - start [mm]", ylabel="loss [m²]")
        axes[0, 0].legend(fontsize=7)


def draw_searches(path: Path, compared: Sequence[Compared]) -> None:
    """MPM loss at each method's best iterate over the seconds, a pane for each problem."""
    with figure(path, columns=max(1, len(compared)), size=(5.0, 4.0)) as axes:
        for number, each in enumerate(compared):
            axis = axes[0, number]
            for by, marker in zip(By, "os^Dv", strict=True):
                for one in each.searches:
                    if one.by is by:
                        # A surrogate's own losses are not the MPM's: its answer alone is shown.
                        lowest = np.minimum.accumulate(one.losses) if one.by_mpm else [one.loss]
                        axis.plot(one.seconds[-len(lowest) :], lowest, f"{marker}-", lw=1.2, markersize=4, label=by)
            axis.axhline(each.floor, color=INK, linewidth=0.8, linestyle=":", label="the truth")
            axis.set(xscale="log", yscale="log", xlabel="seconds", ylabel="MPM loss [m²]", title=each.problem)
            axis.legend(fontsize=7)
