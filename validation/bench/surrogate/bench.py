"""`python -m validation.bench surrogate`: the shipped models against the MPM on held-out scenes."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from datasets.definitions.flow2d import FRAME_DT
from datasets.library import read_scene
from datasets.processes import processors
from mpm.generate import pool
from mpm.resolution import fitted_cell
from validation.bench.paper import read_paper
from validation.bench.surrogate import accuracy, calibration, friction, held_out, pictures, price, rest, velocities
from validation.bench.surrogate.accuracy import Accuracy, Map, spread_over_kinds
from validation.bench.surrogate.held_out import Family, HeldOut, References, on_cell
from validation.bench.surrogate.models import Model, RolloutTask, load, roll_out
from validation.bench.surrogate.page import Found, page
from validation.bench.surrogate.pictures import Pictured
from validation.bench.surrogate.velocities import Plan

SHIPPED_3D = ("baffles-2", "baffles-5")
"""Beside the held-out scenes in error over seconds; in 2D the paper's columns."""
QUICK_CELLS = {2: 4.0, 3: 2.0}
"""How many times larger cells are with `--quick`, by dimension."""
QUICK_KINDS = 3
QUICK_PLAN = Plan(cuts=((1, 2),), reference_cells=10, cells=(5,), pairs=2)
PICTURED = 8
"""Most scenes whose deposits are drawn."""


@dataclass(frozen=True, kw_only=True)
class Counts:
    """How much is measured."""

    scenes: dict[int, int]
    """Of each kind, by dimension."""
    finer: dict[int, int]
    """Scenes whose reference is computed on finer cells, by dimension."""
    timed: int
    """Scenes of each kind in error over seconds."""
    long: int
    """Scenes of long rollouts, in each dimension."""
    columns: int
    """Columns whose slopes with the angle of friction are compared."""
    seeds: int
    """Jitter seeds of the MPM's gradients."""


def bench(
    out: Path,
    *,
    quick: bool,
    keep: Path,
    model: tuple[Path, ...] = (),
    scenes: int = 40,
    scenes_3d: int = 10,
    finer: int = 4,
    finer_3d: int = 1,
    timed: int = 2,
    long: int = 20,
    columns: int = 10,
    seeds: int = 4,
) -> str:
    """Compare models with the MPM on fine cells, on held-out scenes; hours, most of them for the references.

    Parameters
    ----------
    out
        Folder for gns.md and its pictures.
    quick
        One scene of some kinds on coarse cells, few unknowns and seeds.
    keep
        Folder of runs, scores, times and gradients, which are not measured again.
    model
        A model's file or the name of one that ships, once or more often; all that ship unless given.
    scenes
        Held-out scenes of each kind in 2D.
    scenes_3d
        The same in 3D, whose references are dear.
    finer
        Scenes in 2D whose reference is computed once more on cells half as large, and with another jitter.
    finer_3d
        The same in 3D.
    timed
        Held-out scenes of each kind in error over seconds.
    long
        Scenes in each dimension that are rolled out four times as long.
    columns
        Columns whose slopes with the angle of friction are compared.
    seeds
        Jitter seeds of the MPM's gradients.
    """
    models = load(model)
    flags = "".join(f" --model {path}" for path in model) + (
        f" --scenes {scenes} --scenes-3d {scenes_3d} --finer {finer} --finer-3d {finer_3d}"
        f" --timed {timed} --long {long} --columns {columns} --seeds {seeds}"
    )
    counts = Counts(
        scenes={2: scenes, 3: scenes_3d},
        finer={2: finer, 3: finer_3d},
        timed=timed,
        long=long,
        columns=columns,
        seeds=seeds,
    )
    if quick:
        counts = Counts(scenes={2: 1, 3: 1}, finer={2: 1, 3: 1}, timed=1, long=2, columns=1, seeds=1)
    found = Found(models=models)
    for dimension in (2, 3):
        some = [each for each in models if each.settings.dimension == dimension]
        source = held_out.family(dimension)
        if some and source is not None:
            found = with_dimension(found, dimension, some, source, counts, out, keep, quick=quick)
    if found.prices:
        pictures.draw_prices(out / "gns-price.png", found.prices)
    return page(found, quick=quick, flags="" if quick else flags).write(out / "gns.md")


def with_dimension(
    found: Found,
    dimension: int,
    models: Sequence[Model],
    source: Family,
    counts: Counts,
    out: Path,
    keep: Path,
    *,
    quick: bool,
) -> Found:
    """With all that there is to measure of the models of one dimension; pictures of it are drawn."""
    drawn = held_out.draw(source, counts.scenes[dimension], keep)
    if quick:
        drawn = coarsened(drawn[:QUICK_KINDS], QUICK_CELLS[dimension] * source.cell)
    references = References(keep / source.definition.name, source.storage)
    # Pool first: what is timed runs when its processes are gone.
    with pool(processors()) as workers:
        executor = workers.executor
        scores = accuracy.measure(drawn, models, references, keep, executor.map)
        apart = accuracy.reference_errors(spread_over_kinds(drawn, counts.finer[dimension]), references)
        accurate = Accuracy(scenes=drawn, scores=scores, finer=apart[0], jitter=apart[1])
        still = rest.measure(rest.settled(drawn, references, counts.long), models, keep, executor.map)
        shown = pictured(accurate, models, references, executor.map)
    pictures.draw_errors(out / f"gns-held-out-{dimension}d.png", dimension, accurate)
    pictures.draw_deposits(out / f"gns-deposits-{dimension}d.png", shown)
    timed = spread_over_kinds(drawn, counts.timed * len({each.kind for each in drawn}))
    timed += [] if quick else shipped_scenes(source, dimension)
    cells = price.CELLS[dimension][: 3 if quick else None]
    prices = price.measure(timed, models, references, keep, cells)
    found = dataclasses.replace(
        found,
        accuracy={**found.accuracy, dimension: accurate},
        prices={**found.prices, dimension: prices},
        rest={**found.rest, dimension: still},
        coverages={
            **found.coverages,
            **calibration.coverages(accurate, models, keep, calibration.shipped_bands()),
        },
    )
    if dimension == 3:
        return found
    gradients = velocities.measure(models, keep, QUICK_PLAN if quick else Plan(pairs=counts.seeds))
    pictures.draw_gradients(out / "gns-gradients.png", gradients)
    chosen = friction.chosen(accurate, counts.columns)
    return dataclasses.replace(
        found,
        gradients=gradients,
        friction=friction.measure(chosen, models, keep, seeds=counts.seeds) if chosen else {},
        warnings={each.name: calibration.warnings(each, drawn) for each in models},
    )


def coarsened(scenes: Sequence[HeldOut], cell: float) -> list[HeldOut]:
    """The scenes on cells of at most that edge [m]."""
    return [
        dataclasses.replace(each, scene=on_cell(each.scene, fitted_cell(each.scene.domain, cell))) for each in scenes
    ]


def shipped_scenes(source: Family, dimension: int) -> list[HeldOut]:
    """The paper's columns or flows against baffles, on the cells of the references and with as few frames."""
    names = SHIPPED_3D if dimension == 3 else [f"column-{each.name}" for each in read_paper().scenarios]
    fewer = [dataclasses.replace(read_scene(name), frame_dt=FRAME_DT) for name in names]
    return coarsened(
        [HeldOut(kind=name, number=0, scene=scene) for name, scene in zip(names, fewer, strict=True)], source.cell
    )


def pictured(found: Accuracy, models: Sequence[Model], references: References, map_tasks: Map) -> list[Pictured]:
    """The first scene of every kind whose front is free, with its deposits."""
    scores = found.scores[models[0].name]
    free = [each for each, score in zip(found.scenes, scores, strict=True) if not score.at_wall]
    chosen = [next(each for each in free if each.kind == kind) for kind in dict.fromkeys(each.kind for each in free)]
    chosen = chosen[:PICTURED] or list(found.scenes[:1])
    truths = references([each.scene for each in chosen])
    shown = []
    for each, truth in zip(chosen, truths, strict=True):
        rollouts = map_tasks(roll_out, [RolloutTask(model=model.path, scene=each.scene) for model in models])
        shown.append(
            Pictured(
                name=each.name,
                truth=truth,
                rollouts={model.name: rollout for model, rollout in zip(models, rollouts, strict=True)},
            )
        )
    return shown
