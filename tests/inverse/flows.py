"""A tiny random model, small flows against baffles in 2D and 3D, and one over terrain."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from datasets import Baffle, Mass, Material, Scene, Solid
from datasets.scene.grid_field import Floats
from gns.settings import ModelSettings
from gns.simulator import Normalisation, Simulator
from inverse import Parameter, Problem, TargetSettings
from inverse.observations import DepositSettings, FrontSettings, Observation
from inverse.observations.errors import Covariance
from inverse.observations.target import Target
from inverse.parameters import kind
from tests.scenes import scene_of

SAND = Material(friction_deg=30.0, cohesion=100.0, tension_cutoff=50.0)
STRONG = dataclasses.replace(SAND, cohesion=300.0)
ROUGH = {"floor_friction": 0.4, "wall_friction": 0.3, "baffle_friction": 0.2, "damping": 0.1}
PLANE: dict[str, Any] = {"size": (0.4, 0.2), "cell": 0.01, "material": SAND, "duration": 0.08, **ROUGH}
BUMP = ((0.0, -0.05), (0.08, -0.05), (0.11, 0.04), (0.16, -0.05), (0.4, -0.05))
"""On the slope of the terrain, with the floor beyond it."""
FLOWS: dict[int | str, Scene] = {
    2: scene_of(
        Mass(lower=(0.01, 0.0), size=(0.08, 0.03), velocity=(0.8, 0.0)),
        Mass(lower=(0.01, 0.03), size=(0.06, 0.03), velocity=(1.4, 0.2), material=STRONG),
        baffles=(
            Baffle(lower=(0.123, 0.0), size=(0.029, 0.018)),
            Baffle(lower=(0.16, 0.0), size=(0.02, 0.03), friction=0.6),
        ),
        **PLANE,
    ),
    3: scene_of(
        Mass(lower=(0.0, 0.0, 0.05), size=(0.15, 0.125, 0.15), velocity=(1.5, 0.0, 0.0)),
        baffles=tuple(Baffle(lower=(0.2, 0.0, z), size=(0.05, 0.1, 0.08)) for z in (0.02, 0.15)),
        **(PLANE | {"size": (0.5, 0.25, 0.25), "cell": 0.03125}),
    ),
    "terrain": scene_of(
        Mass(lower=(0.02, 0.072), size=(0.06, 0.04), velocity=(1.4, -0.5)),
        solids=(
            Solid(kind="terrain", points=((0.0, 0.08), (0.16, 0.0), (0.2, -0.05), (0.4, -0.05)), friction=0.5),
            Solid(kind="terrain", points=BUMP, friction=0.2),
        ),
        slope_deg=10.0,
        **PLANE,
    ),
}
FRONT = FrontSettings().operator(FLOWS[2])
W, M = 30, 7  # white numbers and observed ones of `LinearFlow`
WIDE = {"deg": 8.0, "Pa": 50.0, "m/s": 0.5, "m": 0.005, "-": 0.08}  # half of a range between bounds, by its unit


class LinearFlow:
    """In place of a flow over white numbers: M numbers that are linear in W of them, apart from a bend."""

    def __init__(self, matrix: Floats, bend: float = 0.0) -> None:
        self.matrix, self.bend, self.runs = matrix, bend, 0

    def mean(self, white: Floats, seeds: Sequence[int]) -> Floats:
        self.runs += len(seeds)
        linear = self.matrix @ white
        return np.asarray(linear + self.bend * linear**3)

    def jacobian(self, white: Floats, rows: Floats, seeds: Sequence[int]) -> Floats:
        return np.asarray(rows @ ((1.0 + 3.0 * self.bend * (self.matrix @ white) ** 2)[:, None] * self.matrix))


def target_of(values: Floats, errors: Covariance | float = 0.0, observation: Observation = FRONT) -> Target:
    """Numbers to find, whatever was observed; errors: their covariance, or one standard deviation of all."""
    stated = errors if isinstance(errors, Covariance) else Covariance(np.full(len(values), errors))
    return Target(observation=observation, values=values, errors=stated)


def simulator_of(dimension: int) -> Simulator:
    """A model that takes milliseconds and whose output matters, in double precision; its units are not a flow's."""
    torch.manual_seed(0)
    flat = dimension == 2
    cell = 0.01 if flat else 0.03125
    lengths = {"cell": cell, "radius": 2.5 * cell, "grid_cell": 2.0 * cell, "body_length": 0.1 if flat else 0.25}
    network = {"width": 16, "layers": 2, "rounds": 1, "grid_channels": 8, "grid_layers": 2}
    count = 1 if flat else 2
    settings = ModelSettings(dimension=dimension, particles_per_cell=count, rest_speed=0.01, **lengths, **network)
    scales = Normalisation(displacement_scale=0.005, acceleration_scale=0.001, friction_mean=0.6, friction_std=0.2)
    made = Simulator(settings, scales)
    with torch.no_grad():
        made.network.decoder.mlp[-1].weight.normal_(std=0.3)
    return made.double().requires_grad_(False)


def problem_of(flow: int | str, *names: str) -> Problem:
    """The small flow with these parameters, each between bounds around the scene's own value."""
    scene = FLOWS[flow]
    parameters = []
    for name in names:
        value, half = kind(name).read(scene), WIDE[kind(name).unit]
        parameters.append(Parameter(name=name, initial=value, lower=value - half, upper=value + half))
    made = {"name": "small", "folder": Path(), "scene": scene, "parameters": tuple(parameters)}
    return Problem(**made, observations=(DepositSettings(),), target=TargetSettings(twin=True))
