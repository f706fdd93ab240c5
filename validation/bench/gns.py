"""`python -m validation.bench gns`: the shipped surrogates against the MPM on fine cells, on held-out scenes."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from matplotlib.axes import Axes
from tqdm import tqdm

import gns
from datasets.errors import InputError
from datasets.scene import Scene
from gns import card
from gns.library import model_path, models
from mpm import AT_REST, simulate
from validation.bench.held_out import MOUNDS, SEED, Measured, coarse, creep, deposit_of, held_out, mean, mound, worst
from validation.report.page import GNS, MPM, Page, Row, rms, signed
from validation.report.plots import BLUE, INK, ORANGE, figure
from validation.runs import Run, RunStore

SCENES = {2: {"columns2d": 24, "flow2d": 14}, 3: {"baffles3d": 18, "obstacle3d": 4}}
"""Held-out scenes of each family, one of every kind after the other, by dimension; references in 3D are dear."""
CELLS = {2: (7, 10, 14, 20, 28), 3: (3, 5, 7)}
"""Of the coarse MPM, across the smallest side of the body, by dimension."""
QUICK_CELLS = {2: 10, 3: 4}
"""Of the reference with `--quick`."""
LEVEL = 0.95
"""Of the bands."""
TIMES = 4
"""How many times as long as its scene a rollout is whose deposit should rest."""
LONG = 4
"""How many scenes are."""
JITTERS = 3
"""Of a mound."""
ALL, AGAIN = "all", "the MPM, jittered anew"


@dataclass(frozen=True, kw_only=True)
class Compared:
    """One held-out scene by a model and by the coarse MPM."""

    kind: str
    """Of the scene."""
    extent: float
    """Of the reference's deposit [m]."""
    free: bool
    """Whether no wall holds the reference's front."""
    rollout: Measured
    mpm: Mapping[int, Measured]
    """Coarse runs, by their cells across the body."""
    band: tuple[float, float] | None
    """Error of the predicted front and half-width of its band [m]; of free fronts at larger x, of models with bands."""
    warned: bool
    """Whether the card warns of the scene."""
    jittered: Measured
    """A run like the reference, jittered anew."""


@dataclass(frozen=True, kw_only=True)
class Model:
    """All that was measured of one model on one family of scenes."""

    name: str
    family: str
    compared: Sequence[Compared]
    creeps: Sequence[float]
    """Of rollouts `TIMES` times as long as the first scenes whose reference comes to rest [mm/s]."""

    def of_kind(self, kind: str) -> list[Compared]:
        return [each for each in self.compared if kind in (ALL, each.kind)]

    @property
    def points(self) -> dict[int, tuple[float, float]]:
        """`point` of the coarse MPM, by its cells across the body."""
        return {cells: point([each.mpm[cells] for each in self.compared]) for cells in self.compared[0].mpm}

    @property
    def own(self) -> tuple[float, float]:
        """`point` of its rollouts."""
        return point([each.rollout for each in self.compared])

    @property
    def held(self) -> list[bool]:
        """Of each front with a band whether it lies within."""
        return [abs(each.band[0]) <= each.band[1] for each in self.compared if each.band]


@dataclass(frozen=True, kw_only=True)
class Mound:
    """Creep of a stable mound from its start on, jitter by jitter [mm/s]."""

    title: str
    mpm: Sequence[float]
    models: Mapping[str, Sequence[float]]


def bench(out: Path, *, quick: bool, keep: Path, model: tuple[Path, ...] = ()) -> str:
    """Compare models with the MPM on fine cells; some twenty minutes, most of them for the references.

    Parameters
    ----------
    quick
        Two scenes of each family, on coarse cells.
    model
        A model's file or the name of one that ships, once or more often; all that ship unless given.
    """
    paths = [model_path(each) for each in model] or models()
    found = []
    for path in paths:
        dimension = gns.load(path).settings.dimension
        for family, number in SCENES[dimension].items():
            chosen, cells = held_out(family, 2 if quick else number), CELLS[dimension][: 2 if quick else None]
            if quick:
                chosen = [(kind, coarse(scene, QUICK_CELLS[dimension])) for kind, scene in chosen]
            found.append(measure(path, family, chosen, keep, cells=cells, long=1 if quick else LONG))
    mounds = at_rest([path for path in paths if gns.load(path).settings.dimension == 2], 1 if quick else JITTERS)
    draw(out / "gns.png", found)
    flags = "".join(f" --model {path}" for path in model)
    return page(found, mounds, flags=flags, quick=quick).write(out / "gns.md")


def measure(
    path: Path, family: str, scenes: Sequence[tuple[str, Scene]], keep: Path, *, cells: Sequence[int], long: int
) -> Model:
    simulator = gns.load(path)
    store, fine = RunStore(keep / family), [scene for _, scene in scenes]
    references, again = (
        store.run([Run(scene=replace(each, seed=each.seed + more), record=AT_REST) for each in fine]) for more in (0, 1)
    )
    # Kernels are compiled, or read from their cache, at a first call.
    gns.simulate(scenes[0][1], model=simulator)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    compared = []
    pairs = [*zip(scenes, references, again, strict=True)]
    for (kind, scene), reference, other in tqdm(pairs, desc=f"{family}, deposits", unit="scene"):
        truth = deposit_of(reference)
        free = not truth.at_wall
        compared.append(
            Compared(
                kind=kind,
                extent=truth.extent,
                free=free,
                rollout=Measured.of_flow(gns.simulate(scene, model=simulator), truth),
                mpm={
                    number: Measured.of_flow(
                        simulate(coarse(scene, number), precision="f32", threads=1, record=AT_REST), truth
                    )
                    for number in cells
                },
                band=band(path, scene, truth.front) if free and truth.side == 1 else None,
                warned=card.warning(path, scene) is not None,
                jittered=Measured.of_flow(other, truth),
            )
        )
    torch.set_num_threads(threads)
    resting = [scene for (_, scene), flow, _ in pairs if flow.summary["rest_time"] is not None]
    longer = [replace(each, duration=TIMES * each.duration) for each in resting[:long]]
    creeps = [creep(gns.simulate(each, model=simulator)) for each in tqdm(longer, desc=f"{family}, rest", unit="scene")]
    return Model(name=path.stem, family=family, compared=compared, creeps=creeps)


def at_rest(models: Sequence[Path], jitters: int) -> list[Mound]:
    """The stable mounds by these models and by the MPM."""
    found = []
    for title in tqdm(MOUNDS if models else (), desc="mounds at rest", unit="mound"):
        scenes = [mound(title, seed) for seed in range(jitters)]
        by_model = {path.stem: [creep(gns.simulate(each, model=path), 1.0) for each in scenes] for path in models}
        found.append(Mound(title=title, mpm=[creep(simulate(each), 1.0) for each in scenes], models=by_model))
    return found


def band(path: Path, scene: Scene, front: float) -> tuple[float, float] | None:
    """See `Compared.band`."""
    try:
        prediction = gns.predict(scene, model=path, level=LEVEL)
    except InputError:
        return None
    return prediction.front - front, prediction.half_width


def point(runs: Sequence[Measured]) -> tuple[float, float]:
    """Mean seconds of a method, and the rms over the scenes of the larger error of front and profile."""
    return float(np.mean([each.seconds for each in runs])), rms([max(abs(each.front), each.profile) for each in runs])


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


def conclusion(found: Sequence[Model], mounds: Sequence[Mound]) -> list[str]:
    fronts, prices, heights = [], [], []
    for each in found:
        free = [one for one in each.compared if one.free]
        off, again = [one.rollout.front for one in free], [one.jittered.front for one in free]
        fronts.append(
            f"{each.family} {mean(off):.1%} on average, worst {signed(worst(off))} of {len(off)} (the MPM, jittered "
            f"anew, {mean(again):.1%}), profiles {mean([one.rollout.profile for one in each.compared]):.1%}"
        )
        whole, low = [one.rollout for one in each.compared], [one.rollout.height for one in each.compared]
        heights.append(
            f"{each.family} {signed(float(np.mean(low)))} ({mean(low):.1%} of absolute values), thickness "
            f"{mean([one.thickness for one in whole]):.1%}, {np.mean([one.overlap for one in whole]):.0%} of the plan"
        )
        seconds, error = each.own
        same = mpm_seconds(each.points.values(), error)
        cheaper = "no coarse MPM is as good" if same is None else f"a coarse MPM takes {same:.2g} s for the same error"
        prices.append(f"{each.family} off by {error:.1%} in {seconds:.2g} s, {cheaper}")
    sentences = [
        f"Fronts of held-out scenes, free of walls, over the extent: {'; '.join(fronts)}.",
        f"Mean heights beside the MPM's, thickness over its largest, plan in common: {'; '.join(heights)}.",
        f"One rollout: {'; '.join(prices)}.",
    ]
    if parts := [f"{sum(each.held)} of {len(each.held)} fronts ({each.family})" for each in found if each.held]:
        sentences.append(f"{LEVEL:.0%} bands hold {' and '.join(parts)}.")
    rested = [f"{abs(worst(each.creeps)):.2g} mm/s ({each.family})" for each in found if each.creeps]
    still = [f"Deposits that should rest creep by at most {', '.join(rested)}"] if rested else []
    if mounds:
        own = [abs(worst(values)) for each in mounds for values in each.models.values()]
        by_mpm = max(abs(worst(each.mpm)) for each in mounds)
        still.append(f"stable mounds by {min(own):.2g} to {max(own):.2g} mm/s, in the MPM {by_mpm:.2g}")
    if still:
        sentences.append(f"{'; '.join(still)}.")
    return sentences


def page(found: Sequence[Model], mounds: Sequence[Mound], *, flags: str, quick: bool) -> Page:
    bench = f"gns{flags} --out docs"
    result = Page("The surrogate beside the MPM", bench, conclusion(found, mounds), packages=GNS | MPM, quick=quick)
    result.picture("gns.png", "errors of fronts by kind of scene; error over seconds")
    result.text(f"""
        Scenes drawn by the definitions that draw the training data, with seed {SEED}: of the paper's families
        (columns2d, baffles3d) and of the wide ones (flow2d, obstacle3d). The reference is the MPM on the
        training data's cells, until the deposit rests. Models begin with the scene alone. Their cards, with sizes,
        data and the commands that made them, are beside their weights in `gns/weights`.
    """)
    result.section("Held-out scenes")
    result.text("""
        Front: the end of the deposit that the flow has moved farther, which 99.5 % of the volume is behind;
        without the scenes where the wall ahead holds it. Profile: rms distance along x of equal shares of the two
        deposits. Both over the deposit's extent: mean of the amounts and, in brackets, the worst. Mean height: of the
        volume above the ground, which is the potential energy, relative. Thickness: from the ground to the highest
        particle of a column, rms over the plan, over the reference's largest. Overlap: plan that both deposits cover
        with a tenth of that or more, over what either covers; mean and, in brackets, the least. Last row: a second
        run like the reference, its particles jittered anew; the mean over all jitters would be 0.7 times as far from
        the reference.
    """)
    for each in found:
        kinds = [*dict.fromkeys(one.kind for one in each.compared), ALL]
        of_kinds = [kind_row(each, kind, [(one, one.rollout) for one in each.of_kind(kind)]) for kind in kinds]
        result.table([*of_kinds, kind_row(each, AGAIN, [(one, one.jittered) for one in each.compared])])
    result.section("Error over seconds")
    result.text("""
        The same scenes by the MPM on coarse cells, so many across the smallest side of the body (single precision,
        until the deposit rests), and by the model; one thread, one after the other, without compilation. Error: the
        larger of the front's and the profile's, rms over the scenes.
    """)
    for each in found:
        rows = {f"MPM, {cells} cells across": at for cells, at in each.points.items()} | {f"`{each.name}`": each.own}
        result.table(
            [
                {each.family: name, "seconds": f"{seconds:.3g}", "error": f"{error:.1%}"}
                for name, (seconds, error) in rows.items()
            ]
        )
    result.section("What it knows of itself, and rest")
    result.text(f"""
        Bands of {LEVEL:.0%} (`gns.predict`) on free fronts at larger x. Creep: speed of the faster end of a deposit
        over the second half of a rollout {TIMES} times as long as its scene, of scenes that come to rest in the MPM.
    """)
    result.table([self_row(each) for each in found])
    if mounds:
        result.section("Mounds at rest")
        result.text("""
            Triangles of sand, 0.8 m long and 0.2 m high on a floor of 0.9, under their angle of friction, some on
            floors that are tilted: they stay where they are. Speed of the faster end over the 1.5 s from the start on
            [mm/s], the worst of the jitters.
        """)
        result.table(
            [
                {"mound": each.title, "MPM": f"{worst(each.mpm):+.2g}"}
                | {f"`{name}`": f"{worst(values):+.2g}" for name, values in each.models.items()}
                for each in mounds
            ]
        )
    return result


def kind_row(model: Model, title: str, runs: Sequence[tuple[Compared, Measured]]) -> Row:
    def both(values: Sequence[float]) -> str:
        return f"{mean(values):.1%} ({signed(worst(values))})" if values else "-"

    free = [run.front for each, run in runs if each.free]
    overlaps = [run.overlap for _, run in runs]
    return {
        f"`{model.name}` on {model.family}": title,
        "scenes": len(runs),
        "at the wall": len(runs) - len(free),
        "front": both(free),
        "profile": both([run.profile for _, run in runs]),
        "mean height": both([run.height for _, run in runs]),
        "thickness": both([run.thickness for _, run in runs]),
        "overlap": f"{np.mean(overlaps):.0%} ({min(overlaps):.0%})",
    }


def self_row(model: Model) -> Row:
    widths = [each.band[1] / each.extent for each in model.compared if each.band]
    return {
        "model": f"`{model.name}`",
        "scenes of": model.family,
        "fronts in their bands": f"{sum(model.held)} of {len(model.held)}" if widths else "-",
        "half-width over the extent": f"{mean(widths):.1%}" if widths else "-",
        "warned of, in range": f"{sum(each.warned for each in model.compared)} of {len(model.compared)}",
        "creep, mean [mm/s]": f"{mean(model.creeps):.2f}",
        "worst [mm/s]": f"{worst(model.creeps):+.2f}",
    }


def draw(path: Path, found: Sequence[Model]) -> None:
    """Errors of fronts by kind, and errors over seconds; a row of panes for each model."""
    with figure(path, rows=len(found), columns=2, size=(5.6, 3.4)) as axes:
        for row, each in enumerate(found):
            draw_fronts(axes[row, 0], each)
            draw_price(axes[row, 1], each)


def draw_fronts(axis: Axes, model: Model) -> None:
    kinds = list(dict.fromkeys(each.kind for each in model.compared))
    for index, kind in enumerate(kinds):
        values = 100.0 * np.array([each.rollout.front for each in model.of_kind(kind) if each.free])
        axis.plot(np.full(len(values), index), values, "o", color=ORANGE, markersize=4)
    axis.axhline(0.0, color=INK, linewidth=0.8)
    axis.set_xticks(range(len(kinds)), kinds, rotation=30)
    axis.set_title(f"{model.name} on {model.family}")
    axis.set_ylabel("front beyond the MPM's [% of the extent]")


def draw_price(axis: Axes, model: Model) -> None:
    points, (seconds, error) = model.points, model.own
    x, y = zip(*points.values(), strict=True)
    axis.loglog(x, [100.0 * each for each in y], "o-", color=BLUE, label="MPM")
    for cells, at in points.items():
        axis.annotate(f"{cells} cells", (at[0], 100.0 * at[1]), xytext=(3, 4), textcoords="offset points", fontsize=7)
    axis.loglog(seconds, 100.0 * error, "*", ms=11, color=ORANGE, label=model.name)
    axis.set_xlabel("seconds on one thread")
    axis.set_ylabel("error of the deposit [% of its extent]")
    axis.legend()
