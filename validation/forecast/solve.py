"""A forecast, from the files of a result to its own."""

import tempfile
from pathlib import Path

from datasets.errors import InputError, require
from datasets.files import read_json
from datasets.lock import locked
from datasets.scene import Scene
from datasets.scene.grid_field import Floats
from datasets.scene.library import read_scene
from inverse.forward import Simulate
from inverse.parameters import kind
from inverse.saving import read_samples
from mpm import simulate_many
from validation.forecast.predict import Forecast, predicted
from validation.forecast.report import save
from validation.runs import RunStore

DRAWS = 40
"""Of the posterior: the least and the largest of so many flows are the ends of an interval of 95 %."""
MOST_DRAWS = 10_000


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
    with tempfile.TemporaryDirectory() as temporary, locked(Path(out or temporary)) as folder:
        found = predicted(
            asked,
            names,
            samples,
            RunStore(folder / "mpm", simulate, label="forecast-"),
            draws=draws,
            model_error=model_error,
            threshold=threshold,
            pressure=pressure,
            remarks=remarks,
        )
        if out is not None:
            save(found, folder, f"python -m validation.forecast {result} {scene} --out {out}")
    return found


def known_of(result: Path, scene: Scene) -> tuple[list[str], Floats, list[str]]:
    """Names and samples [S, U] of the unknowns of a result that a scene has too, and what is to be said of it."""
    path = result if result.suffix == ".npz" else result / "posterior.npz"
    if not path.exists():
        expected = "expected the folder of validation.loop with posterior.npz, of unknown numbers and not of fields"
        raise InputError(expected, where=str(result))
    names, samples = read_samples(path)
    remarks, kept = [], []
    for index, name in enumerate(names):
        try:
            kind(name).check(scene)
        except InputError as error:
            remarks.append(f"{name} is no part of the forecast: {error.message}")
        else:
            kept.append(index)
    if not kept:
        raise InputError(f"expected a scene with one of {', '.join(names)}: {remarks[0]}", where=str(path))
    verdict = (read_json(path.parent / "result.json") or {}).get("verdict")
    if verdict not in (None, "confirmed"):
        remarks.append(f"the answer that is forecast is {verdict}")
    return [names[index] for index in kept], samples[:, kept], remarks
