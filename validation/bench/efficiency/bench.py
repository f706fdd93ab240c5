"""`python -m validation.bench efficiency`: gradients compared on problems, over unknowns and over particles."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import torch

from datasets.processes import processors
from gns import checkpoint
from gns.library import shipped
from inverse.problem import Problem, read_problem
from validation.bench.efficiency import columns, gradients, records
from validation.bench.efficiency.methods import methods
from validation.bench.efficiency.page import write
from validation.bench.efficiency.records import Origin, OverParticles, OverUnknowns, Part, Parts, ProblemResult
from validation.bench.efficiency.search import CHECKS, Models, search_all
from validation.bench.paper import read_paper

LIMITS = {
    "friction-tall-42": 15.0,
    "velocity-layers-10": 45.0,
    gradients.HUNDRED: 50.0,
    "baffles-2": 30.0,
    "cohesion-friction": 15.0,
}
"""Seconds for each method, by problem."""
QUICK_LIMIT, QUICK_FLOW_S = 5.0, 0.25
"""Seconds for each method, and how long flows last [s], with `--quick`."""


def bench(out: Path, *, quick: bool, keep: Path) -> str:
    """Compare AD, differences and searches without gradients, with the GNS and the MPM; about half an hour.

    Parameters
    ----------
    out
        Folder for efficiency.md, its pictures and efficiency.json.
    quick
        Short flows, one problem, few unknowns and particles.
    keep
        Folder of efficiency.json with the parts that are done; those that were measured with the same weights, number
        of processors and `quick` are not measured again.
    """
    torch.set_num_threads(processors())
    origin = Origin.here(quick=quick)
    parts = records.read(keep)
    for name in parts_to_measure(quick):
        done = parts.get(name)
        done = None if done is None or done.origin.key != origin.key else done
        if done is None or isinstance(done, OverParticles):
            before = parts

            def save(part: Part, before: Parts = before) -> None:
                records.write(keep, before.with_part(part))

            parts = parts.with_part(measure(name, origin, done, save))
            records.write(keep, parts)
    records.write(out, parts)
    return write(out, parts)


def parts_to_measure(quick: bool) -> Sequence[str]:
    """Names of the parts; with `quick` a single problem."""
    return [*(list(LIMITS)[:1] if quick else LIMITS), "unknowns", "particles"]


def measure(name: str, origin: Origin, done: OverParticles | None, save: Callable[[Part], None]) -> Part:
    """One part; of the sizes what is not `done`, saved after each of their cases."""
    if name == "unknowns":
        return over_unknowns(origin)
    if name == "particles":
        sizes = columns.QUICK if origin.quick else columns.SIZES
        return columns.over_particles(origin, sizes=sizes, kept=done.costs if done else (), keep=save)
    return problem_result(gradients.hundred_problem() if name == gradients.HUNDRED else read_problem(name), origin)


def problem_result(problem: Problem, origin: Origin) -> ProblemResult:
    """All methods on one problem."""
    if origin.quick:
        problem = dataclasses.replace(problem, scene=dataclasses.replace(problem.scene, duration=QUICK_FLOW_S))
    models = Models.build(problem, checkpoint.load(shipped(problem.scene.dimension)).simulator)
    limit = QUICK_LIMIT if origin.quick else LIMITS[problem.name]
    settings = problem.optimiser
    return ProblemResult(
        origin=origin,
        problem=problem.name,
        start=start_text(problem),
        rule=f"a loss below {settings.stop_below:.0e}, {settings.max_iterations} iterations, or the optimiser's own"
        " end; the paper's descent below 5e-4 or after 20, a search without gradients by its loss alone",
        limit=limit,
        floor=models.floor(problem),
        methods=search_all(methods(problem, read_paper()), models, limit, checks=2 if origin.quick else CHECKS),
    )


def start_text(problem: Problem) -> str:
    """The start in words; equal values of many unknowns once."""
    values = problem.initial.tolist()
    if len(values) > 2 and len(set(values)) == 1:
        return f"all {len(values)} unknowns at {values[0]:g}"
    return ", ".join(f"{name} = {value:g}" for name, value in zip(problem.names, values, strict=True))


def over_unknowns(origin: Origin) -> OverUnknowns:
    """The same sand cut into more and more blocks."""
    simulator = checkpoint.load(shipped(2)).simulator
    cuts, duration = (gradients.CUTS[:2], QUICK_FLOW_S) if origin.quick else (gradients.CUTS, None)
    return gradients.over_unknowns(simulator, origin, cuts=cuts, duration=duration)
