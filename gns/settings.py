"""Settings: those that a checkpoint needs to rebuild its model, and those of a training. Nothing here needs torch."""

from dataclasses import dataclass
from typing import Annotated, Literal

from datasets.errors import require
from datasets.schema import Bounds, Record

GRAVITY = 9.81  # gravitational acceleration of all training data [m/s^2]
UP = 1  # the axis that points up
Positive = Annotated[float, Bounds("a positive number", gt=0.0)]
NotNegative = Annotated[float, Bounds("a number of at least 0", ge=0.0)]
Count = Annotated[int, Bounds("an integer of at least 1", ge=1)]
Steps = Annotated[int, Bounds("an integer of 1 to 100", ge=1, le=100)]
SEED = Bounds("an integer from 0 to 2^62", ge=0, le=2**62)
Layers = Annotated[int, Bounds("a number of 0 to 100", ge=0, le=100)]


@dataclass(frozen=True, kw_only=True)
class ModelSettings(Record):
    """Resolution in space and time, and the sizes of the network."""

    dimension: int = 2
    """2 or 3."""
    cell: Positive = 0.01
    """Edge of the cells by which particles are thinned [m]."""
    particles_per_cell: Count = 1
    """Particles kept of each such cell."""
    frame_dt: Positive = 0.0025
    """Time between two frames of the training data [s]."""
    frames_per_step: Count = 4
    """Frames that one step of the model spans."""
    radius: Positive = 0.025
    """Cutoff radius [m]: particles closer than this exchange messages."""
    history: Count = 3
    """Past displacements among the node features."""
    body_length: Positive | None = None
    """Length of a released body in the training data [m], the root of its volume. Scenes are scaled to it
    (`gns.surroundings.units.Units`); without it they run at their own size."""
    density: Positive = 1800.0
    """Density in the training data [kg/m^3]."""
    bed_friction: bool = True
    """Whether the basal friction on terrain is the terrain's own, along it; older models use that of a level floor."""
    rest_speed: NotNegative = 0.03
    """Speed [m/s] below which a displacement fades, as static friction; without it (0) deposits creep."""
    width: Count = 64
    """Width of every latent vector."""
    layers: Steps = 4
    """Message-passing steps, shared equally between the rounds."""
    mlp_layers: Layers = 1
    """Hidden layers of every perceptron of nodes."""
    rounds: Steps = 2
    """Rounds of grid context, then message passing."""
    grid_cell: Positive = 0.02
    """Edge of a cell of the background grid [m]."""
    grid_channels: Count = 32
    """Channels on the background grid."""
    grid_layers: Layers = 4
    """Convolutions on the background grid per round, with dilations 1, 2, 4, ..."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.dimension in (2, 3), "dimension", "2 or 3", self.dimension)
        require(self.layers % self.rounds == 0, "layers", f"a multiple of the {self.rounds} rounds", self.layers)

    @property
    def step(self) -> float:
        """Time that one step of the model spans [s]."""
        return self.frames_per_step * self.frame_dt

    @property
    def particle_volume(self) -> float:
        """Volume that one kept particle of a full cell carries [m^D]."""
        return self.cell**self.dimension / self.particles_per_cell


@dataclass(frozen=True, kw_only=True)
class TrainingSettings(Record):
    """How a model is fitted, and how long."""

    correct: bool = False
    """Train only the correction of whole rollouts (`gns.network.correction`); unroll and loss_scale have no effect."""
    rollouts: Count = 2
    """Rollouts per flow that a correction learns from; particles, symmetry and start time are drawn for each."""
    minutes: Positive = 60.0
    """Time to train [min], including all parts of a resumed run; steps and learning rate are spread over it."""
    updates: Count | None = None
    """Number of updates, in place of the minutes."""
    clock: Literal["wall", "cpu"] = "wall"
    """How the minutes are counted: as wall time, or as CPU time, which is fair between runs on a busy machine."""
    batch: Count = 3
    """Samples per update, of each process."""
    shares: tuple[float, ...] = ()
    """Share of the samples from each dataset, in their order; equal unless given."""
    unroll: tuple[int, ...] = (1, 2, 4, 4, 8, 8, 12, 12)
    """Steps to train through; the entries share the budget equally."""
    learning_rate: Positive = 6.0e-4
    """Learning rate at the start."""
    final_learning_rate: float = 1.0e-5
    """Learning rate at the end; half a cosine in between."""
    warmup: int = 100
    """Updates over which the learning rate rises from zero."""
    clip: float = 1.0
    """Largest norm of the gradient."""
    loss_scale: Positive = 0.25
    """Errors up to this share of the accelerations' standard deviation count quadratically, larger ones linearly."""
    density_weight: NotNegative = 0.0
    """Weight of the error of the density at the grid nodes after the last step (heights and volume); 0: none."""
    first: float = 0.15
    """Share of samples that start at the release, from positions and velocities alone."""
    average: float = 0.998
    """Decay of the running average of the weights; the average is scored and shipped."""
    validations: Count = 12
    """Number of validations, evenly spaced in the budget; if several, one more scores the weights of --begin."""
    validation_share: Annotated[float, Bounds("a share in (0, 1]", gt=0.0, le=1.0)] = 0.15
    """Largest share of the minutes for validations, except the first and the last; it may reduce their number."""
    validate_flows: Count = 8
    """Flows to roll out per validation, spread over the valid splits."""
    memory_gib: Positive = 4.0
    """Memory per process for the activations of unrolled steps; those that do not fit are recomputed."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(min(self.unroll, default=0) >= 1, "unroll", "integers of at least 1", list(self.unroll))
        some = not self.shares or (min(self.shares) >= 0.0 and sum(self.shares) > 0.0)
        require(some, "shares", "shares of at least 0, not all of them 0", list(self.shares))
