"""Everything that a result leaves in a folder, and its posterior read again."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from datasets.errors import require
from datasets.files import make_folder, read_json, reading, replacing, write_json, write_text
from datasets.flow.array_files import read_arrays, write_npz
from datasets.scene import Scene
from datasets.scene.library import write_scene
from inverse import inference_data, pictures, report
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
        # Beside the problem `scene.toml` may be its own.
        beside = folder.resolve() == result.problem.folder.resolve()
        write_scene(result.scene, folder / ("answer.toml" if beside else "scene.toml"))
    write_json(folder / "result.json", result.as_json())
    write_text(folder / "report.md", report.markdown(result, folder, pictures.write(result, folder)))


def read_samples(path: Path) -> tuple[list[str], Matrix]:
    """Names and samples [S, U] of a `posterior.npz`, drawn again to equal weights. Raises InputError."""
    arrays = read_arrays(path, "names", "samples", "weights", what="the posterior of validation.loop")
    with reading(path, "the posterior of validation.loop"):
        samples, weights = arrays["samples"].astype(float), arrays["weights"].astype(float)
        order = systematic(weights / weights.sum(), len(weights), np.random.default_rng(0))
        names = [str(name) for name in arrays["names"]]
        if samples.shape != (len(weights), len(names)):
            raise ValueError
        return names, samples[order]


def require_same_angle(path: Path, names: Sequence[str], scene: Scene) -> None:
    """Raises InputError where samples at `path` of angles of friction were measured otherwise than a scene's."""
    angle, own = (read_json(path.parent / "result.json") or {}).get("angle"), scene.material.angle
    if angle is not None and any(name.endswith(("friction_deg", "friction_limit_deg")) for name in names):
        require(own == angle, "material.angle", f"{angle}, as in the inversion in {path.parent}", own)
