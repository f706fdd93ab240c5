"""`python -m validation.bench.surrogate --out docs`: the learned simulator on scenes it never saw, beside the MPM."""

import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from datasets.command_line import run
from datasets.errors import InputError
from datasets.files import write_text
from datasets.library import read_scene
from datasets.scene import Scene
from mpm.process import processors
from validation.bench.surrogate import baffles, bounded, columns, layers, pictures, pictures_3d, races, scenes, speed
from validation.bench.surrogate.courses import Comparison
from validation.bench.surrogate.held_out import against_mpm
from validation.bench.surrogate.models import Model, load
from validation.bench.surrogate.report import page
from validation.bench.surrogate.rollouts import Roller, roller

LONG_2D, LONG_3D = "column-tall-21", "baffles-2"
QUICK_ASPECTS, QUICK_ANGLES = (0.5, 2.0), (21.0, 48.0)
PICTURED = ("tall-21", "short-42")
"""The paper's columns whose energies are drawn, before the layers."""


def command(
    *,
    out: Path,
    models: tuple[Path, ...] = (),
    seeds: int = 8,
    rounds: int = 3,
    long: int = 10,
    long_3d: int = 3,
    jobs: int | None = None,
    quick: bool = False,
) -> None:
    """Hold the shipped models against the MPM on held-out scenes; leaves OUT/gns.md and its pictures.

    Parameters
    ----------
    out
        Folder for the page and its pictures.
    models
        The models' files; of the shipped ones those that there are unless given.
    seeds
        Jitter seeds of the MPM, whose scatter stands beside the errors; half as many in 3D.
    rounds
        How often the tall column is timed, in turn with the MPM.
    long
        Seconds of flow of the long rollout in 2D; none with 0.
    long_3d
        Seconds of flow of the long rollout in 3D; none with 0.
    jobs
        Processes that roll out side by side where nothing is timed; one per processor unless given.
    quick
        A few scenes only, two seeds, one round, no long rollouts: a trial.
    """
    began = time.perf_counter()
    asked = {"--seeds": (seeds, 1), "--rounds": (rounds, 1), "--long": (long, 0), "--long-3d": (long_3d, 0)}
    for key, (value, least) in (asked | ({} if jobs is None else {"--jobs": (jobs, 1)})).items():
        if value < least:
            raise InputError(f"expected at least {least}, got {value}", key=key)
    if quick:
        seeds, rounds, long, long_3d = min(seeds, 2), 1, 0, 0
    chosen, missing = load(models)
    flat, solid = ([model for model in chosen if model.settings.dimension == dimension] for dimension in (2, 3))
    sections, every_column = list[list[str]](), list[str]()
    with roller(processors() if jobs is None else jobs) as roll_all:
        if flat:
            found = held_out_columns(flat, seeds, roll_all, quick=quick)
            sections += held_out_2d(flat, found, seeds, roll_all, out, quick=quick)
            every_column = columns.everything(found)
        if solid:
            sections.append(held_out_3d(solid, max(1, seeds // 2), roll_all, out, quick=quick))
        lasting = long_scenes(flat, solid, long, long_3d)
        if lasting:
            sections.append(bounded.text(bounded.measure(lasting, chosen, roll_all)))
    sections.append(timed(flat, solid, rounds, quick=quick))
    options = " ".join(
        [
            "python -m validation.bench.surrogate",
            *(f"--models {model.path}" for model in chosen if models),
            *(["--quick"] if quick else []),
        ]
    )
    text = page(chosen, missing, [*sections, every_column], options, time.perf_counter() - began)
    write_text(out / "gns.md", text)
    print(f"{out / 'gns.md'}: {len(chosen)} models, {time.perf_counter() - began:.0f} s")


def held_out_columns(flat: Sequence[Model], seeds: int, roll_all: Roller, *, quick: bool) -> columns.Found:
    """The columns by the MPM and by every model."""
    wanted = scenes.columns(aspects=QUICK_ASPECTS, angles=QUICK_ANGLES) if quick else scenes.columns()
    return against_mpm({column: column.scene for column in wanted}, flat, seeds, roll_all, "columns")


def held_out_2d(
    flat: Sequence[Model], found: columns.Found, seeds: int, roll_all: Roller, out: Path, *, quick: bool
) -> list[list[str]]:
    """The sections about columns and about layers, and their pictures."""
    layered = scenes.layers()
    if quick:
        layered = dict(list(layered.items())[:1])
    flows = against_mpm(layered, flat, seeds, roll_all, "layers")
    pictures.draw_fronts(out / "gns-front.png", found)
    papers = {name: found[column] for name, column in scenes.paper_columns().items() if column in found}
    pictures.draw_profiles(out / "gns-profiles.png", papers)
    drawn = {name: papers[name] for name in PICTURED if name in papers}
    energies: Mapping[str, Sequence[Comparison]] = drawn | {f"layers, {name}": flows[name] for name in list(flows)[:1]}
    pictures.draw_energies(out / "gns-energy.png", energies)
    return [columns.text(found, seeds), layers.text(flows, seeds)]


def held_out_3d(solid: Sequence[Model], seeds: int, roll_all: Roller, out: Path, *, quick: bool) -> list[str]:
    """Flows against baffles."""
    names = scenes.BAFFLES[:1] if quick else scenes.BAFFLES
    found = against_mpm({name: read_scene(name) for name in names}, solid, seeds, roll_all, "baffles")
    pictures_3d.draw_maps(out / "gns-baffles.png", found)
    pictures_3d.draw_times(out / "gns-baffles-time.png", found)
    return baffles.text(found)


def long_scenes(flat: Sequence[Model], solid: Sequence[Model], long: int, long_3d: int) -> dict[str, Scene]:
    """What is rolled out for long."""
    wanted = [(LONG_2D, long, flat), (LONG_3D, long_3d, solid)]
    return {name: bounded.prolonged(read_scene(name), duration) for name, duration, some in wanted if some and duration}


def timed(flat: Sequence[Model], solid: Sequence[Model], rounds: int, *, quick: bool) -> list[str]:
    """Seconds against the MPM's."""
    second = races.whole_second(flat, rounds) if flat else None
    run_2d = races.races_2d(flat, races.CELLS[:3] if quick else races.CELLS) if flat else []
    run_3d = races.races_3d(solid, scenes.BAFFLES[:1] if quick else scenes.BAFFLES) if solid else []
    return speed.text(second, [*run_2d, *run_3d], [*flat, *solid], rounds)


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.bench.surrogate"))
