"""Dry columns and how they are computed: what `validation.bench.columns.transfer` runs."""

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

from datasets.material import Material
from datasets.scene import Domain, Mass, Scene
from mpm.resolution import Resolution, particle_steps, with_resolution
from validation.bench.accuracy.flows import Flow

YOUNG = 2.0e6
"""Young's modulus of the column in 2D at stiffness 1 [Pa]."""
LENGTH, HEIGHT = 0.2, 0.4
"""Of the column in 2D [m]."""
CUBE = Flow(aspect=1.0, friction_deg=30.0, depth=1.0, box=6.0, duration=5.0)
"""The column in 3D: a quarter of a square one, 0.1 m high, between two smooth walls of symmetry."""
USUAL = 0.0025
"""Interval of output [s]."""
APIC = 0.0
"""The relaxation time that makes the transfer APIC."""
NEVER = 1.0e6
"""A relaxation time in which nothing decays within a flow, over the default one."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A dry column of 30 degrees, and how it is computed."""

    dimension: int = 2
    cells: int = 10
    """Across its length."""
    stiffness: float = 1.0
    """Young's modulus over that of the softest column."""
    step: float = 0.9
    """As a fraction of cell / wave speed."""
    interval: float = USUAL
    """Between two frames of output in 2D [s]."""
    relaxation: float = 1.0
    """Relaxation time over the default one; 0 is APIC."""
    corrected: bool = False
    """With volume correction."""
    seed: int = 0

    def scene(self) -> Scene:
        """The scene; the column of 2D as given, that of 3D by `CUBE`."""
        scene = self.flat() if self.dimension == 2 else self.cube()
        time = None if self.relaxation == 1.0 else self.relaxation * scene.relaxation
        return dataclasses.replace(
            scene, relaxation_time=time, volume_correction=self.corrected, step_fraction=self.step, seed=self.seed
        )

    def flat(self) -> Scene:
        """0.2 x 0.4 m of sand at a smooth wall, on a floor of friction 0.385, for 1.5 s."""
        return Scene(
            domain=Domain(size=(1.6, 0.6), cell=LENGTH / self.cells),
            material=Material(friction_deg=30.0, young=YOUNG * self.stiffness),
            masses=(Mass(lower=(0.0, 0.0), size=(LENGTH, HEIGHT)),),
            duration=1.5,
            frame_dt=self.interval,
            floor_friction=0.385,
        )

    def cube(self) -> Scene:
        """`CUBE` at this stiffness."""
        stiff = dataclasses.replace(CUBE, stiffness=CUBE.stiffness * self.stiffness)
        what = Resolution(cells=self.cells, particles_per_axis=2, step_fraction=self.step, precision="f32")
        return with_resolution(stiff.scene(), what)

    @property
    def cost(self) -> int:
        """Particle-steps."""
        return particle_steps(self.scene())


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Which cases are run."""

    coarse: int = 10
    """Cells across the column in 2D where all stiffnesses and steps are tried ..."""
    fine: int = 20
    """... and where some are: up to `dearest_fine`."""
    stiffnesses: tuple[float, ...] = (1.0, 10.0, 100.0, 1000.0)
    steps: tuple[float, ...] = (0.9, 0.3, 0.1)
    intervals: tuple[float, ...] = (0.001, 0.0025, 0.005, 0.01)
    dearest_intervals: tuple[float, float] = (1.0e8, 3.0e7)
    """Particle-steps up to which intervals other than the usual one are tried, by the default and by APIC."""
    dearest_fine: float = 2.5e8
    cells: tuple[int, ...] = (10, 20, 40, 80)
    """Of the convergence; the last is what the others are held against."""
    seeds: tuple[int, ...] = (4, 4, 2, 1)
    """Of each of these."""
    relaxations: tuple[float, ...] = (APIC, 0.25, 1.0, 2.0, 4.0, NEVER)
    cells_3d: tuple[int, ...] = (6, 12)
    stiffnesses_3d: tuple[float, ...] = (1.0, 10.0, 100.0)
    steps_3d: tuple[float, ...] = (0.9, 0.1)
    dearest_3d: float = 1.5e8

    def grid(self, cells: int, relaxation: float) -> Iterator[Case]:
        """Stiffness x step x interval of output in 2D."""
        for stiffness, step, interval in product(self.stiffnesses, self.steps, self.intervals):
            case = Case(cells=cells, stiffness=stiffness, step=step, interval=interval, relaxation=relaxation)
            most = self.dearest_intervals[relaxation == APIC] if interval != USUAL else math.inf
            if cells != self.coarse:
                most = self.dearest_fine if interval == USUAL else 0.0
            if case.cost <= most:
                yield case

    def grid_3d(self, cells: int, relaxation: float) -> Iterator[Case]:
        """Stiffness x step in 3D."""
        for stiffness, step in product(self.stiffnesses_3d, self.steps_3d):
            case = Case(dimension=3, cells=cells, stiffness=stiffness, step=step, relaxation=relaxation)
            if case.cost <= self.dearest_3d:
                yield case

    def convergence(self, cells: int, relaxation: float) -> list[Case]:
        """One case a jitter on a grid of the convergence."""
        count = self.seeds[self.cells.index(cells)]
        return [Case(cells=cells, relaxation=relaxation, seed=seed) for seed in range(count)]

    def relaxed(self, cells: int) -> list[Case]:
        """Relaxation times in 2D."""
        return [Case(cells=cells, relaxation=each) for each in self.relaxations]

    def corrected(self) -> list[Case]:
        """Volume correction off and on, by the default and by APIC, on both grids."""
        return [
            Case(cells=cells, relaxation=relaxation, corrected=corrected)
            for cells in (self.coarse, self.fine)
            for relaxation in (1.0, APIC)
            for corrected in (False, True)
        ]

    def cases(self) -> list[Case]:
        """All of them, each once."""
        every: list[Case] = self.corrected()
        for relaxation in (1.0, APIC):
            for cells in (self.coarse, self.fine):
                every += self.grid(cells, relaxation)
            for cells in self.cells:
                every += self.convergence(cells, relaxation)
            for cells in self.cells_3d:
                every += self.grid_3d(cells, relaxation)
        for cells in (self.coarse, self.fine):
            every += self.relaxed(cells)
        return list(dict.fromkeys(every))


QUICK = Plan(
    coarse=5,
    fine=10,
    stiffnesses=(1.0, 10.0),
    steps=(0.9, 0.3),
    intervals=(0.0025, 0.01),
    cells=(5, 10),
    seeds=(2, 1),
    relaxations=(APIC, 1.0, NEVER),
    cells_3d=(4, 5),
    stiffnesses_3d=(1.0, 10.0),
    steps_3d=(0.9, 0.3),
)
