"""The models that ship: a rollout and its gradient against stored numbers."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
import torch

import gns
from datasets import measures
from datasets.library import read_scene
from gns.initial import initial_state
from gns.simulator import Simulator
from gns.unroll import unroll

STEPS = 6
# Mean x [m] after the steps above and its derivative with respect to tan(phi) [m]: other libraries round otherwise,
# other weights or features give other numbers.
STORED = [
    ("flow2d", "column-tall-42", 0.1349695, -0.02537950),
    ("obstacle3d", "baffles-2", 0.6024368, -0.03279620),
]


def mean_x(simulator: Simulator, scene: str, change: torch.Tensor) -> torch.Tensor:
    """Mean x [m] of the particles after the steps, with tan(phi) changed."""
    initial = initial_state(read_scene(scene), simulator.settings)
    # Thrown, so that contact forces act from the first step on.
    moving = initial.with_displacements(initial.state.displacements + 0.002)
    moving = moving.with_conditions(friction=moving.conditions.friction + change)
    return unroll(simulator, moving.state, moving.conditions, STEPS)[-1, :, 0].mean()


@pytest.mark.parametrize(("model", "scene", "position", "slope"), STORED)
def test_a_rollout_and_its_gradient_are_as_stored(model: str, scene: str, position: float, slope: float) -> None:
    simulator = gns.load(model)
    change = torch.zeros((), requires_grad=True)
    found = mean_x(simulator, scene, change)
    (gradient,) = torch.autograd.grad(found, change)
    assert found.item() == pytest.approx(position, rel=1e-5)
    assert gradient.item() == pytest.approx(slope, rel=1e-3)


def test_a_simulation_is_a_trajectory_with_volumes_and_its_own_frames(simulator: Simulator) -> None:
    scene = dataclasses.replace(read_scene("column-tall-42"), duration=0.1)
    trajectory = gns.simulate(scene, model=simulator)
    material = float(np.prod(scene.masses[0].size))
    assert trajectory.volume is not None
    assert trajectory.volume.sum() == pytest.approx(material, rel=1e-5)
    np.testing.assert_allclose(np.diff(trajectory.time), trajectory.scene.frame_dt)
    assert trajectory.scene.frames == len(trajectory.positions) == len(trajectory.time) == 11
    assert trajectory.summary["start"] == "rest"
    assert trajectory.summary["front"] == measures.front(trajectory.positions[-1])


def test_a_loaded_model_is_frozen_unless_it_is_to_be_trained() -> None:
    frozen, free = gns.load("flow2d"), gns.load("flow2d", training=True)
    assert not any(weight.requires_grad for weight in frozen.parameters())
    assert not frozen.training
    assert all(weight.requires_grad for weight in free.parameters())
    assert free.training


def test_what_the_package_gives_is_listed_and_a_help_needs_no_torch() -> None:
    code = "import sys, gns, gns.train, gns.rollout, gns.card, gns.score; print('torch' in sys.modules, *dir(gns))"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert said[0] == "False"
    assert {"load", "predict", "simulate"} <= set(said)
