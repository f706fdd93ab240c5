"""Slopes with a known factor of safety (`slopes.toml`), and the factor from `mpm.safety_factor` over it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from datasets.files import read_toml
from datasets.scene import Domain, Mass, Scene
from datasets.scene.material import Material
from datasets.schema import Record, from_mapping
from mpm.safety import Safety, safety_factor
from validation.bench.page import Row, percent

HEIGHT, DENSITY = 10.0, 2000.0
WEIGHT = DENSITY * 9.81 * HEIGHT  # rho g H [Pa]
CELLS = (10, 20, 40)  # over the height


@dataclass(frozen=True, kw_only=True)
class KnownSlope(Record):
    """A slope above a rough floor at its toe, of a material that carries tension up to the apex of its cone."""

    name: str
    factor: float  # its factor of safety [-]
    source: str
    steepness_deg: float
    friction_deg: float
    cohesion: float = 0.0  # c / (rho g H) [-]
    dilates: bool = True  # psi = phi, as in limit analysis and charts; else psi = 0

    def scene(self, cells: int) -> Scene:
        """The scene with so many cells over the height."""
        run, cell = HEIGHT / math.tan(math.radians(self.steepness_deg)), HEIGHT / cells
        corners = ((0.0, 0.0), (1.5 * HEIGHT + run, 0.0), (1.5 * HEIGHT, HEIGHT), (0.0, HEIGHT))
        length, tall = (cell * math.ceil(extent / cell) for extent in (2.1 * HEIGHT + run, 1.2 * HEIGHT))
        return Scene(
            domain=Domain(size=(length, tall), cell=cell),
            material=Material(
                friction_deg=self.friction_deg,
                dilation_deg=self.friction_deg if self.dilates else 0.0,
                cohesion=self.cohesion * WEIGHT,
                density=DENSITY,
                tension_cutoff=1.0e9,
            ),
            masses=(Mass(kind="polygon", vertices=corners),),
            floor_friction="rough",
        )


KNOWN = tuple(from_mapping(KnownSlope, each) for each in read_toml(Path(__file__).with_suffix(".toml"))["slopes"])
TAYLOR, _, BISHOP, SAND = KNOWN
WITHOUT_DILATION = tuple(
    replace(each, name=each.name.replace("φ = ψ", "ψ = 0, φ"), source=f"{each.source} for ψ = φ", dilates=False)
    for each in (BISHOP, SAND)
)

Factors = Mapping[KnownSlope, Mapping[int, Safety]]  # what was found of each slope, by its cells over the height


def factors(slopes: Sequence[KnownSlope]) -> Factors:
    return {slope: {count: safety_factor(slope.scene(count)) for count in CELLS} for slope in slopes}


def rows(by_slope: Factors) -> list[Row]:
    """Computed over known factors, and seconds, by number of cells."""
    return [
        {"slope": slope.name, "known": f"{slope.factor:.3f}, {slope.source}"}
        | {f"{count} cells": f"{computed.factor / slope.factor:.3f}" for count, computed in by_cells.items()}
        | {"seconds": ", ".join(f"{computed.seconds:.0f}" for computed in by_cells.values())}
        for slope, by_cells in by_slope.items()
    ]


def conclusion(by_slope: Factors) -> str:
    """The largest deviation from a known factor, by number of cells, for factors known for the computed law."""
    slopes = {slope: by_cells for slope, by_cells in by_slope.items() if slope in KNOWN}
    off = {
        count: max(abs(by_cells[count].factor / slope.factor - 1.0) for slope, by_cells in slopes.items())
        for count in next(iter(slopes.values()))
    }
    most = ", ".join(f"{percent(value)} with {count}" for count, value in off.items())
    count = len(slopes)
    return f"Factors of safety of {count} slopes differ from the known ones by at most {most} cells over the height."
