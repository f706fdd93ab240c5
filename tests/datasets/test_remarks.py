"""What is said of a flow that is not what it seems: moving, held by a wall, leaving, too thin."""

import dataclasses

import numpy as np
import pytest

from datasets.library import read_scene
from datasets.particles import initial_particles
from datasets.remarks import remarks
from datasets.scene import Scene

SCENE = read_scene("column-short-21")


def said(scene: Scene = SCENE, *, x: float = 0.0, energy: float = 0.0, outflow: dict[str, float] | None = None) -> str:
    """Remarks on the column moved by `x` [m], whose kinetic energy ends at `energy` [J/m]."""
    particles = initial_particles(scene)
    deposit = particles.positions + np.array([x] + [0.0] * (scene.dimension - 1))
    kinetic = np.array([0.0, 10.0, energy])
    return "\n".join(remarks(scene, particles, deposit, kinetic=kinetic, end_time=1.0, outflow=outflow or {}))


def test_of_a_deposit_at_rest_in_a_large_box_nothing_is_said() -> None:
    assert said(x=0.1) == ""


def test_a_flow_that_still_moves_is_said_with_its_speed() -> None:
    assert "not at rest: at t = 1 s" in said(energy=1.0)
    assert said(energy=1e-7) == ""


def test_a_wall_that_holds_the_front_is_named_but_not_the_one_it_stood_at() -> None:
    mass = SCENE.masses[0]
    room = SCENE.domain.size[0] - mass.lower[0] - mass.size[0]
    assert "the side x+ of the box holds" in said(x=room)
    assert "x-" not in said()
    opened = dataclasses.replace(SCENE, open_sides=("x+",))
    assert "x+" not in said(opened, x=room)
    assert "left the box through its open side x+" in said(opened, outflow={"x+": 1.0})


@pytest.mark.parametrize(("cells", "thin"), [(2.0, True), (5.0, False)])
def test_a_body_of_fewer_than_three_cells_is_said(cells: float, thin: bool) -> None:
    mass = dataclasses.replace(SCENE.masses[0], size=(SCENE.masses[0].size[0], cells * SCENE.domain.cell))
    assert ("masses[0]" in said(dataclasses.replace(SCENE, masses=(mass,)))) is thin
