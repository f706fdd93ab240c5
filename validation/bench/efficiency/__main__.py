"""`python -m validation.bench.efficiency --out docs`: gradients compared on each problem, over unknowns and over points."""

import dataclasses
import sys
from collections.abc import Callable
from datetime import date
from pathlib import Path

import torch

from datasets.command_line import run
from datasets.errors import InputError
from datasets.files import write_text
from gns.inference import shipped
from gns.model import checkpoint
from inverse.problem import Problem, read_problem
from mpm.processors import processors
from validation.bench.columns.paper import read_paper
from validation.bench.efficiency import kept, sizes
from validation.bench.efficiency.cuts import CUTS, over_unknowns
from validation.bench.efficiency.kept import Parts
from validation.bench.efficiency.methods import ways
from validation.bench.efficiency.page import POINTS_PICTURE, UNKNOWNS_PICTURE, page, race_picture, started
from validation.bench.efficiency.pictures import draw_points, draw_race, draw_unknowns
from validation.bench.efficiency.race import CURVE, floor, prepare, race
from validation.bench.efficiency.rows import Made, OverPoints, OverUnknowns, Race
from validation.report.machine import GNS, MPM, machine

LIMITS = {"friction-tall-42": 25.0, "velocity-layers-10": 45.0, "baffles-2": 45.0, "cohesion-friction": 25.0}
"""Seconds for each method, by problem."""
PARTS = (*LIMITS, "unknowns", "points")
QUICK_S = 5.0
"""For each method in a trial."""
QUICK_FLOW_S = 0.25
"""How long flows last in a trial [s]."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Setup:
    """What a run was asked for."""

    model_2d: Path
    model_3d: Path
    limit: float | None
    threads: int
    quick: bool

    @property
    def key(self) -> str:
        """What the figures depend on."""
        models = (self.model_2d, self.model_3d)
        return kept.key(models, self.limit, self.threads, processors(), self.quick)

    def made(self, name: str) -> Made:
        """How a part is measured, in a line."""
        flags = f" --seconds {self.limit:g}" if self.limit is not None else ""
        flags += " --quick" if self.quick else ""
        used = f"PyTorch on {self.threads} thread{'s' if self.threads > 1 else ''}, the MPM on {processors()}"
        return Made(
            command=f"python -m validation.bench.efficiency --only {name}{flags}",
            machine=f"{machine(GNS | MPM)}; {used}",
            date=date.today().isoformat(),
            key=self.key,
            quick=self.quick,
        )


def raced(name: str, setup: Setup) -> Race:
    """All methods on one problem."""
    problem = read_problem(name)
    if setup.quick:
        problem = dataclasses.replace(problem, scene=dataclasses.replace(problem.scene, duration=QUICK_FLOW_S))
    model = setup.model_2d if problem.scene.dimension == 2 else setup.model_3d
    field = prepare(problem, checkpoint.load(model).simulator)
    limit = setup.limit or (QUICK_S if setup.quick else LIMITS[name])
    return Race(
        made=setup.made(name),
        problem=name,
        start=started(problem.names, problem.initial.tolist()),
        rule=stopping(problem),
        limit=limit,
        floor=floor(problem, field),
        rows=race(ways(problem, read_paper()), field, limit, curve=2 if setup.quick else CURVE),
    )


def stopping(problem: Problem) -> str:
    """When a search is over, in words."""
    settings = problem.optimiser
    return (
        f"a loss below {settings.stop_below:.0e}, {settings.max_iterations} iterations, or where the optimiser sees no "
        "way on; the paper's descent below 5e-4 or after 20, a search without gradients by its loss alone"
    )


def cut(setup: Setup) -> OverUnknowns:
    """One heap cut into more and more blocks."""
    simulator = checkpoint.load(setup.model_2d).simulator
    cuts, duration = (CUTS[:2], QUICK_FLOW_S) if setup.quick else (CUTS, None)
    points, steps, gradients = over_unknowns(simulator, cuts=cuts, duration=duration)
    return OverUnknowns(made=setup.made("unknowns"), points=points, steps=steps, gradients=gradients)


def grown(setup: Setup) -> OverPoints:
    """One column, larger and larger."""
    costs = sizes.over_points(
        lambda case: sizes.apart(case, setup.model_2d, setup.threads), sizes.QUICK if setup.quick else sizes.SIZES
    )
    return OverPoints(made=setup.made("points"), costs=costs)


def measure(name: str, setup: Setup) -> Race | OverUnknowns | OverPoints:
    """One part."""
    if name in LIMITS:
        return raced(name, setup)
    others: dict[str, Callable[[Setup], OverUnknowns | OverPoints]] = {"unknowns": cut, "points": grown}
    return others[name](setup)


def keep(out: Path, parts: Parts, part: Race | OverUnknowns | OverPoints) -> Parts:
    """Keep a part that is done: raw numbers, picture, page."""
    parts = parts.with_part(part)
    ordered = {name: parts.races[name] for name in LIMITS if name in parts.races}
    parts = dataclasses.replace(parts, races=ordered)
    kept.write(out, parts)
    if isinstance(part, Race):
        draw_race(out / race_picture(part.problem), part)
    elif isinstance(part, OverUnknowns):
        draw_unknowns(out / UNKNOWNS_PICTURE, part)
    else:
        draw_points(out / POINTS_PICTURE, part)
    write_text(out / "efficiency.md", page(parts, read_paper()))
    return parts


def command(
    *,
    out: Path,
    only: tuple[str, ...] = (),
    seconds: float | None = None,
    threads: int | None = None,
    model: Path | None = None,
    model_3d: Path | None = None,
    resume: bool = False,
    quick: bool = False,
) -> None:
    """Compare AD, differences and searches without gradients, with the GNS and with the MPM; about 20 minutes.

    Each part is kept in OUT/efficiency.json when it is done; parts that are not asked for stay as they were.

    Parameters
    ----------
    out
        Folder for efficiency.md, efficiency.json and pictures.
    only
        Parts to measure: friction-tall-42, velocity-layers-10, baffles-2, cohesion-friction, unknowns, points; all
        unless given.
    seconds
        For each method on each problem; 25 unless given, 45 for velocities and baffles.
    threads
        Of PyTorch; as many as there are processors unless given, as the MPM has them.
    model
        Weights of the surrogate in 2D; those that ship unless given.
    model_3d
        The same in 3D.
    resume
        Leave out the parts that are there, measured with the same weights, limits and threads.
    quick
        A trial that everything works: flows of a quarter of a second, 5 s a method, few unknowns and points.
    """
    for name in only:
        if name not in PARTS:
            raise InputError(f"expected one of {', '.join(PARTS)}, got {name!r}", key="--only")
    if seconds is not None and not seconds > 0.0:
        raise InputError(f"expected a positive number of seconds, got {seconds:g}", key="--seconds")
    if threads is not None and threads < 1:
        raise InputError(f"expected at least 1, got {threads}", key="--threads")
    setup = Setup(
        model_2d=model or shipped(2),
        model_3d=model_3d or shipped(3),
        limit=seconds,
        threads=threads or processors(),
        quick=quick,
    )
    torch.set_num_threads(setup.threads)
    parts = kept.read(out)
    for name in [each for each in PARTS if each in only] or PARTS:
        done = parts.made(name)
        if resume and done is not None and done.key == setup.key:
            continue
        parts = keep(out, parts, measure(name, setup))
    print(page(parts, read_paper()))


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.bench.efficiency"))
