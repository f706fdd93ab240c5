"""What an inversion for fields found, and its files `result.json`, `field.npz`, `scene.toml` and `NAME.vti`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.files import replacing, write_json
from datasets.library import write_scene
from datasets.scene import Scene
from inverse.fields.noise import Noise
from inverse.fields.posterior import Posterior
from inverse.fields.problem import FieldProblem
from inverse.fields.search import Iterate
from inverse.fields.unknown import Unknown
from inverse.observations import Target, Values
from inverse.result import Verdict, peak_memory_mib

Floats = NDArray[np.float64]

IDENTIFIED = 0.5
"""Share of the prior's variance beyond whose removal the observation identifies a value."""
DRAWS = 100
"""Fields of the posterior in `field.npz`."""


@dataclass(frozen=True, kw_only=True)
class FoundField:
    """A field at its K nodes, in its unit; statistics are over the nodes beside the body alone."""

    unknown: Unknown
    part: slice
    """Which of all white numbers are its own."""
    latent: Floats
    """u of `inverse.fields.unknown`, the most probable one, shape [K]."""
    mean: Floats
    """The most probable field, shape [K]."""
    lower: Floats
    """Lower end of the band of 95 % at each node, shape [K]."""
    upper: Floats
    """Upper end, shape [K]."""
    deviation: Floats
    """Width of that band over that of one standard deviation, shape [K]."""
    prior_deviation: Floats
    """The same of the prior, shape [K]."""
    removed: Floats
    """Share of the prior's variance that the observation removed, shape [K]."""
    truth: Floats | None
    """Where known, shape [K]."""

    @property
    def identified(self) -> NDArray[np.bool_]:
        """Which nodes beside the body the observation identifies, shape [K]."""
        return (self.removed > IDENTIFIED) & self.unknown.inside

    def identified_box(self) -> list[tuple[float, float]] | None:
        """Between which coordinates they lie along each axis [m]; None where there are none."""
        if not self.identified.any():
            return None
        here = self.unknown.grid.positions[self.identified]
        return [(float(low), float(high)) for low, high in zip(here.min(axis=0), here.max(axis=0), strict=True)]

    def error(self, where: NDArray[np.bool_], values: Floats | float | None = None) -> float | None:
        """Root mean square error of the found field, or of other `values`, at nodes `where` [K]; None if unknown."""
        if self.truth is None or not where.any():
            return None
        found = self.mean if values is None else np.broadcast_to(values, self.truth.shape)
        return float(np.sqrt(np.mean((found - self.truth)[where] ** 2)))

    def covered(self, where: NDArray[np.bool_]) -> float | None:
        """Share of the true values at nodes `where` [K] that the bands hold; None where they are not known."""
        if self.truth is None or not where.any():
            return None
        return float(np.mean((self.lower <= self.truth)[where] & (self.truth <= self.upper)[where]))

    def as_json(self) -> dict[str, Any]:
        """As `result.json` has it."""
        inside, identified, settings = self.unknown.inside, self.identified, self.unknown.settings
        return {
            "name": self.unknown.name,
            "unit": self.unknown.unit,
            "nodes": list(self.unknown.grid.nodes),
            "values": int(inside.sum()),
            "identified": float(identified[inside].mean()),
            "identified_between": self.identified_box(),
            "variance_removed": float(self.removed[inside].mean()),
            "deviation": {
                "prior": float(self.prior_deviation[inside].mean()),
                "posterior": float(self.deviation[inside].mean()),
                "identified": float(self.deviation[identified].mean()) if identified.any() else None,
            },
            "error": {
                "prior": self.error(inside, settings.mean),
                "posterior": self.error(inside),
                "prior_identified": self.error(identified, settings.mean),
                "identified": self.error(identified),
            },
            "truth_in_band": {"all": self.covered(inside), "identified": self.covered(identified)},
        }


@dataclass(frozen=True, kw_only=True)
class Price:
    """What it cost."""

    seconds: float
    processor_s: float
    """Of all threads: what other work on the machine does not change."""
    runs: int
    """MPM runs, those that were reversed included."""
    reverses: int
    """Reverse passes: gradients of one combination of the numbers with respect to all values."""
    combinations: int
    """Of the observed numbers, with a reverse pass each, in every Jacobian."""


@dataclass(frozen=True, kw_only=True)
class FieldResult:
    """The posterior of fields, and what a run of the solver at the most probable ones shows."""

    problem: FieldProblem
    target: Target
    fields: list[FoundField]
    posterior: Posterior
    noise: Noise
    predicted: Values
    """Numbers of the most probable fields, mean over the seeds of the search, shape [M]."""
    shown: Values
    """Numbers of one run at them with a jitter seed that nothing else has, shape [M]."""
    seed: int
    """That seed."""
    verdict: Verdict
    """`confirmed` where that run reproduces the observation within errors and scatter, else `unconfirmed`."""
    distance: float
    """Root mean square of its residuals, in standard deviations."""
    tolerance: float
    """Within which it is confirmed."""
    iterates: list[Iterate]
    promised: float
    """Decrease of the objective that another step would bring where the numbers are linear; 0.5 is a standard deviation

    along one direction.
    """
    price: Price

    @property
    def scene(self) -> Scene:
        """The scene with the fields that were found."""
        return self.problem.scene_at([each.latent for each in self.fields])

    def as_json(self) -> dict[str, Any]:
        """As `result.json` has it."""
        raw, eigenvalues = self.target.observation.raw, self.posterior.eigenvalues
        return {
            "problem": self.problem.name,
            "verdict": self.verdict.value,
            "fields": [each.as_json() for each in self.fields],
            "informative_directions": self.posterior.informative,
            "eigenvalues": eigenvalues.tolist(),
            "observation": {
                "target": raw(self.target.values).tolist(),
                "predicted": raw(self.predicted).tolist(),
                "mpm": raw(self.shown).tolist(),
                "deviation_of_a_run": raw(self.noise.deviation).tolist(),
            },
            "check": {"seed": self.seed, "distance": self.distance, "tolerance": self.tolerance},
            "iterations": [
                {"objective": each.objective, "misfit": each.misfit, "step": each.step} for each in self.iterates
            ],
            "promised_decrease": self.promised,
            "mpm_runs": self.price.runs,
            "reverse_passes": self.price.reverses,
            "combinations": self.price.combinations,
            "seconds": self.price.seconds,
            "processor_s": self.price.processor_s,
            "peak_memory_mib": peak_memory_mib(),
        }

    def arrays(self) -> dict[str, Floats]:
        """The arrays of `field.npz`; those of field k begin with `k_`."""
        found: dict[str, Floats] = {"eigenvalues": self.posterior.eigenvalues}
        draws = self.posterior.draws(DRAWS)
        for index, each in enumerate(self.fields):
            latents = each.unknown.prior.field(draws[:, each.part].T).T
            own = {
                "positions": each.unknown.grid.positions,
                "nodes": np.array(each.unknown.grid.nodes),
                "inside": each.unknown.inside,
                "mean": each.mean,
                "lower": each.lower,
                "upper": each.upper,
                "deviation": each.deviation,
                "prior_deviation": each.prior_deviation,
                "removed": each.removed,
                "draws": each.unknown.values(latents),
            }
            if each.truth is not None:
                own["truth"] = each.truth
            found |= {f"{index}_{name}": values for name, values in own.items()}
        return found

    def write(self, folder: Path) -> None:
        """Write the files into `folder`."""
        write_json(folder / "result.json", self.as_json())
        with replacing(folder / "field.npz") as part:
            np.savez(part, **self.arrays())  # type: ignore[arg-type]
        write_scene(self.scene, folder / "scene.toml")
        for each in self.fields:
            write_vti(each, folder / f"{each.unknown.name.replace('.', '-')}.vti")


def write_vti(found: FoundField, path: Path) -> None:
    """A field and its widths on their nodes, for ParaView."""
    # Imported here: VTK takes half a second to load.
    import pyvista

    grid, flat = found.unknown.grid, 3 - len(found.unknown.grid.nodes)
    image = pyvista.ImageData(
        dimensions=(*grid.nodes, *[1] * flat),
        spacing=(*grid.spacing, *[1.0] * flat),
        origin=(*grid.origin, *[0.0] * flat),
    )
    arrays = {
        "mean": found.mean,
        "deviation": found.deviation,
        "removed": found.removed,
        "inside": found.unknown.inside,
    }
    if found.truth is not None:
        arrays["truth"] = found.truth
    for name, values in arrays.items():
        # VTK counts x fastest.
        image.point_data[name] = np.asarray(values, np.float32).reshape(grid.nodes).ravel(order="F")
    with replacing(path) as part:
        image.save(part)
