"""What a forecast leaves: `forecast.json`, `report.md`, a picture, in 3D maps of probability."""

from pathlib import Path

import numpy as np
from tabulate import tabulate

from datasets.files import write_json, write_text
from validation.forecast.predict import LEVELS, Forecast, quantiles
from validation.plots import BLUE, GREY, LIGHT_BLUE, ORANGE, figure


def save(found: Forecast, folder: Path, command: str) -> None:
    """Write `forecast.json`, `report.md`, `forecast.png` and the maps."""
    from datasets.exchange.rasters import write_raster

    write_json(folder / "forecast.json", found.as_json())
    if (maps := found.maps) is not None:
        for name, values in found.covered.items():
            path = folder / f"probability-{name}.tif"
            write_raster(path, values, maps.cell, maps.corner, maps.crs, f"probability of {name}", "-")
    draw(found, folder / "forecast.png")
    write_text(folder / "report.md", report(found, command))


def summary(found: Forecast) -> list[str]:
    """The forecast in sentences."""
    lines = []
    for name, number in found.as_json()["numbers"].items():
        low, high = number["interval"]
        said = f"{number['median']:.4g} {number['unit']}, 95 %: {low:.4g} to {high:.4g} {number['unit']}"
        lines.append(f"{name.replace('_', ' ')}: {said}")
    lines.append(f"{len(found.draws)} flows with {', '.join(found.names)} drawn from the posterior")
    return [*lines, *found.remarks]


def report(found: Forecast, command: str) -> str:
    """`report.md`."""
    rows = [
        {
            "number": name,
            "median": f"{number['median']:.4g}",
            "50 %": " to ".join(f"{end:.4g}" for end in number["half"]),
            "95 %": " to ".join(f"{end:.4g}" for end in number["interval"]),
            "error of the cells": "-" if number["cells"] is None else f"{number['cells']:.2g}",
            "unit": number["unit"],
        }
        for name, number in found.as_json()["numbers"].items()
    ]
    parts = [
        "# Forecast",
        "\n".join(f"- {line}" for line in summary(found)),
        "![fronts of the flows; profile or map of probability](forecast.png)",
        tabulate(rows, "keys", "pipe", disable_numparse=True),
        f"`{command}`",
    ]
    if found.maps is not None:
        parts.append(f"A cell of `probability-*.tif` is covered by more than {found.maps.threshold:.3g} m.")
    return "\n\n".join(parts) + "\n"


def draw(found: Forecast, path: Path) -> None:
    """The fronts, and the band of the profile or the probability that a cell is covered."""
    low, middle, high = quantiles(found.profiles, LEVELS["interval"])
    with figure(path, columns=2, size=(5.5, 3.4)) as ((left, right),):
        values = found.predicted["front"]
        left.step(values, (np.arange(len(values)) + 1.0) / (len(values) + 1.0), where="post", color=BLUE)
        for end in quantiles(values, LEVELS["interval"])[::2]:
            left.axvline(end, color=GREY, linestyle="--")
        left.set(xlabel="front [m]", ylabel="probability of less", ylim=(0.0, 1.0))
        if found.maps is None:
            right.fill_between(found.stations, low, high, color=LIGHT_BLUE, label="95 % of the flows")
            right.plot(found.stations, middle, color=ORANGE, label="median")
            last = found.stations[np.flatnonzero(high > 0.0)[-1:]]
            right.set(xlabel="x [m]", ylabel="height [m]", xlim=(None, last.item() if len(last) else None))
            right.legend()
        else:
            x, z = (axis + first for axis, first in zip(found.maps.grid.axes, found.maps.corner, strict=True))
            image = right.pcolormesh(
                x, z, found.covered["depth"].T, cmap="YlOrRd", vmin=0.0, vmax=1.0, shading="nearest"
            )
            right.figure.colorbar(image, label="probability that the flow covers it")
            right.set(xlabel="x, easting [m]", ylabel="z, northing [m]", aspect="equal")
