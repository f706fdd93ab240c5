"""Which resolution a scene needs for a given error: the choice and the promise of `--tolerance`.

The error compares a run at a resolution with a run on a grid at least twice as fine. It is the larger of two errors, of
the front (the x that 99.5 % of the volume is behind) and of the profile (the rms distance along x of equal shares of
the two deposits), over the extent. The extent reaches from the rear of the initial masses to the front: the runout
distance of a column at the left wall. The error of the thickness, a share of another length, is reported separately.
The promise is that at least nine of ten scenes like those measured stay within the tolerance: columns and thrown
masses, dry and cohesive, damped and not. It covers grid, step and random jitter, not the choice of material.

Resolution is counted in cells across the smallest side of the released body, which carries over between scenes
(docs/accuracy.md, `python -m validation.bench accuracy`, which also writes `resolution.toml` and tries the promise on
other scenes).
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets.errors import require
from datasets.files import read_toml
from datasets.geometry.bodies import height
from datasets.geometry.placement import connected, corners
from datasets.scene import TOLERANCE, Domain, Scene
from datasets.scene.particles import particle_count
from datasets.schema import Record, fraction, from_mapping
from mpm.arrays.layout import Precision
from mpm.arrays.properties import substeps_per_frame

MEASURED = Path(__file__).with_suffix(".toml")
COVERAGE = 0.9  # share of scenes that a tolerance holds for
ROUNDING = 1.0e-9  # slack for rounding to a whole number of cells


@dataclass(frozen=True, kw_only=True)
class Resolution(Record):
    """How finely a scene is simulated, independent of its size."""

    cells: float
    """Grid cells across the characteristic length of the scene [-]."""
    particles_per_axis: int
    """Particles per cell along one axis."""
    step_fraction: float
    """Time step as a fraction of cell / (pressure-wave speed)."""
    precision: Precision


@dataclass(frozen=True, kw_only=True)
class MeasuredResolution(Record):
    """Error and cost of a resolution, over the scenes of one dimension."""

    dimension: int
    """2 or 3."""
    resolution: Resolution
    expected: float
    """Root mean square of the errors over scenes and jitters, each as a fraction of the extent [-]."""
    promised: float
    """Bound on the error of one more scene with probability COVERAGE, at this and all finer resolutions [-]."""
    particle_steps: float
    """Mean over the scenes."""
    thickness: float
    """Error of the thickness over its largest (`datasets.flow.measures.Errors`), rms over scenes and jitters [-]; it is
    reported, not promised, because it is a share of another length."""


@dataclass(frozen=True, kw_only=True)
class Resolved:
    """A scene at the resolution that a tolerance requires, and what to expect of it."""

    scene: Scene
    measured: MeasuredResolution
    """Error and cost of the resolution."""
    cost: float
    """Particle-steps over those of the scene as it was given [-]."""

    @property
    def cells(self) -> float:
        """Cells across the characteristic length [-]."""
        return characteristic_length(self.scene) / self.scene.domain.cell

    def __str__(self) -> str:
        scene, what = self.scene, self.measured
        return (
            f"cell {scene.domain.cell:.4g} m ({self.cells:.3g} across the smallest side), "
            f"{scene.particles_per_axis} particles per axis, step {scene.step_fraction:g}, "
            f"{what.resolution.precision}: an error within {100 * what.promised:.2g} % "
            f"in nine of ten scenes like those measured ({100 * what.expected:.2g} % rms, "
            f"thickness {100 * what.thickness:.2g} % of its largest), "
            f"{self.cost:.3g} times the scene's own particle-steps"
        )


def read_measured(path: Path = MEASURED) -> tuple[MeasuredResolution, ...]:
    """The measurements in a file, by default the one that ships with the solver."""
    return tuple(from_mapping(MeasuredResolution, entry) for entry in read_toml(path)["measured"])


def read_tolerance(text: str) -> float:
    """`2%` or `0.02` as a fraction in (0, 1). Raises InputError."""
    value = fraction(text)
    require(0.0 < value < 1.0, "--tolerance", "a percentage such as 2% or a fraction such as 0.02", repr(text))
    return value


def resolved(scene: Scene, tolerance: float, measured: Sequence[MeasuredResolution] | None = None) -> Resolved:
    """`scene` at the cheapest resolution whose promised error is within `tolerance`, a fraction of the extent.

    Chooses among the resolutions measured in the same dimension, without interpolation; `measured` defaults to what
    ships. Raises InputError for a tolerance below the best that was measured."""
    measured = read_measured() if measured is None else measured
    candidates = [entry for entry in measured if entry.dimension == scene.dimension]
    best = min((entry.promised for entry in candidates), default=math.inf)
    tightest = f"at least {100 * best:.2g}% in {scene.dimension}D, the tightest measured"
    require(best <= tolerance, "--tolerance", tightest, f"{100 * tolerance:.3g}%")
    suitable = [entry for entry in candidates if entry.promised <= tolerance]
    cheapest = min(suitable, key=lambda entry: entry.particle_steps)
    finer = with_resolution(scene, cheapest.resolution)
    return Resolved(scene=finer, measured=cheapest, cost=particle_steps(finer) / particle_steps(scene))


def with_resolution(scene: Scene, resolution: Resolution) -> Scene:
    """`scene` at a resolution, its grid fitted to the box and no coarser than asked; the precision is the caller's."""
    cell = fitted_cell(scene.domain, characteristic_length(scene) / resolution.cells)
    domain, points = dataclasses.replace(scene.domain, cell=cell), resolution.particles_per_axis
    step = resolution.step_fraction
    return dataclasses.replace(scene, domain=domain, particles_per_axis=points, step_fraction=step)


def fitted_cell(domain: Domain, largest: float) -> float:
    """The largest cell [m], at most `largest` [m], that divides every side of `domain`.

    It is a whole fraction of the greatest common divisor of the sides, found from the present cells of the domain."""
    common = math.gcd(*(round(length / domain.cell) for length in domain.size)) * domain.cell
    return common / math.ceil(common / largest - ROUNDING)


def characteristic_length(scene: Scene) -> float:
    """The smallest side [m] of the released bodies, each the box around masses that touch.

    A side that spans the domain from wall to wall does not count, unless all sides do."""
    lengths: list[float] = []
    across: list[float] = []
    lower, upper = corners(scene.masses)
    group = connected(lower, upper)
    for body in np.unique(group):
        extents = upper[group == body].max(axis=0) - lower[group == body].min(axis=0)
        # On a slope the box around a body is higher than its material.
        heights = [height(scene, mass) for mass, member in zip(scene.masses, group == body, strict=True) if member]
        extents[1] = min(extents[1], sum(heights))
        for axis, extent in enumerate(extents.tolist()):
            wall_to_wall = axis != 1 and extent >= scene.domain.size[axis] - TOLERANCE
            (across if wall_to_wall else lengths).append(extent)
    return min(lengths or across)


def particle_steps(scene: Scene) -> int:
    """Particles times steps of a run of `scene`, where no flow is so fast that it needs more steps."""
    substeps = substeps_per_frame(scene, [scene.material_of(mass) for mass in scene.masses])
    return particle_count(scene) * substeps * (scene.frames - 1)
