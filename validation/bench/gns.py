"""`python -m validation.bench gns`: the shipped surrogates against the MPM on fine cells, on held-out scenes.

The scenes come from the definitions of the training data with another seed, so that they share no random numbers.
Variants of other scenes are left out.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

import gns
from datasets.definitions import read_definition
from datasets.errors import InputError
from datasets.flow import measures
from datasets.flow.measures import AFTER, Errors, summary
from datasets.flow.trajectory import Trajectory
from datasets.scene import Domain, Scene
from datasets.scene.library import read_scene
from gns.library import model_path, models
from mpm import AT_REST, simulate
from mpm.resolution import ROUNDING, characteristic_length, fitted_cell
from validation.bench.accuracy.bench import deposit_of
from validation.bench.page import Keep, Out, Row, between, tables, write_page
from validation.plots import BLUE, INK, ORANGE, figure
from validation.run_store import Run, RunStore, kept

SEED = 1  # of the held-out scenes; the training data have 0
SCENES = {2: {"columns2d": 24, "flow2d": 14}, 3: {"baffles3d": 18, "obstacle3d": 4, "terrain3d": 6}}
"""Held-out scenes of each family, one of every kind after the other, by dimension; references in 3D are expensive."""
CELLS = {2: (7, 10, 14, 20, 28), 3: (3, 5, 7)}
"""Cells of the coarse MPM across the smallest side of the body, by dimension."""
LEVEL = 0.95  # probability of the bands
TIMES = (2, 3)  # for flows on terrain, a few cells thick: coarse cells over those of the reference
AGAIN = "the MPM, jittered anew"
MOUNDS = ((45.0, 12.0), (42.0, 8.0), (35.0, 0.0), (28.0, 0.0))
"""Friction angle and floor angle [deg] at which a mound is stable."""
JITTERS = 3  # number of jitters of a mound


@dataclass(frozen=True, kw_only=True)
class Compared:
    """One held-out scene, computed by a model and by the MPM."""

    kind: str  # of the scene
    extent: float  # of the reference's deposit [m]
    free: bool  # whether no wall stops the reference's front
    by: Mapping[str, Errors]
    """Method -> errors: the model, the MPM on coarse cells, a run like the reference with another jitter."""
    seconds: Mapping[str, float]  # by method: on one thread, without compilation and without loading a model
    band: tuple[float, float] | None
    """Error of the predicted front and half-width of its band [m]; for free fronts at larger x, models with bands."""


@dataclass(frozen=True, kw_only=True)
class ModelErrors:
    """All measurements of one model on one family of scenes."""

    name: str
    family: str
    compared: Sequence[Compared]

    @property
    def points(self) -> dict[str, tuple[float, float]]:
        """Mean seconds of each method, and the rms over the scenes of the larger error of front and profile."""
        by_method = {}
        for method in [method for method in self.compared[0].by if method != AGAIN]:
            seconds, errors = zip(*((case.seconds[method], case.by[method]) for case in self.compared), strict=True)
            larger = np.array([max(abs(error.front), error.profile) for error in errors])
            by_method[method] = float(np.mean(seconds)), measures.rms(larger)
        return by_method

    @property
    def held(self) -> list[bool]:
        """Whether each front with a band lies within it."""
        return [abs(case.band[0]) <= case.band[1] for case in self.compared if case.band]


Mounds = Mapping[tuple[float, float], Mapping[str, float]]
"""Initial creep of each of the `MOUNDS` [mm/s], the worst of its jitters, by the MPM and by each model."""


def bench(*, out: Out, keep: Keep = None, model: tuple[Path, ...] = ()) -> str:
    """Compare models with the MPM on fine cells, in about fifteen minutes on two cores, mostly for the references.

    Args:
        model: File of a model or name of a shipped one, once or several times; default: all shipped models.
    """
    paths = {path: gns.load(path).settings.dimension for path in [model_path(file) for file in model] or models()}
    with kept(keep) as folder:
        measured = [
            measure(path, family, number, RunStore(folder / family))
            for path, dimension in paths.items()
            for family, number in SCENES[dimension].items()
        ]
    mounds = at_rest([path for path, dimension in paths.items() if dimension == 2])
    draw(out / "gns.png", measured)
    bands = [
        {
            "model": f"`{errors.name}` on {errors.family}",
            "fronts in their bands": f"{sum(errors.held)} of {len(errors.held)}",
            "half-width over the extent": f"{mean([b.band[1] / b.extent for b in errors.compared if b.band]):.1%}",
        }
        for errors in measured
        if errors.held
    ]
    return write_page(
        out,
        "gns",
        conclusion(measured, mounds),
        flags="".join(f" --model {path}" for path in model),
        seed=SEED,
        level=LEVEL,
        jitters=JITTERS,
        kinds=tables(kind_rows(errors) for errors in measured),
        prices=tables(
            [
                {errors.family: name, "seconds": f"{s:.3g}", "error": f"{e:.1%}"}
                for name, (s, e) in errors.points.items()
            ]
            for errors in measured
        ),
        bands=bands,
        mounds=[
            {"mound": f"{friction:g}° on {slope:g}°"} | {name: f"{speed:+.2g}" for name, speed in by.items()}
            for (friction, slope), by in mounds.items()
        ],
    )


def measure(path: Path, family: str, number: int, store: RunStore) -> ModelErrors:
    """Errors of a model on `number` scenes of a family."""
    simulator, scenes = gns.load(path), held_out(family, number)
    fine = [scene for _, scene in scenes]
    references, again = (
        store.run([Run(scene=replace(scene, seed=scene.seed + more), record=AT_REST) for scene in fine])
        for more in (0, 1)
    )
    # The first call compiles kernels, or reads them from their cache.
    gns.simulate(fine[0], model=simulator)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    compared = []
    pairs = [*zip(scenes, references, again, strict=True)]
    for (kind, scene), reference, other in tqdm(pairs, desc=f"{family}, deposits", unit="scene"):
        truth = deposit_of(reference)
        flows = {name: simulate(other, threads=1, record=AT_REST) for name, other in coarser(scene, family).items()}
        flows |= {path.stem: gns.simulate(scene, model=simulator), AGAIN: other}
        by = {method: truth.errors(flow.positions[-1], flow.volumes) for method, flow in flows.items()}
        if reference.summary["rest_time"] is not None:
            longer = gns.simulate(replace(scene, duration=AFTER * scene.duration), model=simulator)
            by[path.stem] = replace(by[path.stem], creep=measures.creep(longer.positions, longer.frame_dt))
        seconds = {method: flow.summary["wall_s"] for method, flow in flows.items()}
        free = not truth.at_wall
        ends = band(path, scene, truth.front) if free and truth.side == 1 else None
        compared.append(Compared(kind=kind, extent=truth.extent, free=free, by=by, seconds=seconds, band=ends))
    torch.set_num_threads(threads)
    return ModelErrors(name=path.stem, family=family, compared=compared)


def at_rest(models: Sequence[Path]) -> Mounds:
    """The stable mounds by the MPM and by these models; none without models."""
    ways: dict[str, Callable[[Scene], Trajectory]] = {"MPM": simulate}
    ways |= {path.stem: partial(gns.simulate, model=gns.load(path)) for path in models}
    mounds = {}
    for friction_deg, slope_deg in tqdm(MOUNDS if models else (), desc="mounds at rest", unit="mound"):
        scenes = [mound(friction_deg, slope_deg, seed) for seed in range(JITTERS)]
        by = {name: max((creep(run(scene)) for scene in scenes), key=abs) for name, run in ways.items()}
        mounds[friction_deg, slope_deg] = by
    return mounds


def band(path: Path, scene: Scene, front: float) -> tuple[float, float] | None:
    try:
        prediction = gns.predict(scene, model=path, level=LEVEL)
    except InputError:
        return None
    return prediction.front - front, prediction.half_width


def conclusion(measured: Sequence[ModelErrors], mounds: Mounds) -> list[str]:
    fronts, prices = [], []
    for model in measured:
        off, again = ([one.by[method].front for one in model.compared if one.free] for method in (model.name, AGAIN))
        profiles = mean([one.by[model.name].profile for one in model.compared])
        fronts.append(f"{mean(off):.1%}, {mean(again):.1%} and {profiles:.1%} ({model.family})")
        points = model.points
        seconds, error = points.pop(model.name)
        as_good = [price for price, coarse in points.values() if coarse <= error]
        mpm = f"{min(as_good):.2g} s" if as_good else "no coarse run"
        prices.append(f"{seconds:.2g} s and {mpm} ({model.family})")
    sentences = [
        "Mean error of fronts on unseen scenes, scatter of the MPM's fronts, mean error of profiles, over the deposit's"
        f" extent: {'; '.join(fronts)}.",
        f"Time of a prediction, and of the cheapest coarse MPM with no larger error: {'; '.join(prices)}.",
    ]
    if held := [inside for model in measured for inside in model.held]:
        sentences.append(f"The {LEVEL:.0%} bands contain {sum(held)} of {len(held)} fronts.")
    if mounds:
        by_mpm = max(abs(by["MPM"]) for by in mounds.values())
        creeps = between([abs(speed) for by in mounds.values() for name, speed in by.items() if name != "MPM"], ".2g")
        sentences.append(f"Mounds that stand creep by {creeps} mm/s; with the MPM by at most {by_mpm:.2g} mm/s.")
    return sentences


def kind_rows(model: ModelErrors) -> list[Row]:
    """Errors by kind of scene, of all scenes, and of the MPM with another jitter."""
    names, every = dict.fromkeys(case.kind for case in model.compared), model.compared
    groups = [(kind, model.name, [case for case in every if case.kind == kind]) for kind in names]
    rows: list[Row] = []
    for title, method, group in (*groups, ("all", model.name, every), (AGAIN, AGAIN, every)):
        errors = [case.by[method] if case.free else replace(case.by[method], front=math.nan) for case in group]
        counts = f"{len(group)}, {sum(case.free for case in group)}"
        rows.append({f"`{model.name}` on {model.family}": title, "scenes, free": counts} | summary(errors))
    return rows


def draw(path: Path, measured: Sequence[ModelErrors]) -> None:
    with figure(path, rows=len(measured), columns=2, size=(5.6, 3.4)) as axes:
        for (left, right), model in zip(axes, measured, strict=True):
            free = [(case.kind, 100.0 * case.by[model.name].front) for case in model.compared if case.free]
            left.plot(*zip(*free, strict=True), "o", color=ORANGE, markersize=4)
            left.axhline(0.0, color=INK, linewidth=0.8)
            left.tick_params("x", rotation=30)
            left.set(title=f"{model.name} on {model.family}", ylabel="front beyond the MPM's [% of the extent]")
            points = model.points
            seconds, error = points.pop(model.name)
            right.loglog(*zip(*((s, 100.0 * off) for s, off in points.values()), strict=True), "o-", color=BLUE)
            right.loglog(seconds, 100.0 * error, "*", ms=11, color=ORANGE, label=model.name)
            right.set(xlabel="seconds on one thread; blue: the MPM", ylabel="error of the deposit [% of its extent]")
            right.legend()


def held_out(family: str, number: int) -> list[tuple[str, Scene]]:
    """`number` scenes outside the training data, with their kinds: the first of every kind, then the second, ..."""
    definition = read_definition(family)
    kinds = definition.kinds
    by_kind: dict[str, list[tuple[str, Scene]]] = {kind: [] for kind in kinds}
    rounds, streams = math.ceil(number / len(by_kind)), set[int]()
    for index in count():
        if all(len(scenes) == rounds for scenes in by_kind.values()):
            break
        kind, stream = kinds[index % len(kinds)], definition.stream(index)
        if stream not in streams and len(by_kind[kind]) < rounds:
            streams.add(stream)
            by_kind[kind].append((kind, definition.draw(np.random.default_rng([SEED, stream]), index)))
    return [pair for group in zip(*by_kind.values(), strict=True) for pair in group][:number]


def coarser(scene: Scene, family: str) -> dict[str, Scene]:
    """The scenes of the coarse MPM by the names of their rows."""
    if family == "terrain3d":
        return {f"MPM, cells {times} times as large": coarse(scene, times * scene.domain.cell) for times in TIMES}
    length = characteristic_length(scene)
    return {f"MPM, {cells} cells across": coarse(scene, length / cells) for cells in CELLS[scene.dimension]}


def coarse(scene: Scene, wanted: float) -> Scene:
    """A scene on cells of `wanted` [m], or a little smaller. If necessary its box becomes higher by part of a cell:
    else its height, a whole number of fine cells, would determine which coarser cells fit."""
    length, height, *width = scene.domain.size
    cell = fitted_cell(replace(scene.domain, size=(length, length, *width)), wanted)
    domain = Domain(size=(length, math.ceil(height / cell - ROUNDING) * cell, *width), cell=cell)
    return replace(scene, domain=domain, particles_per_axis=2, step_fraction=0.9)


def mound(friction_deg: float, slope_deg: float, seed: int) -> Scene:
    """The mound of `mound.toml`, stable if it is less steep than its friction angle."""
    scene = read_scene(Path(__file__).with_name("mound.toml")).with_friction_deg(friction_deg)
    return replace(scene, slope_deg=slope_deg, seed=seed)


def creep(flow: Trajectory) -> float:
    """Mean speed of the faster of a deposit's ends, outwards [mm/s]."""
    old, new = (measures.ends(flow.positions[frame], flow.volumes) for frame in (0, -1))
    return 1000.0 * max(old[0] - new[0], new[1] - old[1], key=abs) / float(flow.time[-1] - flow.time[0])


def mean(values: Sequence[float]) -> float:
    """Mean of the absolute values; nan without any."""
    return float(np.mean(np.abs(values))) if values else math.nan
