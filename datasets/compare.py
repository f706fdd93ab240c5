"""python -m datasets.compare A B --out DIR: compares two flows over time and at their ends.

For example two MPM runs, an MPM run and a surrogate, or two angles. Between two frames a flow is interpolated linearly.
Energies come from the particles, so that they have the same meaning for both:

    E_kin = 1/2 sum_i rho_i V_i |v_i|^2,    E_pot = -sum_i rho_i V_i g . x_i

If all particles of the flow with fewer particles started at places of the other's, the root mean square distance of
these pairs is given too; the distance of the deposits along x needs no pairs (`measures.transport_distance`).
"""

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.command_line import run
from datasets.errors import naming, require
from datasets.files import make_folder, replacing, write_json, write_text
from datasets.flow import measures
from datasets.flow.fields import FlowFields, Values, pairs
from datasets.flow.trajectory import Trajectory, open_trajectory, trajectory_file
from datasets.maps import require_same_place
from datasets.markdown import markdown_table
from datasets.scene.grid_field import Floats

Figures = dict[str, Floats]

MOMENTS = 60  # largest number of compared moments, evenly spaced in time
FIGURES = {"front": "m", "runout": "m", "toe": "m", "height": "m", "kinetic": "J", "potential": "J"}
"""Figures of a flow at a time -> unit, in 2D energies per metre of width. `toe` is its x, `height` the mean height of
the volume above the ground, `kinetic` may be nan."""
APART = {"thickness": "thickness", "equal shares along x": "transport", "same particles": "positions"}
"""Name -> root mean square distance of two flows [m]; nan without common particles."""
OVERLAP = "overlap"
"""A further measure: `measures.overlap` in plan [-]."""


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Two flows at the same times and at their ends."""

    labels: tuple[str, str]
    dimension: int
    time: Floats
    """Of the moments [s], shape [T]: frames of the first flow, up to the end of the second."""
    figures: tuple[Figures, Figures]
    """The `FIGURES` of each flow at these times and then at its own end, shape [T + 1] each."""
    apart: Figures
    """The distances of `APART` and `OVERLAP`, at these times and then of the ends, shape [T + 1] each."""
    ends: tuple[float, float]
    """Time of the end of each flow [s]."""
    stations: Floats
    """Middles of the columns in which the thickness is [m], shape [S]."""
    heights: tuple[Floats, Floats]
    """Thickness of the two deposits [m], shape [S] each; in 3D its mean across the box."""

    def as_json(self) -> dict[str, Any]:
        """The contents of `comparison.json`."""
        every = dict(zip(("a", "b", "difference"), (*self.figures, self.apart), strict=True))
        profile = dict(zip(("x", "a", "b"), (self.stations, *self.heights), strict=True))
        return {
            "runs": list(self.labels),
            "time": self.time.tolist(),
            "series": {name: {key: row[:-1].tolist() for key, row in rows.items()} for name, rows in every.items()},
            "end": {name: {key: float(row[-1]) for key, row in rows.items()} for name, rows in every.items()},
            "end_time": dict(zip("ab", self.ends, strict=True)),
            "profile": {key: values.tolist() for key, values in profile.items()},
        }

    def table(self) -> str:
        """A Markdown table: both flows at their ends, and the distances between them."""
        rows = [["time [s]", *map(spoken, self.ends), f"{self.ends[1] - self.ends[0]:+.3g}"]]
        for key, unit in FIGURES.items():
            name = "mean height" if key == "height" else key if unit == "m" else f"{key} energy"
            per_width = "/m" if unit == "J" and self.dimension == 2 else ""
            one, other = (float(figures[key][-1]) for figures in self.figures)
            rows.append([f"{name} [{unit}{per_width}]", spoken(one), spoken(other), spoken(other - one, "+.3g")])
        rows += [[f"{name}, rms [m]", "", "", spoken(self.apart[key][-1], ".3g")] for name, key in APART.items()]
        rows.append(["overlap in plan [-]", "", "", spoken(self.apart[OVERLAP][-1], ".3g")])
        return markdown_table(rows, ["where they end", *self.labels, "difference"])


def figures_of(flow: FlowFields, values: Values) -> list[float]:
    """The `FIGURES` of a flow whose particles have these fields; NaN if none has entered."""
    here, velocity = values["entered"], values.get("velocity")
    if not here.any():
        return [math.nan] * len(FIGURES)
    positions, volume = values["position"][here].astype(np.float64), flow.trajectory.volumes[here]
    mass = volume * np.array([material.density for material in flow.materials])[flow.material[here]]
    squares = None if velocity is None else np.sum(velocity[here].astype(np.float64) ** 2, axis=1)
    kinetic = math.nan if squares is None else float(0.5 * mass @ squares)
    potential = float(-mass @ (positions @ np.array(flow.trajectory.scene.gravity_vector)))
    raised = measures.above(positions, measures.ground_of(flow.trajectory.scene))
    lengths = (measures.front(positions, volume), measures.runout(positions), measures.toe(positions)[0])
    return [*lengths, measures.mean_height(raised, volume), kinetic, potential]


@dataclass(frozen=True)
class Columns:
    """Columns in which the thickness of several flows is given: two cells wide, or two particles if these are wider."""

    width: float
    """[m]."""
    plan: tuple[float, ...]
    """Horizontal lengths of the box around all flows [m]."""

    @staticmethod
    def of_flows(flows: Sequence[Trajectory]) -> "Columns":
        """Columns that divide the length along x."""
        width = 2.0 * max(max(flow.scene.domain.cell, FlowFields(flow).spacing) for flow in flows)
        plan = tuple(np.max([flow.scene.domain.size[::2] for flow in flows], axis=0).tolist())
        return Columns(plan[0] / max(2, round(plan[0] / width)), plan)

    @property
    def middles(self) -> Floats:
        """Their x [m], shape [S]."""
        return self.width * (np.arange(round(self.plan[0] / self.width), dtype=np.float64) + 0.5)

    def thickness(self, flow: Trajectory, positions: NDArray[Any]) -> Floats:
        """Thickness of a flow with particles at `positions` [m], shape [S], in 3D [S, Z]."""
        raised = measures.above(positions, measures.ground_of(flow.scene))
        return measures.thickness(raised, FlowFields(flow).spacing, self.width, self.plan)


def along(thickness: Floats) -> Floats:
    """The thickness [m] along x, in 3D the mean across the box, shape [S]."""
    return thickness if thickness.ndim == 1 else np.asarray(thickness.mean(axis=1), np.float64)


def evenly(time: Floats, most: int = MOMENTS) -> Floats:
    """At most `most` of the times, evenly spaced, including the first and the last."""
    return np.asarray(time[np.unique(np.linspace(0, len(time) - 1, min(most, len(time))).round().astype(int))])


def compare(one: Trajectory, other: Trajectory, *, labels: tuple[str, str] = ("A", "B")) -> Comparison:
    """Compare two flows of one dimension.

        found = compare(mpm.simulate("column-tall-42"), gns.simulate("column-tall-42"))
        print(found.table())

    x counts from the box's lower corner. Raises InputError if one is in 2D and the other in 3D, and for boxes at
    different places of a map.
    """
    dimension, its = one.scene.dimension, other.scene.dimension
    require(dimension == its, "", f"a {dimension}D flow to compare with one", f"{its}D")
    require_same_place(one.scene, other.scene)
    both, columns = (FlowFields(one), FlowFields(other)), Columns.of_flows((one, other))
    same = pairs(*both)
    end = float(other.time[-1]) * (1.0 + 1e-9)
    # If the first flow starts after the end of the second, there is one moment.
    time = evenly(one.time[: max(1, int(np.searchsorted(one.time, end)))])
    ends = (float(one.time[-1]), float(other.time[-1]))
    rows: tuple[list[list[float]], ...] = ([], [], [])
    for at in [*((moment, moment) for moment in time.tolist()), ends]:
        values = [fields.at_time(moment) for fields, moment in zip(both, at, strict=True)]
        first, second = (state["position"] for state in values)
        entered = [state["entered"] for state in values]
        heights = (columns.thickness(one, first[entered[0]]), columns.thickness(other, second[entered[1]]))
        for series, fields, state in zip(rows, both, values, strict=False):
            series.append(figures_of(fields, state))
        moved = transport = math.nan
        if all(here.any() for here in entered):
            parts = zip((first, second), (one.volumes, other.volumes), entered, strict=True)
            transport = measures.transport_distance(*(array[here] for *owns, here in parts for array in owns))
        if same is not None and (here := entered[0][same[0]] & entered[1][same[1]]).any():
            moved = measures.rms(np.linalg.norm(first[same[0]] - second[same[1]], axis=1)[here])
        rows[2].append([measures.thickness_apart(*heights), transport, moved, measures.overlap(*heights)])
    figures = [dict(zip(FIGURES, np.array(series).T, strict=True)) for series in rows[:2]]
    return Comparison(
        labels=labels,
        dimension=dimension,
        time=time,
        figures=(figures[0], figures[1]),
        apart=dict(zip((*APART.values(), OVERLAP), np.array(rows[2]).T, strict=True)),
        ends=ends,
        stations=columns.middles,
        heights=(along(heights[0]), along(heights[1])),
    )


def spoken(value: float, form: str = ".5g") -> str:
    """A number as text; a dash for nan."""
    return "-" if math.isnan(value) else format(value, form)


def draw(path: Path, comparison: Comparison) -> None:
    """Plot the profiles of the deposits, and fronts, energies and distances over time."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 6.4), layout="constrained")
    (profile, front), (energy, apart) = figure.subplots(2, 2)
    flows = zip(comparison.labels, comparison.figures, comparison.heights, ("-", "--"), strict=True)
    for label, figures, heights, line in flows:
        profile.plot(comparison.stations, heights, line, label=label)
        front.plot(comparison.time, figures["front"][:-1], line, label=label)
        energy.plot(comparison.time, figures["kinetic"][:-1], line, label=label)
    for name, key in APART.items():
        apart.plot(comparison.time, comparison.apart[key][:-1], label=name)
    titles = ("where they end", "front", "kinetic energy", "distance, root mean square")
    labels = ("thickness [m]", "x [m]", "[J]" if comparison.dimension == 3 else "[J/m]", "[m]")
    for panel, title, label in zip((profile, front, energy, apart), titles, labels, strict=True):
        panel.set_title(title, loc="left", fontsize=10)
        panel.set(xlabel="x [m]" if panel is profile else "time [s]", ylabel=label)
        panel.grid(alpha=0.25)
        panel.legend(frameon=False, fontsize=8)
    with replacing(path) as part:
        figure.savefig(part, dpi=110)


def command(one: Path, other: Path, /, *, out: Path | None = None) -> None:
    """Compare two flows: fronts, thickness, energies and distances.

    Args:
        one: A trajectory (NPZ or HDF5), or the folder of a run that holds one.
        other: The second one.
        out: Folder for comparison.md, comparison.png and comparison.json; without it the table is only printed.
    """
    paths = [trajectory_file(path) for path in (one, other)]
    first, second = (open_trajectory(path, "velocities", sound=True) for path in paths)
    with naming(paths[1]):
        comparison = compare(first, second, labels=labels_of(one, other))
    print(comparison.table())
    if out is None:
        return
    make_folder(out)
    draw(out / "comparison.png", comparison)
    write_json(out / "comparison.json", comparison.as_json())
    title = f"# {comparison.labels[0]} and {comparison.labels[1]}"
    write_text(out / "comparison.md", f"{title}\n\n{comparison.table()}\n\n![comparison](comparison.png)\n")
    print(f"written to {out / 'comparison.md'}")


def labels_of(one: Path, other: Path) -> tuple[str, str]:
    """Labels of two runs: the names of their folders or files, or the whole paths if these are the same."""
    names = tuple(path.name if path.is_dir() else path.stem for path in (one.resolve(), other.resolve()))
    return (names[0], names[1]) if names[0] != names[1] else (str(one), str(other))


if __name__ == "__main__":
    sys.exit(run(command, "python -m datasets.compare"))
