"""The dry columns of the page on the transfer, and how each is computed."""

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
DEFAULT, APIC = 1.0, 0.0
"""Relaxation times over the default one; that of 0 is APIC."""
INFINITE = 1.0e6
"""A relaxation time in which nothing decays within a flow, over the default one."""


@dataclass(frozen=True, kw_only=True)
class Column:
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
    relaxation: float = DEFAULT
    """Relaxation time over the default one."""
    corrected: bool = False
    """With volume correction."""
    seed: int = 0

    def scene(self) -> Scene:
        """In 2D 0.2 x 0.4 m at a smooth wall, on a floor of friction 0.385, for 1.5 s; in 3D `CUBE`."""
        if self.dimension == 2:
            scene = Scene(
                domain=Domain(size=(1.6, 0.6), cell=LENGTH / self.cells),
                material=Material(friction_deg=30.0, young=YOUNG * self.stiffness),
                masses=(Mass(lower=(0.0, 0.0), size=(LENGTH, HEIGHT)),),
                duration=1.5,
                frame_dt=self.interval,
                floor_friction=0.385,
            )
        else:
            stiff = dataclasses.replace(CUBE, stiffness=CUBE.stiffness * self.stiffness).scene()
            scene = with_resolution(
                stiff, Resolution(cells=self.cells, particles_per_axis=2, step_fraction=self.step, precision="f32")
            )
        return dataclasses.replace(
            scene,
            relaxation_time=None if self.relaxation == DEFAULT else self.relaxation * scene.relaxation,
            volume_correction=self.corrected,
            step_fraction=self.step,
            seed=self.seed,
        )

    @property
    def cost(self) -> int:
        """Particle-steps."""
        return particle_steps(self.scene())


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Which columns are run."""

    coarse: int = 10
    """Cells across the column in 2D where all stiffnesses and steps are tried ..."""
    fine: int = 20
    """... and where some are: up to `most_fine`."""
    stiffnesses: tuple[float, ...] = (1.0, 10.0, 100.0, 1000.0)
    steps: tuple[float, ...] = (0.9, 0.3, 0.1)
    intervals: tuple[float, ...] = (0.001, 0.0025, 0.005, 0.01)
    most_intervals: tuple[float, float] = (1.0e8, 3.0e7)
    """Particle-steps up to which intervals other than the usual one are tried, by the default and by APIC."""
    most_fine: float = 2.5e8
    """Particle-steps up to which stiffnesses and steps are tried on the fine cells."""
    cells: tuple[int, ...] = (10, 20, 40, 80)
    """Of the convergence; the last is the reference."""
    seeds: tuple[int, ...] = (4, 4, 2, 1)
    """Of each of these."""
    relaxations: tuple[float, ...] = (APIC, 0.25, DEFAULT, 2.0, 4.0, INFINITE)
    cells_3d: tuple[int, ...] = (6, 12)
    stiffnesses_3d: tuple[float, ...] = (1.0, 10.0, 100.0)
    steps_3d: tuple[float, ...] = (0.9, 0.1)
    most_3d: float = 1.5e8
    """The same in 3D."""

    def grid(self, cells: int, relaxation: float) -> Iterator[Column]:
        """Stiffness x step x interval of output in 2D."""
        for stiffness, step, interval in product(self.stiffnesses, self.steps, self.intervals):
            column = Column(cells=cells, stiffness=stiffness, step=step, interval=interval, relaxation=relaxation)
            most = self.most_intervals[relaxation == APIC] if interval != USUAL else math.inf
            if cells != self.coarse:
                most = self.most_fine if interval == USUAL else 0.0
            if column.cost <= most:
                yield column

    def grid_3d(self, cells: int, relaxation: float) -> Iterator[Column]:
        """Stiffness x step in 3D."""
        for stiffness, step in product(self.stiffnesses_3d, self.steps_3d):
            column = Column(dimension=3, cells=cells, stiffness=stiffness, step=step, relaxation=relaxation)
            if column.cost <= self.most_3d:
                yield column

    def convergence(self, cells: int, relaxation: float) -> list[Column]:
        """One column a jitter on a grid of the convergence."""
        count = self.seeds[self.cells.index(cells)]
        return [Column(cells=cells, relaxation=relaxation, seed=seed) for seed in range(count)]

    def relaxed(self, cells: int) -> list[Column]:
        """Relaxation times in 2D."""
        return [Column(cells=cells, relaxation=each) for each in self.relaxations]

    def corrected(self) -> list[tuple[Column, Column]]:
        """Without and with volume correction, by the default and by APIC, on both grids."""
        plain = [Column(cells=cells, relaxation=each) for cells in (self.coarse, self.fine) for each in (DEFAULT, APIC)]
        return [(column, dataclasses.replace(column, corrected=True)) for column in plain]

    def columns(self) -> list[Column]:
        """All of them, each once."""
        every = [column for pair in self.corrected() for column in pair]
        for relaxation in (DEFAULT, APIC):
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
    relaxations=(APIC, DEFAULT, INFINITE),
    cells_3d=(4, 5),
    stiffnesses_3d=(1.0, 10.0),
    steps_3d=(0.9, 0.3),
)
