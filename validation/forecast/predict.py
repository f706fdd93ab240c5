"""Predicts another flow from the posterior of an inversion, with intervals.

The MPM runs draws theta_s from the posterior of an inversion in another scene, such as another slope, another release
or one with barriers. Each run has its own initial jitter, so the forecast of a number is the distribution of

    y_s = f_0 + (f(theta_s, jitter_s) + b_s d - f_0) (1 + r z_s),    d = h / (h - h') (f(theta_0; h) - f(theta_0; h'))

| symbol | variable | meaning |
|---|---|---|
| f, f_0 | `numbers`, `start` | the number by the MPM on the scene's cells h; at the start, 0 for a height or a force |
| d | `Forecast.cells` | error of the cells, from runs on cells h' (half as large, in 3D twice) at the medians theta_0 |
| r | `model_error` | relative standard deviation of the model itself, as the user states it |
| b, z | - | independent standard normal numbers, because the sign of either error is unknown |

The ends of an interval of S draws are quantiles of rank p (S + 1), so that a further flow lies within the interval with
its stated probability. In 3D, the share of draws in which a cell in plan is covered, or hit, maps that probability; the
maps do not include the errors of the cells and of the model.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.stats import norm

from datasets.errors import InputError
from datasets.flow.measures import above, front, ground_of, height_profile, mean_height, profile_stations
from datasets.flow.trajectory import Trajectory, solid_names
from datasets.forces import forces_of
from datasets.maps import PlanMaps, maps_of
from datasets.scene import Scene
from datasets.scene.grid_field import Floats, Grid
from datasets.scene.particles import initial_particles
from inverse.parameters import with_parameters
from inverse.search.waves import jitter_seed
from mpm import ALL, LAST, Recording
from validation.loop.verdict import WITHOUT_CELLS, other_cells
from validation.run_store import RunStore, caveats

PEAKS = "peaks"  # key of a run's summary for the largest values of all frames: see `with_peaks`
CHECKS = 2  # runs on the scene's cells, and as many on other cells, that measure the error of the cells
LEVELS = {"interval": 0.95, "half": 0.5}  # keys of intervals in `forecast.json`, and their probabilities


@dataclass(frozen=True, kw_only=True)
class Forecast:
    """The prediction of a scene with the posterior of an inversion: S draws of U unknowns."""

    scene: Scene
    names: tuple[str, ...]  # unknowns of the inversion that also exist in the scene
    draws: Floats  # their values in the units of their names, shape [S, U]
    numbers: Mapping[str, Floats]
    """MPM results: `front` and `mean_height` [m], `force NAME` on each solid [N, in 2D N/m]; shape [S] each."""
    start: float = 0.0  # f_0 of the front [m]
    stations: Floats  # x of the profile [m], in map coordinates if the box of the scene has an origin, shape [X]
    profiles: Floats  # height of the deposit at its initial density [m], in 3D the mean over the width, shape [S, X]
    cells: Mapping[str, float] = field(default_factory=dict)
    """d of each number, by its name; empty if runs on other cells need too much memory."""
    model_error: float = 0.0  # r [-]
    maps: PlanMaps | None = None  # in 3D the maps of the last draw, whose grid the maps below share
    covered: Mapping[str, Floats] = field(default_factory=dict)
    """In 3D, the probability that `thickness`, `depth` or `pressure` exceeds its threshold, shape [X, Z] each."""
    remarks: tuple[str, ...] = ()

    @cached_property
    def predicted(self) -> dict[str, Floats]:
        """y of each number, sorted, shape [S]."""
        rng, count = np.random.default_rng([self.scene.seed, 3]), len(self.draws)
        cells, model = (norm.ppf((rng.permutation(count) + 0.5) / count) for _ in range(2))
        numbers = {}
        for name, values in self.numbers.items():
            start, least = (self.start, -np.inf) if name == "front" else (0.0, 0.0)
            moved = values + cells * self.cells.get(name, 0.0) - start
            # Heights and forces are not negative.
            numbers[name] = np.sort(np.maximum(start + moved * (1.0 + self.model_error * model), least))
        return numbers

    def as_json(self) -> dict[str, Any]:
        """`forecast.json`."""
        numbers, force = {}, "N/m" if self.scene.dimension == 2 else "N"
        for name, values in self.predicted.items():
            ends = {key: quantiles(values, level) for key, level in LEVELS.items()}
            intervals = {key: [low, high] for key, (low, _, high) in ends.items()}
            about = {"cells": self.cells.get(name), "unit": force if name.startswith("force ") else "m"}
            numbers[name] = {"median": ends["interval"][1]} | intervals | about
        low, middle, high = quantiles(self.profiles, LEVELS["interval"])
        profile = {"x": self.stations, "median": middle, "lower": low, "upper": high}
        return {
            "unknowns": list(self.names),
            "draws": self.draws.tolist(),
            "numbers": numbers,
            "profile": {key: np.asarray(values).tolist() for key, values in profile.items()},
            "model_error": self.model_error,
            "flows": {name: values.tolist() for name, values in self.numbers.items()},
            "remarks": list(self.remarks),
        }


def quantiles(values: Floats, level: float) -> list[Any]:
    """Lower end, median and upper end of an interval of probability `level`, of rank p (S + 1) along the first axis.
    The results are floats, or arrays over the other axes."""
    ends = np.quantile(values, [0.5 - 0.5 * level, 0.5, 0.5 + 0.5 * level], axis=0, method="weibull")
    return [float(end) if end.ndim == 0 else end for end in ends]


def predicted(
    scene: Scene,
    names: Sequence[str],
    samples: Floats,
    store: RunStore,
    *,
    draws: int,
    model_error: float = 0.0,
    threshold: float | None = None,
    pressure: float | None = None,
    remarks: Sequence[str] = (),
) -> Forecast:
    """The forecast of `scene` from `draws` of the samples [S, U] of the unknowns `names`; see `forecast_scene`."""
    rng = np.random.default_rng([scene.seed, 2])
    # Stratified: one sample from each of `draws` equal parts of the posterior, sorted by its first number.
    ordered = samples[np.argsort(samples[:, 0], kind="stable")]
    chosen = ordered[((np.arange(draws) + rng.random(draws)) * len(ordered) / draws).astype(int)]
    scenes = [at(scene, names, row, jitter_seed(scene.seed, number)) for number, row in enumerate(chosen)]
    flows = store(scenes, record=recording_of(scene))
    numbers, stations = [numbers_of(flow) for flow in flows], profile_stations(scene, scene.domain.cell)
    released, corner = initial_particles(scene), float(scene.domain.corner[0])
    cells, missing = cells_error(scene, names, np.median(samples, axis=0), store)
    maps: PlanMaps | None = None
    covered: dict[str, Floats] = {}
    for flow in flows if scene.dimension == 3 else ():
        maps = maps_of(flow, scene.domain.cell, threshold=threshold)
        peaks = flow.summary[PEAKS]
        hit = {"thickness": maps.thickness > maps.threshold, "depth": np.array(peaks["depth"]) > maps.threshold}
        if pressure is not None:
            hit["pressure"] = scene.material_of(scene.masses[0]).density * np.array(peaks["velocity"]) ** 2 > pressure
        covered = {name: covered.get(name, 0.0) + where / len(flows) for name, where in hit.items()}
    return Forecast(
        scene=scene,
        names=tuple(names),
        draws=chosen,
        numbers={name: np.array([entry[name] for entry in numbers]) for name in numbers[0]},
        start=corner + front(released.positions, released.volume),
        stations=corner + stations,
        profiles=np.stack([profile_of(flow, stations) for flow in flows]),
        cells=cells,
        model_error=model_error,
        maps=maps,
        covered=covered,
        remarks=(*remarks, *caveats(flows), *filter(None, [flows[0].summary.get("drainage"), missing])),
    )


def recording_of(scene: Scene) -> Recording:
    """The frames that `with_peaks` needs: forces are means between frames, and maps hold the largest of all frames."""
    return ALL if scene.dimension == 3 or solid_names(scene) else LAST


def with_peaks(flow: Trajectory, threshold: float | None = None) -> Trajectory:
    """The deposit of a flow, with the largest values of all frames in its summary. `force` on each solid [N, in 2D
    N/m]; in 3D `depth` [m] and `velocity` [m/s] of each cell, shape [X, Z]. threshold: [m], as in `datasets.maps`."""
    peaks = dict[str, Any]()
    if names := solid_names(flow.scene):
        largest = forces_of(flow).largest
        peaks["force"] = {name: largest[name] for name in names}
    if flow.scene.dimension == 3:
        maps = maps_of(flow, flow.scene.domain.cell, threshold=threshold)
        velocity = np.zeros_like(maps.depth) if maps.velocity is None else maps.velocity
        peaks |= {"depth": maps.depth.tolist(), "velocity": velocity.tolist()}
    return flow.ending({PEAKS: peaks}) if peaks else flow


def at(scene: Scene, names: Sequence[str], values: Floats, seed: int) -> Scene:
    """The scene with these values and a jitter seed. Raises InputError, which names them."""
    try:
        return replace(with_parameters(scene, names, [float(f"{value:.8g}") for value in values]), seed=seed)
    except InputError as error:
        where = ", ".join(f"{name} = {value:.4g}" for name, value in zip(names, values, strict=True))
        raise InputError(f"{error.message} with {where}, of the posterior", key=error.key) from None


def numbers_of(flow: Trajectory) -> dict[str, float]:
    """The numbers of a forecast, from one flow."""
    scene, last, volumes = flow.scene, flow.positions[-1], flow.volumes
    inside = within(flow)
    numbers = {
        "front": float(scene.domain.corner[0]) + front(last[inside], volumes[inside]),
        "mean_height": height_of(scene, last[inside], volumes[inside]),
    }
    forces = flow.summary.get(PEAKS, {}).get("force", {})
    return numbers | {f"force {name}": float(force) for name, force in forces.items()}


def height_of(scene: Scene, positions: Floats, volumes: Floats) -> float:
    """Mean height of a deposit [m]; positions [N, D] and volumes [N] of its particles. In 3D (1/2) int h^2 dA / int h
    dA with the thickness h over the cells: features narrower than a cell spread over it."""
    if scene.dimension == 2:
        return mean_height(above(positions, ground_of(scene)), volumes)
    cell = scene.domain.cell
    grid = Grid((0.5 * cell,) * 2, (cell,) * 2, tuple(round(side / cell) for side in scene.domain.size[::2]))
    thickness = grid.weights(positions[:, ::2]).T @ volumes / cell**2
    return 0.5 * float(thickness @ thickness / thickness.sum())


def within(flow: Trajectory) -> Any:
    """Which particles are in the box at the end, shape [N]; all if none is."""
    last, size = flow.positions[-1], np.array(flow.scene.domain.size)
    inside = ((last >= 0.0) & (last <= size)).all(axis=1)
    return inside if inside.any() else ~inside


def profile_of(flow: Trajectory, stations: Floats) -> Floats:
    """Height of the deposit [m], in 3D the mean over the width, shape [X]."""
    width, inside = (1.0 if flow.scene.dimension == 2 else flow.scene.domain.size[2]), within(flow)
    return height_profile(flow.positions[-1][inside], flow.volumes[inside], stations) / width


def cells_error(scene: Scene, names: Sequence[str], median: Floats, store: RunStore) -> tuple[dict[str, float], str]:
    """d of each number, from runs at the medians; if there is none, why."""
    edge, reasons = scene.domain.cell, list[str]()
    for factor, runs in other_cells(scene, CHECKS).items():
        other = factor * edge
        seeds = [(edge, seed) for seed in range(CHECKS)] + [(other, seed) for seed in range(runs)]
        try:
            scenes = [at(scene.with_cell(cell), names, median, seed) for cell, seed in seeds]
            flows = [numbers_of(flow) for flow in store(scenes, record=recording_of(scene))]
        except InputError as error:
            reasons.append(str(error))
            continue
        parts = (flows[:CHECKS], flows[CHECKS:])
        here, there = ({name: float(np.mean([entry[name] for entry in part])) for name in part[0]} for part in parts)
        return {name: abs(edge / (edge - other) * (here[name] - there[name])) for name in here}, ""
    return {}, f"{WITHOUT_CELLS}: {'; '.join(reasons)}"
