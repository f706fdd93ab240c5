"""Writes all files of a result, and reads its posterior."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from datasets.errors import InputError, require
from datasets.files import make_folder, read_json, reading, replacing, write_json, write_text
from datasets.flow.array_files import read_arrays, write_npz
from datasets.scene import Scene
from datasets.scene.library import write_scene
from inverse import inference_data, pictures, report
from inverse.parameters import changed_material, kind
from inverse.posterior import Matrix
from inverse.posterior.sampling import systematic
from inverse.result import Result


def save(result: Result, folder: Path | str) -> None:
    """Write `result.json`, `posterior.npz`, `posterior.nc`, `report.md`, pictures and missing MPM runs."""
    folder = Path(folder)
    make_folder(folder)
    for run in result.mpm_runs:
        if run.file and not (folder / run.file).exists():
            run.trajectory.save(folder / run.file)
    if result.posterior is not None:
        names, weights = np.array(result.problem.names, dtype=np.str_), result.posterior.samples.weights
        with replacing(folder / "posterior.npz") as part:
            np.savez_compressed(part, names=names, samples=result.samples, weights=weights)
        inference_data.write(result, folder / "posterior.nc")
    if result.fields:
        arrays = {f"{k}_{key}": values for k, field in enumerate(result.fields) for key, values in field.saved.items()}
        write_npz(folder / "field.npz", arrays)
        # In the problem's folder, `scene.toml` may be the problem's own scene.
        beside = folder.resolve() == result.problem.folder.resolve()
        write_scene(result.scene, folder / ("answer.toml" if beside else "scene.toml"))
    write_json(folder / "result.json", result.as_json())
    write_text(folder / "report.md", report.markdown(result, folder, pictures.write(result, folder)))


def read_samples(path: Path) -> tuple[list[str], Matrix]:
    """Names and samples [S, U] of a `posterior.npz`, resampled to equal weights. Raises InputError."""
    arrays = read_arrays(path, "names", "samples", "weights", what="the posterior of validation.loop")
    with reading(path, "the posterior of validation.loop"):
        samples, weights = arrays["samples"].astype(float), arrays["weights"].astype(float)
        order = systematic(weights / weights.sum(), len(weights), np.random.default_rng(0))
        names = [str(name) for name in arrays["names"]]
        if samples.shape != (len(weights), len(names)):
            raise ValueError
        return names, samples[order]


def known_of(result: Path, scene: Scene) -> tuple[list[str], Matrix, list[str]]:
    """Names and samples [S, U] of those unknowns of a result that a scene also has, and remarks on them.
    result: its folder or `posterior.npz`. Raises InputError if the scene has none of them, or measures their friction
    angles in another way."""
    path = result if result.suffix == ".npz" else result / "posterior.npz"
    if not path.exists():
        expected = "expected the folder of validation.loop with posterior.npz, of unknown numbers and not of fields"
        raise InputError(expected, where=str(result))
    names, samples = read_samples(path)
    record = read_json(path.parent / "result.json") or {}
    angles = record.get("angle")
    remarks, kept = [], []
    for index, name in enumerate(names):
        try:
            require(name != "time_offset", "", "a number of a scene", "the clock of the observations")
            names[index] = in_scene(name, record.get("solids", []), scene)
            kind(names[index]).check(scene)
        except InputError as error:
            remarks.append(f"{name} of the inversion is not used: {error.message}")
            continue
        kept.append(index)
        if names[index] != name:
            remarks.append(f"{name} of the inversion is {names[index]} of this scene")
        angle = angles.get(name) if isinstance(angles, Mapping) else angles
        if angle is not None and (changed := changed_material(scene, names[index])) is not None:
            key, material = changed
            expected = f"{angle}, as in the inversion in {path.parent}"
            require(material.angle == angle, f"{key}.angle", expected, material.angle)
    if not kept:
        raise InputError(f"expected a scene with one of {', '.join(names)}: {remarks[0]}", where=str(path))
    verdict = record.get("verdict")
    if verdict not in (None, "confirmed"):
        remarks.append(f"the answer of the inversion is {verdict}")
    return [names[index] for index in kept], samples[:, kept], remarks


def in_scene(name: str, solids: Sequence[tuple[str | None, str]], scene: Scene) -> str:
    """The name of an unknown in `scene`: a solid is matched to the one of the same name, else to the one of its kind.
    solids: name and kind of each solid in the inversion. Raises InputError if the scene has no matching solid."""
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
