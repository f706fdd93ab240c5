"""Flows -> one HTML page that any browser opens from disk: particles over time, their heights and their fronts.

The page holds Plotly.js and the data, both deflated. Positions are 16-bit shares of the box around all of them, fields
8-bit shares of the range of their colour bar; both as differences from one frame to the next, which deflate well.
"""

import base64
import html
import json
import math
import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.compare import Columns, along, evenly
from datasets.errors import require
from datasets.exchange.vtk import extent
from datasets.files import finite, write_text
from datasets.flow import measures
from datasets.flow.fields import RANGE_QUANTILE, SCALES, Colour, ColourScale, FlowFields, Values, pairs
from datasets.flow.trajectory import Trajectory
from datasets.geometry.ground import ground_raster
from datasets.geometry.surface import closed_body, solids_of
from datasets.maps import require_same_place
from datasets.scene import Scene
from datasets.scene.material import Material

FRAMES, PARTICLES = 60, 20_000  # most frames and particles of a flow on a page
NODES = 150  # most nodes of the ground along the longest side of the box
ERROR = "error"  # additional field of two flows of the same particles: their distance
SHOWN: dict[str, ColourScale] = {key.value: scale for key, scale in SCALES.items()}
SHOWN[ERROR] = ColourScale(title="distance between the two [m]", colours="magma")
COLOURS = ("#1b6ca8", "#d9730d")
"""Of the first and of the second flow."""
STOPS = 12  # of a colour map
PAGE = Path(__file__).with_suffix(".html")


@dataclass(frozen=True, kw_only=True)
class Observed:
    """Measurements of a flow's end that a picture can show."""

    front: float | None = None  # x of the front [m]
    x: Sequence[float] = ()
    height: Sequence[float] = ()  # a profile [m]: height at x, both of shape [R]


class Shown:
    """The contents of a page for one flow, moment by moment."""

    def __init__(self, flow: Trajectory, columns: Columns) -> None:
        self.flow, self.fields, self.columns = flow, FlowFields(flow), columns
        # At random, because every n-th particle of a lattice would form stripes.
        self.particles = np.sort(np.random.default_rng(0).permutation(flow.positions.shape[1])[:PARTICLES])  # [P]
        self.positions: list[NDArray[np.floating]] = []  # of these [m], [T] times [P, D]
        self.values: dict[str, list[NDArray[np.floating]]] = {}  # in the unit of their colour bar, [T] times [P]
        self.heights: list[NDArray[np.float64]] = []  # thickness along x [m], [T] times [S]
        self.front: list[float] = []

    def add(self, values: Values) -> None:
        """Add a moment; values: of all particles."""
        whole = values["position"]
        self.positions.append(whole[self.particles])
        here = values["entered"]
        self.heights.append(along(self.columns.thickness(self.flow, whole[here])))
        self.front.append(measures.front(whole[here], self.flow.volumes[here]) if here.any() else math.nan)
        for key in [key for key in SHOWN if key in values]:
            self.values.setdefault(key, []).append(SHOWN[key].scaled(values[key][self.particles]))

    def known(self) -> dict[str, NDArray[np.floating]]:
        """The fields that are known at every moment, shape [T, P]."""
        return {key: np.stack(series) for key, series in self.values.items() if len(series) == len(self.positions)}


def put(data: bytearray, values: NDArray[Any], low: NDArray[Any], high: NDArray[Any], kind: str) -> dict[str, Any]:
    """Append `values` [T, ..., M, K] between `low` and `high`, each [M], as integers, u1 or u2. Returns their place."""
    levels = np.iinfo(kind).max
    step = np.where(high > low, high - low, 1.0) / levels
    shares = np.nan_to_num((values - low[:, None]) / step[:, None]).clip(0.0, levels).round().astype(kind)
    data += b"\0" * (len(data) % 2)
    place = {"type": kind, "at": len(data), "shape": shares.shape, "low": low.tolist(), "step": step.tolist()}
    # Unsigned: what is less than before wraps around, and back where the differences are added up.
    data += np.diff(shares, axis=0, prepend=np.zeros_like(shares[:1])).astype(f"<{kind}").tobytes()
    return place


def write_view(
    path: str | Path,
    flow: Trajectory,
    other: Trajectory | None = None,
    *,
    title: str = "",
    labels: Sequence[str] = ("A", "B"),
    observed: Observed | None = None,
) -> None:
    """Write the page of a flow, or of two at the times of the first. Raises InputError for one in 2D and one
    in 3D, and for boxes in two places of a map."""
    flows = (flow,) if other is None else (flow, other)
    dimension = flow.scene.dimension
    for run in flows[1:]:
        its = run.scene.dimension
        require(its == dimension, "", f"a {dimension}D flow over one", f"{its}D")
        require_same_place(flow.scene, run.scene)
    columns, times = Columns.of_flows(flows), evenly(flow.time, FRAMES)
    shown = [Shown(run, columns) for run in flows]
    same = None if other is None else pairs(shown[0].fields, shown[1].fields)
    for time in times.tolist():
        moments = [view.fields.at_time(time) for view in shown]
        if same is not None:
            apart = np.linalg.norm(moments[0]["position"][same[0]] - moments[1]["position"][same[1]], axis=1)
            few = int(len(moments[1]["position"]) < len(moments[0]["position"]))
            moments[few][ERROR] = np.zeros(len(apart))
            moments[few][ERROR][same[few]] = apart
        for view, values in zip(shown, moments, strict=True):
            view.add(values)
    data = bytearray()
    head = {
        "dimension": dimension,
        "times": times.tolist(),
        "digits": 1 if times[-1] > 100.0 else 2 if times[-1] > 5.0 else 3,
        "stations": columns.middles.tolist(),
        "depth": "thickness [m]" if dimension == 2 else "mean thickness over z [m]",
        **described(shown, data, [html.escape(label) for label in labels]),
        **still([run.scene for run in flows]),
        "observed": vars(observed or Observed()),
        "about": html.escape(about(shown, labels, times)),
    }
    from plotly.offline import get_plotlyjs

    parts = {
        "title": html.escape(title or "A granular flow"),
        # Escaped, so that no text of a scene can end the script that contains it.
        "head": json.dumps(finite(head), default=list).replace("<", "\\u003c"),
        "data": packed(data),
        "plotly": packed(get_plotlyjs().encode()),
    }
    write_text(Path(path), re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], PAGE.read_text(encoding="utf-8")))


def packed(data: bytes | bytearray) -> str:
    """Deflated, as text."""
    return base64.b64encode(zlib.compress(data, 9)).decode()


def described(shown: Sequence[Shown], data: bytearray, labels: Sequence[str]) -> dict[str, Any]:
    """The flows, fields and ranges of a page, their arrays put into `data`."""
    places = [np.stack(view.positions).swapaxes(1, 2) for view in shown]
    low = np.min([place.min(axis=(0, 2)) for place in places], axis=0)
    high = np.max([place.max(axis=(0, 2)) for place in places], axis=0)
    corners = np.stack([extent(view.flow.scene, np.stack(view.positions)) for view in shown])
    fields: dict[str, dict[str, Any]] = {"run": {"name": "which flow"}} if len(shown) > 1 else {}
    materials = list(dict.fromkeys(material for view in shown for material in view.fields.materials))
    field_arrays, tops = [view.known() for view in shown], {}
    for key in SHOWN:
        series = [arrays[key].ravel() for arrays in field_arrays if key in arrays]
        if series and (key != Colour.MATERIAL or len(materials) > 1):
            top = float(np.quantile(np.concatenate(series), RANGE_QUANTILE))
            # Numbers of materials are stored as they are.
            tops[key] = 255.0 if key == Colour.MATERIAL else top or 1.0
            fields[key] = coloured(key, tops[key], materials)
    runs = []
    for view, arrays, place, label, colour in zip(shown, field_arrays, places, labels, COLOURS, strict=False):
        values = {key: array[:, None] for key, array in arrays.items() if key in tops}
        if Colour.MATERIAL in values:
            indices = np.array([materials.index(material) for material in view.fields.materials])
            values[Colour.MATERIAL] = indices[values[Colour.MATERIAL].astype(int)]
        highest = np.array([max(float(np.max(view.heights)), 1.0e-9)])
        run = {
            "label": label,
            "colour": colour,
            # Between the particles that are drawn.
            "spacing": float(view.flow.volumes.sum() / len(view.particles)) ** (1.0 / place.shape[1]),
            "front": view.front,
            "entry": None if (entry := view.flow.entry_time) is None else entry[view.particles].tolist(),
            "positions": put(data, place, low, high, "u2"),
            "heights": put(data, np.stack(view.heights)[:, None], np.zeros(1), highest, "u2"),
            "fields": {key: put(data, part, np.zeros(1), np.array([tops[key]]), "u1") for key, part in values.items()},
        }
        runs.append(run)
    lower, upper = corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
    return {"runs": runs, "fields": fields, "lower": lower.tolist(), "upper": upper.tolist()}


def coloured(key: str, top: float, materials: Sequence[Material]) -> dict[str, Any]:
    """The colour bar of a field, from 0 to `top`; of materials a colour for each."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    given, count = SHOWN[key], len(materials)
    name, map_ = given.title.split(" [")[0], colormaps[given.colours]
    if key != Colour.MATERIAL:
        stops = [[at, to_hex(map_(at))] for at in np.linspace(0.0, 1.0, STOPS).tolist()]
        return {"name": name, "title": given.title, "low": 0.0, "high": top, "scale": stops, "ticks": {}}
    stops = [[(index + end) / count, to_hex(map_(index % map_.N))] for index in range(count) for end in (0, 1)]
    ticks = {"tickvals": list(range(count)), "ticktext": [f"{material.friction_deg:g}°" for material in materials]}
    return {"name": name, "title": given.title, "low": -0.5, "high": count - 0.5, "scale": stops, "ticks": ticks}


def still(scenes: Sequence[Scene]) -> dict[str, Any]:
    """The fixed parts: corners of baffles and solids, and the highest terrain at nodes over the box. Of a second scene,
    only parts that the first does not have, and no second terrain."""
    scene, parts, ground = scenes[0], [], None
    first_solids = set(solids_of(scene)[0])
    for index, current in enumerate(scenes):
        for number, (solid, key) in enumerate(zip(*solids_of(current), strict=True)):
            if solid.kind == "terrain" or (index > 0 and solid in first_solids):
                continue
            body = closed_body(solid, key, current.domain)
            corners = body.vertices if current.dimension == 3 else body.vertices[[*range(len(body.vertices)), 0]]
            kind = "second" if index else "baffle" if number < len(current.baffles) else "ground"
            places = dict(zip("xyz", corners.T.tolist(), strict=False))
            parts.append(places | {"faces": body.faces.T.tolist(), "kind": kind})
    if any(solid.kind == "terrain" for solid in scene.solids):
        spacing = max(scene.domain.cell, max(scene.domain.size) / NODES)
        heights = ground_raster(scene, spacing)[0]
        axes = [(spacing * np.arange(count)).tolist() for count in heights.shape]
        ground = {"x": axes[0], "y": heights.T.round(6).tolist()} | ({"z": axes[1]} if len(axes) == 2 else {})
    return {"solids": parts, "ground": ground}


def about(shown: Sequence[Shown], labels: Sequence[str], times: NDArray[np.float64]) -> str:
    """The contents of a page, and the omitted parts of the flows, in sentences."""
    scene, parts = shown[0].flow.scene, []
    for view, label in zip(shown, labels, strict=False):
        count, drawn = view.flow.positions.shape[1], len(view.particles)
        what = f"{count:,} particles" if drawn == count else f"{drawn:,} of {count:,} particles, drawn at random"
        parts.append(f"{label}: {what}" if len(shown) > 1 else what)
    every = len(shown[0].flow.time)
    parts.append(f"{len(times)} of {every} frames" if every > len(times) else f"frames: {every}")
    if scene.slope_deg:
        parts.append(f"the box is drawn level, gravity is inclined by {scene.slope_deg:g}°")
    if scene.domain.origin is not None:
        place = ", ".join(f"{coordinate:.10g}" for coordinate in scene.domain.origin)
        parts.append(f"lengths count from {place} m on the map")
    return "; ".join(parts) + "."
