"""`python -m validation.bench surrogate`: the shipped weights against the MPM on held-out scenes."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

from datasets.library import read_scene
from datasets.scene import Scene
from mpm.generate import pool
from mpm.process import processors
from validation.bench.surrogate import long_rollouts, pictures, scenes, speed
from validation.bench.surrogate.comparison import Map, compare_all
from validation.bench.surrogate.page import Columns, Measured, Scenes, page
from validation.bench.surrogate.rollouts import ShippedModel, load

LONG = {"column-tall-21": 10.0, "baffles-2": 3.0}
"""Seconds of flow of the long rollouts."""
QUICK_ASPECTS, QUICK_ANGLES = (0.5, 2.0), (21.0, 48.0)
SEEDS, ROUNDS = 8, 3
PICTURED = ("tall-21", "short-42")
"""The paper's columns whose energies are drawn, before the layers."""


def bench(out: Path, *, quick: bool, keep: Path, models: tuple[Path, ...] = ()) -> str:
    """Compare models with the MPM on held-out scenes; about five minutes.

    Parameters
    ----------
    out
        Folder for gns.md and its pictures.
    quick
        A few scenes, two seeds, one round, no long rollouts.
    keep
        Not used: nothing is kept.
    models
        Files of models; those that ship unless given.
    """
    chosen = load(models)
    with pool(processors()) as (executor, _):
        found = measured(chosen, executor.map, quick=quick)
    flat, solid = of_dimension(chosen, 2), of_dimension(chosen, 3)
    found = dataclasses.replace(
        found,
        seconds=speed.whole_seconds(flat, 1 if quick else ROUNDS) if flat else (),
        runs=[
            *(speed.runs_2d(flat, quick=quick) if flat else ()),
            *(speed.runs_3d(solid, quick=quick) if solid else ()),
        ],
    )
    draw(out, found)
    return page(found, quick=quick).write(out / "gns.md")


def of_dimension(models: list[ShippedModel], dimension: int) -> list[ShippedModel]:
    """The models of 2D or 3D."""
    return [model for model in models if model.settings.dimension == dimension]


def measured(models: list[ShippedModel], map_tasks: Map, *, quick: bool) -> Measured:
    """All but the times."""
    seeds = 2 if quick else SEEDS
    flat, solid = of_dimension(models, 2), of_dimension(models, 3)
    columns: Columns = {}
    layers: Scenes = {}
    baffles: Scenes = {}
    if flat:
        chosen = scenes.columns(QUICK_ASPECTS, QUICK_ANGLES) if quick else scenes.columns()
        columns = compare_all({each: each.scene for each in chosen}, flat, seeds, map_tasks, "columns")
        layers = compare_all(first(scenes.layers(), quick), flat, seeds, map_tasks, "layers")
    if solid:
        named = {name: read_scene(name) for name in scenes.BAFFLES}
        baffles = compare_all(first(named, quick), solid, max(1, seeds // 2), map_tasks, "baffles")
    long = {name: dataclasses.replace(read_scene(name), duration=duration) for name, duration in LONG.items()}
    return Measured(
        models=models,
        seeds=seeds,
        columns=columns,
        layers=layers,
        baffles=baffles,
        long=() if quick else long_rollouts.measure(long, models, map_tasks),
        seconds=(),
        runs=(),
    )


def first(found: Mapping[str, Scene], quick: bool) -> dict[str, Scene]:
    """The first scene alone with `quick`."""
    return dict(list(found.items())[: 1 if quick else None])


def draw(out: Path, found: Measured) -> None:
    """All pictures of what there is."""
    if found.columns:
        papers = {name: found.columns[each] for name, each in scenes.paper_columns().items() if each in found.columns}
        layers = {f"layers, {name}": group for name, group in list(found.layers.items())[:1]}
        pictures.draw_fronts(out / "gns-front.png", found.columns)
        if papers:
            pictures.draw_profiles(out / "gns-profiles.png", papers)
        energies = {name: papers[name] for name in PICTURED if name in papers} | layers
        pictures.draw_energies(out / "gns-energy.png", energies)
    if found.baffles:
        pictures.draw_maps(out / "gns-baffles.png", found.baffles)
        pictures.draw_times(out / "gns-baffles-time.png", found.baffles)
