"""`python -m validation.bench gns`: the shipped surrogates against the MPM on fine cells, on held-out scenes."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

import gns
from datasets.errors import InputError
from datasets.flow import measures
from datasets.scene import Scene
from gns.library import model_path, models
from mpm import AT_REST, simulate
from validation.bench.held_out import MOUNDS, SEED, Measured, coarse, creep, deposit_of, held_out, mean, mound, worst
from validation.bench.page import Keep, Out, Row, kept, signed, tables, write_page
from validation.plots import BLUE, INK, ORANGE, figure
from validation.runs import Run, RunStore

SCENES = {2: {"columns2d": 24, "flow2d": 14}, 3: {"baffles3d": 18, "obstacle3d": 4}}
"""Held-out scenes of each family, one of every kind after the other, by dimension; references in 3D are dear."""
CELLS = {2: (7, 10, 14, 20, 28), 3: (3, 5, 7)}
"""Of the coarse MPM, across the smallest side of the body, by dimension."""
LEVEL = 0.95
"""Of the bands."""
JITTERS = 3
"""Of a mound."""


AGAIN = "the MPM, jittered anew"


@dataclass(frozen=True, kw_only=True)
class Compared:
    """One held-out scene by a model and by the MPM."""

    kind: str
    """Of the scene."""
    extent: float
    """Of the reference's deposit [m]."""
    free: bool
    """Whether no wall holds the reference's front."""
    by: Mapping[str, Measured]
    """By method: the model's name, the MPM on coarse cells, a run like the reference jittered anew."""
    band: tuple[float, float] | None
    """Error of the predicted front and half-width of its band [m]; of free fronts at larger x, of models with bands."""


@dataclass(frozen=True, kw_only=True)
class Model:
    """All that was measured of one model on one family of scenes."""

    name: str
    family: str
    compared: Sequence[Compared]

    @property
    def points(self) -> dict[str, tuple[float, float]]:
        """Mean seconds of each method, and the rms over the scenes of the larger error of front and profile."""
        runs = {
            method: [each.by[method] for each in self.compared] for method in self.compared[0].by if method != AGAIN
        }
        return {
            method: (
                float(np.mean([each.seconds for each in some])),
                measures.rms(np.array([max(abs(each.front), each.profile) for each in some])),
            )
            for method, some in runs.items()
        }

    @property
    def held(self) -> list[bool]:
        """Of each front with a band whether it lies within."""
        return [abs(each.band[0]) <= each.band[1] for each in self.compared if each.band]


Mounds = Mapping[str, Mapping[str, Sequence[float]]]
"""Creep of each stable mound from its start on [mm/s], by the MPM and by each model, jitter by jitter."""


def bench(*, out: Out, keep: Keep = None, model: tuple[Path, ...] = ()) -> str:
    """Compare models with the MPM on fine cells; some twenty minutes, most of them for the references.

    Parameters
    ----------
    model
        A model's file or the name of one that ships, once or more often; all that ship unless given.
    """
    paths = {path: gns.load(path).settings.dimension for path in [model_path(each) for each in model] or models()}
    with kept(keep) as folder:
        found = [
            measure(path, family, held_out(family, number), RunStore(folder / family), CELLS[dimension])
            for path, dimension in paths.items()
            for family, number in SCENES[dimension].items()
        ]
    mounds = at_rest([path for path, dimension in paths.items() if dimension == 2])
    draw(out / "gns.png", found)
    flags = "".join(f" --model {path}" for path in model)
    return written(out, found, mounds, flags)


def measure(
    path: Path, family: str, scenes: Sequence[tuple[str, Scene]], store: RunStore, cells: Sequence[int]
) -> Model:
    simulator, fine = gns.load(path), [scene for _, scene in scenes]
    references, again = (
        store.run([Run(scene=replace(each, seed=each.seed + more), record=AT_REST) for each in fine]) for more in (0, 1)
    )
    # Kernels are compiled, or read from their cache, at a first call.
    gns.simulate(fine[0], model=simulator)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    compared = []
    pairs = [*zip(scenes, references, again, strict=True)]
    for (kind, scene), reference, other in tqdm(pairs, desc=f"{family}, deposits", unit="scene"):
        truth = deposit_of(reference)
        flows = {
            f"MPM, {number} cells across": simulate(coarse(scene, number), threads=1, record=AT_REST)
            for number in cells
        }
        flows |= {path.stem: gns.simulate(scene, model=simulator), AGAIN: other}
        compared.append(
            Compared(
                kind=kind,
                extent=truth.extent,
                free=not truth.at_wall,
                by={method: Measured.of_flow(flow, truth) for method, flow in flows.items()},
                band=None if truth.at_wall or truth.side != 1 else band(path, scene, truth.front),
            )
        )
    torch.set_num_threads(threads)
    return Model(name=path.stem, family=family, compared=compared)


def at_rest(models: Sequence[Path]) -> Mounds:
    """The stable mounds by the MPM and by these models."""
    found = {}
    for title in tqdm(MOUNDS if models else (), desc="mounds at rest", unit="mound"):
        scenes = [mound(title, seed) for seed in range(JITTERS)]
        found[title] = {"MPM": [creep(simulate(each), 1.0) for each in scenes]} | {
            path.stem: [creep(gns.simulate(each, model=path), 1.0) for each in scenes] for path in models
        }
    return found


def band(path: Path, scene: Scene, front: float) -> tuple[float, float] | None:
    """See `Compared.band`."""
    try:
        prediction = gns.predict(scene, model=path, level=LEVEL)
    except InputError:
        return None
    return prediction.front - front, prediction.half_width


def mpm_seconds(points: Iterable[tuple[float, float]], error: float) -> float | None:
    """What the MPM takes for an error no larger than `error` [s]; None where no run of it is so good.

    points: see `Model.points`. Interpolated in their logarithms; that of the cheapest where this is good enough.
    """
    points = sorted(points)
    if error >= points[0][1]:
        return points[0][0]
    for (cheap, large), (dear, small) in pairwise(points):
        if small <= error < large:
            share = math.log(error / large) / math.log(small / large)
            return math.exp((1.0 - share) * math.log(cheap) + share * math.log(dear))
    return None


def conclusion(found: Sequence[Model], mounds: Mounds) -> list[str]:
    """Errors, their price, bands, rest."""
    fronts, prices = [], []
    for each in found:
        off, again = ([one.by[method].front for one in each.compared if one.free] for method in (each.name, AGAIN))
        profiles = mean([one.by[each.name].profile for one in each.compared])
        fronts.append(f"{mean(off):.1%}, {mean(again):.1%} and {profiles:.1%} ({each.family})")
        points = each.points
        seconds, error = points.pop(each.name)
        same = mpm_seconds(points.values(), error)
        mpm = "no coarse run" if same is None else f"{same:.2g} s"
        prices.append(f"{seconds:.2g} s and {mpm} ({each.family})")
    sentences = [
        "Mean error of fronts on unseen scenes, scatter of the MPM's fronts, mean error of profiles, over the deposit's"
        f" extent: {'; '.join(fronts)}.",
        f"Time of a prediction, and of the coarse MPM with the same error: {'; '.join(prices)}.",
    ]
    if held := [inside for each in found for inside in each.held]:
        sentences.append(f"The {LEVEL:.0%} bands contain {sum(held)} of {len(held)} fronts.")
    if mounds:
        by_mpm = max(abs(worst(each["MPM"])) for each in mounds.values())
        own = [abs(worst(values)) for each in mounds.values() for name, values in each.items() if name != "MPM"]
        sentences.append(
            f"Stable mounds creep by {min(own):.2g} to {max(own):.2g} mm/s; with the MPM by at most {by_mpm:.2g} mm/s."
        )
    return sentences


def written(out: Path, found: Sequence[Model], mounds: Mounds, flags: str) -> str:
    """Write the page, and return its conclusion."""
    kinds = []
    for each in found:
        names = dict.fromkeys(one.kind for one in each.compared)
        groups = {kind: [one for one in each.compared if one.kind == kind] for kind in names} | {"all": each.compared}
        table = [kind_row(each, kind, group, each.name) for kind, group in groups.items()]
        kinds.append([*table, kind_row(each, AGAIN, each.compared, AGAIN)])
    prices = [
        [
            {each.family: name, "seconds": f"{s:.3g}", "error": f"{error:.1%}"}
            for name, (s, error) in each.points.items()
        ]
        for each in found
    ]
    bands = [
        {
            "model": f"`{each.name}` on {each.family}",
            "fronts in their bands": f"{sum(each.held)} of {len(each.held)}",
            "half-width over the extent": f"{mean([b.band[1] / b.extent for b in each.compared if b.band]):.1%}",
        }
        for each in found
        if each.held
    ]
    creep = [{"mound": title} | {by: f"{worst(v):+.2g}" for by, v in own.items()} for title, own in mounds.items()]
    return write_page(
        out,
        "gns",
        conclusion(found, mounds),
        flags=flags,
        seed=SEED,
        level=LEVEL,
        kinds=tables(kinds),
        prices=tables(prices),
        bands=bands,
        mounds=creep,
    )


def kind_row(model: Model, title: str, group: Sequence[Compared], method: str) -> Row:
    def both(values: Sequence[float]) -> str:
        return f"{mean(values):.1%} ({signed(worst(values))})" if values else "-"

    runs, free = [each.by[method] for each in group], [each.by[method].front for each in group if each.free]
    return {
        f"`{model.name}` on {model.family}": title,
        "scenes, free": f"{len(runs)}, {len(free)}",
        "front": both(free),
        "profile": both([run.profile for run in runs]),
        "height": both([run.height for run in runs]),
        "thickness": both([run.thickness for run in runs]),
    }


def draw(path: Path, found: Sequence[Model]) -> None:
    """Errors of fronts by kind, and errors over seconds; a row of panes for each model."""
    with figure(path, rows=len(found), columns=2, size=(5.6, 3.4)) as axes:
        for (left, right), model in zip(axes, found, strict=True):
            free = [(each.kind, 100.0 * each.by[model.name].front) for each in model.compared if each.free]
            left.plot(*zip(*free, strict=True), "o", color=ORANGE, markersize=4)
            left.axhline(0.0, color=INK, linewidth=0.8)
            left.tick_params("x", rotation=30)
            left.set(title=f"{model.name} on {model.family}", ylabel="front beyond the MPM's [% of the extent]")
            points = model.points
            seconds, error = points.pop(model.name)
            right.loglog(*zip(*((s, 100.0 * each) for s, each in points.values()), strict=True), "o-", color=BLUE)
            right.loglog(seconds, 100.0 * error, "*", ms=11, color=ORANGE, label=model.name)
            right.set(xlabel="seconds on one thread; blue: the MPM", ylabel="error of the deposit [% of its extent]")
            right.legend()
