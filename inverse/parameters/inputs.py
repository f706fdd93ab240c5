"""How numbers enter the surrogate: an initial state with a value, differentiable in it."""

import dataclasses
import math

import torch
from torch import Tensor

from datasets.geometry.ground import ground_raster
from datasets.scene.material import sine_of_slope
from gns.surroundings.initial import InitialState
from inverse.parameters.kind import Constant, Extent, Kind


def friction(kind: Constant, initial: InitialState, value: Tensor) -> InitialState:
    """Angle of friction [deg], an input as tan(phi) (`datasets.scene.material`: which angle)."""
    known, material = initial.conditions.friction, kind.material(initial.scene)
    tangent = torch.tan(torch.deg2rad(value))
    if material.angle == "slope":
        sine = sine_of_slope(tangent, math.radians(material.dilation_deg))
        tangent = sine / torch.sqrt(1.0 - sine * sine)
    friction = torch.where(initial.of_mass(kind.index), tangent.to(known.dtype), known)
    return initial.with_conditions(friction=friction)


def cohesion(kind: Constant, initial: InitialState, value: Tensor) -> InitialState:
    """Cohesion at the top [Pa]; its growth with depth stays."""
    known, material = initial.conditions.cohesion, kind.material(initial.scene)
    changed = known + (value - material.cohesion).to(known.dtype)
    return initial.with_conditions(cohesion=torch.where(initial.of_mass(kind.index), changed, known))


def velocity(kind: Kind, initial: InitialState, value: Tensor) -> InitialState:
    """Initial velocity of a mass [m/s]: its particles' history is as if they had always moved with it."""
    state = initial.state
    along = torch.arange(state.positions.shape[1]) == kind.axis
    own = initial.of_mass(kind.index).unsqueeze(1) & along
    displacement = (value * initial.step).to(state.displacements.dtype)
    thrown = dataclasses.replace(state, displacements=torch.where(own, displacement, state.displacements))
    return dataclasses.replace(initial, state=thrown)


def baffle(kind: Extent, initial: InitialState, value: Tensor) -> InitialState:
    """Centre or extent of a baffle [m]."""
    boxes, index = initial.conditions.baffles, kind.index or 0
    assert boxes is not None, "the scene has baffles, and so has the model"
    number, corner, axis = torch.meshgrid(*map(torch.arange, boxes.shape[1:]), indexing="ij")
    own = torch.eq(number, index) & torch.eq(axis, kind.axis or 0)
    lower, upper = boxes[0, index, :, kind.axis]
    low, size = kind.moved(lower, upper - lower, value.to(boxes.dtype))
    return initial.with_conditions(baffles=torch.where(own, low + corner * size, boxes))


def baffle_friction(kind: Kind, initial: InitialState, value: Tensor) -> InitialState:
    """Friction of the baffles that have none of their own [-]."""
    known = initial.conditions.baffle_friction
    assert known is not None, "the scene has baffles, and so has the model"
    shared = torch.tensor([baffle.friction is None for baffle in initial.scene.baffles])
    return initial.with_conditions(baffle_friction=torch.where(shared, value.to(known.dtype), known))


def constant(kind: Kind, initial: InitialState, value: Tensor) -> InitialState:
    """Friction of the walls, damping [-]."""
    known = getattr(initial.conditions, kind.key)
    return initial.with_conditions(**{kind.key: value.to(known.dtype).expand_as(known)})


def floor_friction(kind: Kind, initial: InitialState, value: Tensor) -> InitialState:
    """Friction of the floor [-], also where it is the ground beside terrain."""
    return ground_friction(kind, constant(kind, initial, value), value)


def ground_friction(kind: Kind, initial: InitialState, value: Tensor) -> InitialState:
    """Friction where the ground is the terrain of this index, without an index the floor [-]."""
    ground = initial.conditions.ground
    if ground is None:
        return initial
    own = torch.from_numpy(
        ground_raster(initial.scene, ground.spacing)[2] == (-1 if kind.index is None else kind.index)
    )
    found = torch.where(own, value.to(ground.friction.dtype), ground.friction)
    return initial.with_conditions(ground=dataclasses.replace(ground, friction=found))
