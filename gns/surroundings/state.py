"""Input and output of a simulation step: state and conditions, and their transfer between units and devices."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, Self

import torch
from torch import Tensor
from torch.nn import functional
from torch.nn.utils.rnn import pad_sequence

from gns.settings import ModelSettings
from gns.surroundings.units import Units


class Input(NamedTuple):
    """An input of the network: its number of columns, and their values, scaled to about one [-], [rows, columns]."""

    count: Callable[[ModelSettings], int]
    compute: Callable[..., Tensor]


def columns(features: Mapping[str, Input], settings: ModelSettings) -> int:
    """Number of columns of `features`."""
    return sum(feature.count(settings) for feature in features.values())


def computed(features: Mapping[str, Input], *given: Any) -> Tensor:
    """The columns of `features` side by side in their order, each computed from the arguments `given`."""
    return torch.cat([feature.compute(*given) for feature in features.values()], dim=1)


ABSENT = -10.0
"""Coordinates [m] of a box of zero size that replaces a missing baffle of a sample, and of missing ground."""


@dataclass(frozen=True, kw_only=True)
class Tensors:
    """A record of tensors that move together."""

    def to(self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> Self:
        """The same on another device, with real numbers in another precision; None: unchanged."""
        moved: dict[str, Any] = {}
        for name, value in vars(self).items():
            if isinstance(value, Tensor):
                moved[name] = value.to(device=device, dtype=dtype if value.is_floating_point() else None)
            elif isinstance(value, Tensors):
                moved[name] = value.to(device, dtype)
        return replace(self, **moved)


@dataclass(frozen=True, kw_only=True)
class State(Tensors):
    """Positions of the particles, and their last displacements."""

    positions: Tensor
    """Positions [m], shape [N, D]."""
    displacements: Tensor
    """The last H displacements [m per step], newest last, shape [H, N, D]."""

    @staticmethod
    def observed(frames: Tensor, velocities0: Tensor, *, step: float, history: int) -> "State":
        """From frames one step apart [F, N, D]; if too few, initial velocities give the rest. frames: [m], the last is
        the present; velocities0: those at the first frame [m/s], shape [N, D]."""
        before = (velocities0 * step).expand(history, *frames.shape[1:])
        return State(positions=frames[-1], displacements=torch.cat((before, frames[1:] - frames[:-1]))[-history:])

    def after(self, positions: Tensor, step: int) -> "State":
        """The state after so many steps of a rollout from here; positions: at its start and after each step [m]."""
        moved = torch.cat((self.displacements, positions[1 : step + 1] - positions[:step]))
        # Copies: views would keep the whole rollout in memory.
        return State(positions=positions[step].clone(), displacements=moved[step:].clone())

    @staticmethod
    def joined(states: Sequence["State"]) -> "State":
        """Samples side by side."""
        displacements = torch.cat([state.displacements for state in states], dim=1)
        return State(positions=torch.cat([state.positions for state in states]), displacements=displacements)


@dataclass(frozen=True, kw_only=True)
class Ground(Tensors):
    """Terrain as a raster of elevations at equal distances in plan, starting at the corner of the box."""

    elevation: Tensor
    """Elevation [m], shape [B, X], in 3D [B, X, Z]; may require a gradient."""
    friction: Tensor
    """Coulomb coefficient [-], of the same shape."""
    spacing: float
    """Distance between two elevations [m]."""
    drag: Tensor | None = None
    """1 / xi of Voellmy's turbulent friction [s^2/m], of the same shape; None without turbulence."""


@dataclass(frozen=True, kw_only=True)
class Conditions(Tensors):
    """The constants of a rollout of B samples side by side; each tensor may require a gradient."""

    friction: Tensor
    """tan(phi) of each particle [-], shape [N]."""
    cohesion: Tensor
    """Cohesion of each particle [Pa], shape [N]."""
    volume: Tensor
    """Initial volume of each particle [m^D], shape [N]."""
    size: Tensor
    """Extent of the box [0, size] of each sample [m], shape [B, D]."""
    gravity: Tensor
    """Gravitational acceleration [m/s^2], shape [B, D]."""
    floor_friction: Tensor
    """Coulomb coefficient of the floor [-], shape [B]; above a terrain `Moment.bed` takes its place."""
    wall_friction: Tensor
    """Coulomb coefficient of the other walls [-], shape [B]."""
    damping: Tensor
    """Local damping [-], shape [B]."""
    batch: Tensor | None = None
    """Sample that each particle belongs to, shape [N]; None if there is only one."""
    baffles: Tensor | None = None
    """Lower and upper corner of the K baffles of each sample before their turn [m], shape [B, K, 2, D]."""
    baffle_turn: Tensor | None = None
    """Turn of these about their centres [rad], in 2D from x to y, in 3D from x to z, [B, K]; None if none is turned."""
    baffle_friction: Tensor | None = None
    """Coulomb coefficient of these baffles [-], shape [B, K]."""
    ground: Ground | None = None
    """Terrain; None if no sample has any."""
    units: Units = field(default_factory=Units)
    """Size of the model's units in these samples."""

    def of_particles(self, values: Tensor) -> Tensor:
        """Values of the samples [B, ...], for each particle [N or 1, ...]."""
        return values if self.batch is None else values.index_select(0, self.batch)

    def total(self, values: Tensor) -> Tensor:
        """Sum of values of the particles [N, C] over each sample, shape [B, C]."""
        if self.batch is None:
            return values.sum(dim=0, keepdim=True)
        return values.new_zeros(len(self.size), values.shape[1]).index_add(0, self.batch, values)

    @staticmethod
    def joined(samples: Sequence["Conditions"]) -> "Conditions":
        """Join conditions of one sample each, all in the same units, differentiably. Missing baffles become boxes of
        zero size far outside, missing terrain becomes ground far below; small rasters continue level."""
        names = ("friction", "cohesion", "volume", "size", "gravity", "floor_friction", "wall_friction", "damping")
        together: dict[str, Any] = {name: torch.cat([getattr(sample, name) for sample in samples]) for name in names}
        counts = [0 if sample.baffles is None else sample.baffles.shape[1] for sample in samples]
        for name, absent in (("baffles", ABSENT), ("baffle_turn", 0.0), ("baffle_friction", 0.0)):
            given = [getattr(sample, name) for sample in samples]
            if some := [tensor for tensor in given if tensor is not None]:
                none = [some[0].new_full((count, *some[0].shape[2:]), absent) for count in counts]
                rows = [other if tensor is None else tensor[0] for tensor, other in zip(given, none, strict=True)]
                together[name] = pad_sequence(rows, batch_first=True, padding_value=absent)
        if grounds := [sample.ground for sample in samples if sample.ground is not None]:
            shape = [max(counts) for counts in zip(*(ground.elevation.shape[1:] for ground in grounds), strict=True)]
            rasters = {
                name: torch.cat([level(sample.ground, name, shape, absent) for sample in samples])
                for name, absent in (("elevation", ABSENT), ("friction", 0.0), ("drag", 0.0))
                if any(getattr(ground, name) is not None for ground in grounds)
            }
            together["ground"] = Ground(**rasters, spacing=grounds[0].spacing)
        particles = torch.tensor([len(sample.friction) for sample in samples])
        batch = torch.arange(len(samples)).repeat_interleave(particles)
        return Conditions(batch=batch, units=samples[0].units, **together)


def in_model_units(state: State, conditions: Conditions) -> tuple[State, Conditions]:
    """A state and its conditions in the units of the model; nothing else scales the input of a simulator."""
    units, ground = conditions.units, conditions.ground
    if units == Units():
        return state, conditions
    length = units.length
    if ground is not None:
        drag = None if ground.drag is None else ground.drag * (length / units.time**2)
        ground = replace(ground, elevation=ground.elevation / length, spacing=ground.spacing / length, drag=drag)
    scaled = replace(
        conditions,
        cohesion=conditions.cohesion / units.stress,
        volume=conditions.volume / length ** conditions.size.shape[1],
        size=conditions.size / length,
        gravity=conditions.gravity * (units.time**2 / length),
        baffles=None if conditions.baffles is None else conditions.baffles / length,
        ground=ground,
        units=Units(),
    )
    return State(positions=state.positions / length, displacements=state.displacements / length), scaled


def level(ground: Ground | None, name: str, shape: Sequence[int], absent: float) -> Tensor:
    """A raster of one sample's ground, continued level to a larger shape; a constant raster without ground."""
    raster: Tensor | None = getattr(ground, name, None)
    if raster is None:
        return torch.full((1, *shape), absent)
    behind = [end for count, length in zip(shape, raster.shape[1:], strict=True) for end in (count - length, 0)]
    return functional.pad(raster, behind[::-1], mode="replicate")
