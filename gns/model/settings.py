"""Settings of a model: what a checkpoint needs to build it again."""

import math
from dataclasses import dataclass

from datasets.errors import InputError
from datasets.records import Record

GRAVITY = 9.81
"""Gravitational acceleration of all training data [m/s^2]."""
SMALLEST, LARGEST = 1.0e-6, 1.0e6
"""Lengths [m], times [s], densities [kg/m^3] and speeds [m/s] of any model are between them."""
MOST_CELLS = 32
"""Cells of the thinning over the cut-off radius, or a cell of the grid: a particle has as many neighbours, squared."""
MOST = 10_000
SHORTEST = 0.01
"""Step over the time in which a grain falls half a cell: shorter ones say nothing and take for ever."""


@dataclass(frozen=True, kw_only=True)
class ModelSettings(Record):
    """Resolution in space and time, and the sizes of the network."""

    dimension: int = 2
    """2 or 3."""
    cell: float = 0.01
    """Edge of the cells by which particles are thinned [m]."""
    particles_per_cell: int = 1
    """Particles kept of each such cell."""
    frame_dt: float = 0.0025
    """Time between two frames of the training data [s]."""
    frames_per_step: int = 4
    """Frames that one step of the model spans."""
    radius: float = 0.025
    """Cutoff radius [m]: particles closer than this exchange messages."""
    history: int = 3
    """Past displacements among the node features."""
    body_length: float | None = None
    """Length of a released body in the training data [m], the root of its volume, to which scenes are scaled
    (`gns.units`); None for scenes that are run as they are."""
    density: float = 1800.0
    """Density in the training data [kg/m^3]."""
    rest_speed: float = 0.03
    """Speed [m/s] below which a displacement fades, as static friction; without it (0) deposits creep for ever."""
    width: int = 64
    """Width of every latent vector."""
    layers: int = 4
    """Message-passing steps, shared equally between the rounds."""
    mlp_layers: int = 1
    """Hidden layers of every perceptron of nodes."""
    rounds: int = 2
    """Rounds of grid context, then message passing."""
    grid_cell: float = 0.02
    """Edge of a cell of the background grid [m]."""
    grid_channels: int = 32
    """Channels on the background grid."""
    grid_layers: int = 4
    """Convolutions on the background grid per round, with dilations 1, 2, 4, ..."""

    def __post_init__(self) -> None:
        def require(ok: bool, key: str, expected: str) -> None:
            if not ok:
                raise InputError(f"expected {expected}, got {getattr(self, key)}", key=key)

        require(self.dimension in (2, 3), "dimension", "2 or 3")
        lengths = "cell", "radius", "grid_cell", *(() if self.body_length is None else ("body_length",))
        for key in (*lengths, "frame_dt", "density"):
            require(SMALLEST <= getattr(self, key) <= LARGEST, key, f"a positive number, {SMALLEST:g} to {LARGEST:g}")
        for key in ("radius", "grid_cell"):
            ratio = getattr(self, key) / self.cell
            require(1.0 / MOST_CELLS <= ratio <= MOST_CELLS, key, f"a length of 1/{MOST_CELLS} to {MOST_CELLS} cells")
        for key in ("particles_per_cell", "frames_per_step", "history", "width", "layers", "rounds", "grid_channels"):
            require(1 <= getattr(self, key) <= MOST, key, f"an integer of at least 1, up to {MOST}")
        require(0.0 <= self.rest_speed <= LARGEST, "rest_speed", "a speed of at least 0 m/s")
        for key in ("mlp_layers", "grid_layers"):
            require(0 <= getattr(self, key) <= MOST, key, f"an integer of at least 0, up to {MOST}")
        fall = math.sqrt(self.cell / GRAVITY)
        expected = f"steps of at least {SHORTEST:g} of the {fall:.3g} s in which a grain falls half a cell"
        require(self.step >= SHORTEST * fall, "frame_dt", expected)
        require(self.layers % self.rounds == 0, "layers", f"a multiple of the {self.rounds} rounds")

    @property
    def step(self) -> float:
        """Time that one step of the model spans [s]."""
        return self.frames_per_step * self.frame_dt

    @property
    def particle_volume(self) -> float:
        """Volume that one kept particle of a full cell carries [m^D]."""
        return self.cell**self.dimension / self.particles_per_cell
