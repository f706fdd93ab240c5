"""A forecast, from the files of a result to its own: `forecast.json`, `report.md`, a picture, in 3D maps."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from datasets.errors import InputError, require
from datasets.files import read_json, write_json, write_text
from datasets.markdown import markdown_table
from datasets.scene import Scene
from datasets.scene.grid_field import Floats
from datasets.scene.library import read_scene
from inverse.forward import Simulate
from inverse.parameters import kind
from inverse.saving import read_samples, require_same_angle
from mpm import simulate_many
from validation.forecast.predict import LEVELS, Forecast, predicted, quantiles
from validation.plots import BLUE, GREY, LIGHT_BLUE, ORANGE, figure
from validation.run_store import RunStore, kept

DRAWS = 40  # of the posterior: the least and the largest of so many flows are the ends of an interval of 95 %
MOST_DRAWS = 10_000
ON_MAP = 1.0e4  # fronts [m] from here on are eastings: four digits would not tell one from another


def forecast_scene(
    result: Path | str,
    scene: Scene | Path | str,
    out: Path | str | None = None,
    *,
    draws: int = DRAWS,
    model_error: float = 0.0,
    threshold: float | None = None,
    pressure: float | None = None,
    simulate: Simulate = simulate_many,
) -> Forecast:
    """What the posterior in `result` predicts of `scene`.

    >>> from validation import forecast_scene
    >>> found = forecast_scene("out/loop", "other-slope.toml", "out/forecast")
    >>> found.as_json()["numbers"]["front"]["interval"]

    result: the folder of `validation.loop` or `inverse`, or its `posterior.npz`; scene: one built in Python, a path or
    a shipped name. out: folder for `forecast.json`, `report.md`, pictures, in 3D maps, and every flow, where an
    interrupted command goes on; without it nothing is written. threshold: thickness [m] above which a cell counts as
    covered, as `datasets.maps`; pressure: rho v^2 [Pa] above which it counts as hit. simulate: in place of the MPM.
    Raises InputError, and WorkFailed where a run blows up or another process writes into `out`.
    """
    require(1 < draws <= MOST_DRAWS, "--draws", f"an integer from 2 to {MOST_DRAWS}", draws)
    require(0.0 <= model_error < 1.0, "--model-error", "a share in [0, 1)", f"{model_error:g}")
    require(pressure is None or pressure > 0.0, "--pressure", "a pressure above 0 Pa", pressure)
    asked = scene if isinstance(scene, Scene) else read_scene(scene)
    if asked.dimension == 2 and (threshold is not None or pressure is not None):
        key = "--threshold" if threshold is not None else "--pressure"
        raise InputError("expected a scene in 3D, a flow in 2D has no maps", key=key)
    names, samples, remarks = known_of(Path(result), asked)
    options: dict[str, Any] = {"draws": draws, "model_error": model_error, "remarks": remarks}
    with kept(out) as folder:
        store = RunStore(folder / "mpm", simulate, label="forecast-")
        forecast = predicted(asked, names, samples, store, threshold=threshold, pressure=pressure, **options)
        if out is not None:
            save(forecast, folder, f"python -m validation.forecast {result} {scene} --out {out}")
    return forecast


def known_of(result: Path, scene: Scene) -> tuple[list[str], Floats, list[str]]:
    """Names and samples [S, U] of the unknowns of a result that a scene has too, and what is to be said of it."""
    path = result if result.suffix == ".npz" else result / "posterior.npz"
    if not path.exists():
        expected = "expected the folder of validation.loop with posterior.npz, of unknown numbers and not of fields"
        raise InputError(expected, where=str(result))
    names, samples = read_samples(path)
    record = read_json(path.parent / "result.json") or {}
    remarks, kept = [], []
    for index, name in enumerate(names):
        try:
            require(name != "time_offset", "", "a number of a scene", "the clock of the observations")
            names[index] = in_scene(name, record.get("solids", []), scene)
            kind(names[index]).check(scene)
        except InputError as error:
            remarks.append(f"{name} is no part of the forecast: {error.message}")
        else:
            kept.append(index)
            if names[index] != name:
                remarks.append(f"{name} of the inversion is {names[index]} of this scene")
    if not kept:
        raise InputError(f"expected a scene with one of {', '.join(names)}: {remarks[0]}", where=str(path))
    require_same_angle(path, [names[index] for index in kept], scene)
    verdict = record.get("verdict")
    if verdict not in (None, "confirmed"):
        remarks.append(f"the answer that is forecast is {verdict}")
    return [names[index] for index in kept], samples[:, kept], remarks


def in_scene(name: str, solids: Sequence[tuple[str | None, str]], scene: Scene) -> str:
    """The name in `scene` of an unknown: that of a solid goes to the one of the same name, else the one of its kind.

    solids: name and kind of each in the inversion. Raises InputError where the scene has none like it.
    """
    number = re.match(r"solids\[(\d+)\]", name)
    if number is None or int(number[1]) >= len(solids):
        return name
    index, (called, form) = int(number[1]), solids[int(number[1])]
    named = [called is not None and solid.name == called for solid in scene.solids]
    for alike in (named, [solid.kind == form for solid in scene.solids]):
        if sum(alike) == 1:
            return f"solids[{alike.index(True)}]{name[number.end() :]}"
    same = index < len(scene.solids) and scene.solids[index].kind == form
    require(same, "", f"a {form} in the scene, as solids[{index}] of the inversion", "none or several")
    return name


def save(forecast: Forecast, folder: Path, command: str) -> None:
    """Write `forecast.json`, `report.md`, `forecast.png` and the maps."""
    from datasets.exchange.rasters import write_raster

    write_json(folder / "forecast.json", forecast.as_json())
    if (maps := forecast.maps) is not None:
        for name, values in forecast.covered.items():
            path = folder / f"probability-{name}.tif"
            write_raster(path, values, maps.cell, maps.corner, maps.crs, f"probability of {name}", "-")
    draw(forecast, folder / "forecast.png")
    write_text(folder / "report.md", report(forecast, command))


def worded(name: str, value: float) -> str:
    """A number of a forecast; the front on a map to a decimetre."""
    return f"{value:.1f}" if name == "front" and abs(value) >= ON_MAP else f"{value:.4g}"


def summary(forecast: Forecast) -> list[str]:
    """The forecast in sentences."""
    lines = []
    for name, number in forecast.as_json()["numbers"].items():
        middle, low, high = (worded(name, end) for end in (number["median"], *number["interval"]))
        said = f"{middle} {number['unit']}, 95 %: {low} to {high} {number['unit']}"
        lines.append(f"{name.replace('_', ' ')}: {said}")
    lines.append(f"{len(forecast.draws)} flows with {', '.join(forecast.names)} drawn from the posterior")
    return [*lines, *forecast.remarks]


def report(forecast: Forecast, command: str) -> str:
    """`report.md`."""
    rows = [
        {
            "number": name,
            "median": worded(name, number["median"]),
            "50 %": " to ".join(worded(name, end) for end in number["half"]),
            "95 %": " to ".join(worded(name, end) for end in number["interval"]),
            "error of the cells": "-" if number["cells"] is None else f"{number['cells']:.2g}",
            "unit": number["unit"],
        }
        for name, number in forecast.as_json()["numbers"].items()
    ]
    lines = "\n".join(f"- {line}" for line in summary(forecast))
    picture = "![fronts of the flows; profile or map of probability](forecast.png)"
    parts = ["# Forecast", lines, picture, markdown_table(rows), f"`{command}`"]
    if forecast.maps is not None:
        parts.append(f"A cell of `probability-*.tif` is covered by more than {forecast.maps.threshold:.3g} m.")
    return "\n\n".join(parts) + "\n"


def draw(forecast: Forecast, path: Path) -> None:
    """The fronts, and the band of the profile or the probability that a cell is covered."""
    low, middle, high = quantiles(forecast.profiles, LEVELS["interval"])
    with figure(path, columns=2, size=(5.5, 3.4)) as ((left, right),):
        values = forecast.predicted["front"]
        left.step(values, (np.arange(len(values)) + 1.0) / (len(values) + 1.0), where="post", color=BLUE)
        for end in quantiles(values, LEVELS["interval"])[::2]:
            left.axvline(end, color=GREY, linestyle="--")
        left.set(xlabel="front [m]", ylabel="probability of less", ylim=(0.0, 1.0))
        if forecast.maps is None:
            right.fill_between(forecast.stations, low, high, color=LIGHT_BLUE, label="95 % of the flows")
            right.plot(forecast.stations, middle, color=ORANGE, label="median")
            last = forecast.stations[np.flatnonzero(high > 0.0)[-1:]]
            right.set(xlabel="x [m]", ylabel="height [m]", xlim=(None, last.item() if len(last) else None))
            right.legend()
        else:
            x, z = (axis + first for axis, first in zip(forecast.maps.grid.axes, forecast.maps.corner, strict=True))
            covered = forecast.covered["depth"].T
            image = right.pcolormesh(x, z, covered, cmap="YlOrRd", vmin=0.0, vmax=1.0, shading="nearest")
            right.figure.colorbar(image, label="probability that the flow covers it")
            right.set(xlabel="x, easting [m]", ylabel="z, northing [m]", aspect="equal")
