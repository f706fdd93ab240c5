"""A forecast, from the files of a result to its own: `forecast.json`, `report.md`, a picture, and in 3D maps."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from datasets.errors import InputError, require
from datasets.exchange.rasters import write_raster
from datasets.files import write_json, write_text
from datasets.markdown import markdown_table
from datasets.scene import Scene
from datasets.scene.library import read_scene
from inverse.forward import Simulate
from inverse.saving import known_of
from mpm import simulate_many
from validation.forecast.predict import LEVELS, Forecast, predicted, quantiles, with_peaks
from validation.plots import BLUE, GREY, LIGHT_BLUE, ORANGE, figure
from validation.run_store import RunStore, kept

DRAWS = 40  # draws from the posterior: the smallest and the largest of so many flows bound a 95 % interval
MOST_DRAWS = 10_000
ON_MAP = 1.0e4  # fronts [m] from here on are eastings, which four digits would not distinguish


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
    """Forecast `scene` with the posterior in `result`.

    >>> from validation import forecast_scene
    >>> found = forecast_scene("out/loop", "other-slope.toml", "out/forecast")
    >>> found.as_json()["numbers"]["front"]["interval"]

    result: the folder of `validation.loop` or `inverse`, or its `posterior.npz`; scene: one built in Python, a path or
    a shipped name. out: folder for `forecast.json`, `report.md`, pictures, in 3D maps, and every flow; an interrupted
    call resumes there. Without it nothing is written. threshold: thickness [m] above which a cell counts as covered, as
    in `datasets.maps`; pressure: rho v^2 [Pa] above which it counts as hit. simulate: replaces the MPM. Raises
    InputError, and WorkFailed if a run blows up or another process writes into `out`.
    """
    require(1 < draws <= MOST_DRAWS, "--draws", f"an integer from 2 to {MOST_DRAWS}", draws)
    require(0.0 <= model_error < 1.0, "--model-error", "a share in [0, 1)", f"{model_error:g}")
    require(pressure is None or pressure > 0.0, "--pressure", "a pressure above 0 Pa", pressure)
    asked = scene if isinstance(scene, Scene) else read_scene(scene)
    if asked.dimension == 2 and (threshold is not None or pressure is not None):
        key = "--threshold" if threshold is not None else "--pressure"
        raise InputError("expected a scene in 3D, a flow in 2D has no maps", key=key)
    densities = {asked.material_of(mass).density for mass in asked.masses}
    require(pressure is None or len(densities) == 1, "--pressure", "masses of one density", sorted(densities))
    names, samples, remarks = known_of(Path(result), asked)
    if draws < DRAWS - 1:
        remarks.append(f"{draws} flows enclose a further one in {100.0 * (draws - 1) / (draws + 1):.0f} % of the cases")
    options: dict[str, Any] = {"draws": draws, "model_error": model_error, "remarks": remarks}
    with kept(out) as folder:
        # A stored run keeps only its peaks, which depend on the threshold that defines covered cells.
        place = "mpm" if threshold is None else f"mpm-{threshold:g}"
        store = RunStore(folder / place, simulate, label="forecast-", reduce=partial(with_peaks, threshold=threshold))
        forecast = predicted(asked, names, samples, store, threshold=threshold, pressure=pressure, **options)
        if out is None:
            return forecast
        write_json(folder / "forecast.json", forecast.as_json())
        if (maps := forecast.maps) is not None:
            for name, values in forecast.covered.items():
                path = folder / f"probability-{name}.tif"
                write_raster(path, values, maps.cell, maps.corner, maps.crs, f"probability of {name}", "-")
        draw(forecast, folder / "forecast.png")
        command = f"python -m validation.forecast {result} {scene} --out {out}"
        write_text(folder / "report.md", report(forecast, command))
    return forecast


def worded(name: str, value: float) -> str:
    """A number of a forecast as text; a front in map coordinates to a decimetre."""
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
    """Plot the fronts, and the band of the profile or the probability that a cell is covered."""
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
