"""The result of an inversion, and everything that it leaves in a folder."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from datasets.files import make_folder, replacing, write_json
from datasets.library import write_scene
from inverse.fields import arrays_of
from inverse.found import Found

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True)
class Result(Found):
    """What an inversion found.

    >>> result = solve("friction-tall-42")
    >>> result.verdict, result.unknowns, result.certainty
    (<Verdict.CONFIRMED: 'confirmed'>, {'friction_deg': 41.6...}, {'friction_deg': 0.9...})
    >>> result.plot().savefig("found.png")
    """

    command: str = ""
    """What the report names as the command."""

    def save(self, folder: Path | str) -> None:
        """Write `result.json`, `posterior.npz`, `report.md`, pictures and, where they lack, the MPM runs."""
        from inverse import report  # matplotlib takes a second to load

        folder = Path(folder)
        make_folder(folder)
        for each in self.mpm_runs:
            if each.file and not (folder / each.file).exists():
                each.trajectory.save(folder / each.file)
        if self.posterior is not None:
            names, weights = np.array(self.problem.names, dtype=np.str_), self.posterior.samples.weights
            with replacing(folder / "posterior.npz") as part:
                np.savez_compressed(part, names=names, samples=self.samples, weights=weights)
        if self.fields:
            with replacing(folder / "field.npz") as part:
                np.savez(part, **arrays_of(self.fields))  # type: ignore[arg-type]
            write_scene(self.scene, folder / "scene.toml")
        write_json(folder / "result.json", self.as_json())
        report.write(self, folder, f"{self.command} {self.problem.asked or self.problem.name} --out {folder}")

    def plot(self) -> "Figure":
        """The deposits observed and found, and their profiles."""
        from inverse import deposits

        return deposits.deposits(self)
