"""Settings of a model: what a checkpoint needs to build it again."""

from dataclasses import dataclass

from datasets.errors import InputError


@dataclass(frozen=True, kw_only=True)
class ModelSettings:
    """Resolution in space and time, and the sizes of the network."""

    dimension: int = 2
    """2 or 3."""
    cell: float = 0.01
    """Edge of the cells by which points are thinned [m]."""
    points_per_cell: int = 1
    """Points kept of each such cell."""
    frame_dt: float = 0.0025
    """Time between two frames of the training data [s]."""
    frames_per_step: int = 4
    """Frames that one step of the model spans."""
    radius: float = 0.025
    """Points closer than this [m] exchange messages."""
    history: int = 3
    """Past displacements that the network sees."""
    baffles: bool = False
    """Whether it knows baffles; one that does not runs scenes without them, and pays nothing."""
    film: bool = False
    """Whether the material scales and shifts the latents in every layer (FiLM), beside being a feature."""
    past_accelerations: bool = False
    """Whether it sees their differences too, scaled as what it has to predict; measured over a few steps only."""
    rest_speed: float = 0.01
    """Speed [m/s] below which a point soon stands still, as sand does; without it (0) deposits creep for ever."""
    width: int = 64
    """Width of every latent vector."""
    layers: int = 4
    """Message-passing layers, shared equally between the rounds."""
    hidden_layers: int = 1
    """Hidden layers of every node network."""
    rounds: int = 2
    """Rounds of a look at the background grid, then message passing."""
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
        for key in ("cell", "frame_dt", "radius", "grid_cell"):
            require(getattr(self, key) > 0.0, key, "a positive number")
        for key in ("points_per_cell", "frames_per_step", "history", "width", "layers", "rounds", "grid_channels"):
            require(getattr(self, key) >= 1, key, "an integer of at least 1")
        require(self.rest_speed >= 0.0, "rest_speed", "a speed of at least 0 m/s")
        for key in ("hidden_layers", "grid_layers"):
            require(getattr(self, key) >= 0, key, "an integer of at least 0")
        require(self.layers % self.rounds == 0, "layers", f"a multiple of the {self.rounds} rounds")

    @property
    def step(self) -> float:
        """Time that one step of the model spans [s]."""
        return self.frames_per_step * self.frame_dt

    @property
    def point_volume(self) -> float:
        """Volume that one kept point of a full cell carries [m^D]."""
        return self.cell**self.dimension / self.points_per_cell
