"""A tiny model, a random cloud, and flows with a formula."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from datasets import Mass, Material, Trajectory, command_line
from datasets.scene.particles import initial_particles
from gns.settings import ModelSettings
from gns.simulator import Normalisation, Simulator
from gns.surroundings.initial import conditions_of
from gns.surroundings.state import Conditions, State
from gns.surroundings.units import Units
from gns.train import train
from tests.scenes import flow_of, scene_of

NORMALISATION = Normalisation(displacement_scale=3e-3, acceleration_scale=7e-4, friction_mean=0.6, friction_std=0.2)
Cloud = Callable[..., tuple[State, Conditions]]
TINY = [
    *("--width", "8", "--layers", "1", "--rounds", "1", "--grid-channels", "4", "--grid-layers", "1"),
    *("--threads", "1", "--unroll", "1", "--unroll", "2", "--validate-flows", "1", "--device", "cpu"),
]
"""Flags of a training that takes a second."""


def run_train(dataset: Path, out: Path, *flags: str) -> int:
    """Train; the exit status."""
    return command_line.run(train, "train", [str(dataset), "--out", str(out), *flags])


def rows(out: Path) -> list[dict[str, str]]:
    """Those of the log of a training."""
    with (out / "log.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.fixture
def settings() -> ModelSettings:
    """A model that takes milliseconds."""
    return ModelSettings(history=3, width=16, layers=2, rounds=2, grid_channels=8, grid_layers=2)


@pytest.fixture
def simulator(settings: ModelSettings) -> Simulator:
    """The untrained tiny model."""
    torch.manual_seed(1)
    return Simulator(settings, NORMALISATION)


@pytest.fixture
def lively(simulator: Simulator) -> Simulator:
    """The tiny model with an output that matters."""
    with torch.no_grad():
        simulator.network.decoder.mlp[-1].weight.normal_(std=0.3)
    return simulator


@pytest.fixture
def cloud(settings: ModelSettings) -> Cloud:
    """A block of 10 x 12 jittered points in a box of one metre, and what it takes to move it."""

    def build(
        lower: tuple[float, float] = (0.45, 0.3), velocity: tuple[float, float] = (0.0, 0.0), seed: int = 0
    ) -> tuple[State, Conditions]:
        generator = torch.Generator().manual_seed(seed)
        lattice = torch.cartesian_prod(torch.arange(10.0), torch.arange(12.0)) + 0.5
        jitter = 0.6 * (torch.rand(lattice.shape, generator=generator) - 0.5)
        positions = torch.tensor(lower) + settings.cell * (lattice + jitter)
        velocities = torch.tensor(velocity).expand_as(positions)
        state = State.observed(positions[None], velocities, step=settings.step, history=settings.history)
        numbers = {"friction": 0.5, "cohesion": 100.0, "volume": settings.particle_volume}
        per_particle = {name: torch.full((len(positions),), value) for name, value in numbers.items()}
        scene = scene_of(floor_friction=0.4, wall_friction=0.2, damping=0.1)
        return state, conditions_of(scene, settings.cell, **per_particle, units=Units())

    return build


def spreading(friction_deg: float, *, duration: float = 0.25, seed: int = 0) -> Trajectory:
    """A column at the left wall that spreads and flattens at constant volume, the less the rougher it is."""
    column, sand = Mass(lower=(0.0, 0.0), size=(0.12, 0.16)), Material(friction_deg=friction_deg)
    scene = scene_of(column, size=(0.6, 0.4), cell=0.01, material=sand, duration=duration, seed=seed)
    points = initial_particles(scene)
    time = np.arange(scene.frames) * scene.frame_dt
    stretch = 1.0 + (1.2 - points.friction[0]) * (1.0 - np.cos(np.pi * time / duration))
    return flow_of(scene, points.positions * np.stack((stretch, 1.0 / stretch), axis=1)[:, None])


@pytest.fixture(scope="session")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Spreading columns: four to train, two to validate, one to test."""
    folder = tmp_path_factory.mktemp("spreading")
    for split, count in (("train", 4), ("valid", 2), ("test", 1)):
        for index in range(count):
            spreading(20.0 + 8.0 * index, seed=index).save(folder / split / f"{index:04d}.npz")
    return folder
