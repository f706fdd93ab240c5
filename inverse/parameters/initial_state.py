"""Launch: all that a rollout of the surrogate begins with, open to be changed by unknowns; and where it begins."""

import dataclasses
import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import torch
from torch import Tensor

from datasets.errors import InputError
from datasets.particles import mass_counts
from datasets.scene import Baffle, Mass, Scene
from gns.model.state import Conditions, State
from gns.score import START
from gns.start import InitialValueProblem

CLEAR_CELLS = 2.0
"""How far ahead of itself a flow is taken to feel a baffle, in cells of the MPM's grid."""


class Start(StrEnum):
    """Where a rollout of the surrogate begins."""

    REST = "rest"
    """At the scene itself: positions and velocities at time 0."""
    FRAMES = "frames"
    """Where the MPM's first twentieth of a second ends."""


@dataclass(frozen=True, kw_only=True)
class Launch:
    """An initial value problem of the surrogate; each unknown makes another one of it, differentiably."""

    state: State
    """Where the rollout begins."""
    conditions: Conditions
    """What stays as it is."""
    owner: Tensor
    """The mass that each point belongs to, an index into the scene's, shape [N]."""
    shared: Tensor
    """Whether that mass is of the scene's shared material, shape [N]."""
    step: float
    """Time that one step of the model spans [s]."""

    @staticmethod
    def of(flow: InitialValueProblem, scene: Scene, *, step: float, dtype: torch.dtype) -> "Launch":
        """The launch of `flow` in the precision of the model; `scene` says which points are of which mass."""
        counts = mass_counts(scene)
        if flow.indices.max() >= sum(counts):
            raise InputError(f"expected the {sum(counts)} points of the scene's masses, there are more")
        owner = np.repeat(np.arange(len(counts)), counts)[flow.indices]
        own_material = np.array([mass.material is not None for mass in scene.masses])
        state, conditions = flow.state, flow.conditions
        return Launch(
            state=State(positions=state.positions.to(dtype), displacements=state.displacements.to(dtype)),
            conditions=dataclasses.replace(
                conditions,
                friction=conditions.friction.to(dtype),
                cohesion=conditions.cohesion.to(dtype),
                volume=conditions.volume.to(dtype),
                baffles=None if conditions.baffles is None else conditions.baffles.to(dtype),
            ),
            owner=torch.from_numpy(owner),
            shared=torch.from_numpy(~own_material[owner]),
            step=step,
        )

    def points_of(self, mass: int | None) -> Tensor:
        """Whether each point is of `mass`, or, for None, of a mass of the shared material; shape [N]."""
        return self.shared if mass is None else self.owner == mass

    def under(self, conditions: Conditions) -> "Launch":
        """The same launch under other conditions."""
        return dataclasses.replace(self, conditions=conditions)


def untouched(scene: Scene, boxes: Iterable[Baffle]) -> bool:
    """Whether the MPM's first frames of `scene` know nothing of baffles that may stand anywhere in `boxes`.

    Until then no point gets further than |v| t + g t^2, twice as far as in a free fall.
    """
    cells = CLEAR_CELLS * scene.domain.cell
    return all(
        gap(mass, box) > math.hypot(*(mass.velocity or (0.0,))) * START + scene.gravity * START**2 + cells
        for mass in scene.masses
        for box in boxes
    )


def gap(mass: Mass, baffle: Baffle) -> float:
    """How far two boxes are apart along the axis on which they are furthest apart [m]; negative where they overlap."""
    return max(
        max(low_b - (low_m + size_m), low_m - (low_b + size_b))
        for low_m, size_m, low_b, size_b in zip(mass.lower, mass.size, baffle.lower, baffle.size, strict=True)
    )
