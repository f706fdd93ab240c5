"""Masses behind barriers: retained until their time, or until they have settled, and then let go."""

import dataclasses

import numpy as np
import pytest

from datasets import Gate, Mass, Scene
from datasets.scene.particles import initial_particles
from mpm import WITH_FIELDS, simulate
from mpm.adjoint.gradient import gradient
from tests.refusals import refused
from tests.scenes import SAND, scene_of, with_masses
from validation.bench.stability.invariants import momentum

CELL = 0.02
COLUMN = Mass(lower=(0.4, 0.0), size=(0.2, 0.3), release=0.05)
SCENE = scene_of(COLUMN, size=(1.0, 0.4), cell=CELL, duration=0.2)
BLOCK = Mass(lower=(0.1, 0.0, 0.06), size=(0.1, 0.1, 0.08), release=0.02)
SCENE_3D = scene_of(BLOCK, size=(0.3, 0.2, 0.2), cell=CELL, duration=0.06)


@pytest.mark.double
@pytest.mark.parametrize(
    ("scene", "frame"), [(SCENE, 20), pytest.param(SCENE_3D, 8, marks=pytest.mark.slow)], ids=["2D", "3D"]
)
def test_a_mass_stands_until_its_time_and_then_flows(scene: Scene, frame: int) -> None:
    flow = simulate(scene, precision="f64", threads=1, record=WITH_FIELDS)
    mass = scene.masses[0]
    assert flow.summary["release_time"] == [mass.release]
    for axis in (0, 2)[: scene.dimension - 1]:
        held = flow.positions[: frame + 1, :, axis]
        assert held.min() > mass.lower[axis] - 0.01 * CELL
        assert held.max() < mass.lower[axis] + mass.size[axis] + 0.01 * CELL
        free = flow.positions[-1, :, axis]
        assert free.min() < held.min() - 0.1 * CELL
        assert free.max() > held.max() + 0.1 * CELL
    # It is let go with the first step after the frame of its release, not later.
    before, after = flow.positions[frame + 1 : frame + 3, :, 0].max(axis=1)
    assert after - before > 0.2 * (before - flow.positions[frame, :, 0].max()) >= 0.0
    assert before > flow.positions[frame, :, 0].max()


@pytest.mark.double
@pytest.mark.parametrize("release", [0.05, "settled"])
def test_what_barriers_and_damping_take_is_in_the_balance(release: float | str) -> None:
    scene = with_masses(SCENE, dataclasses.replace(COLUMN, lower=(0.3, 0.0), release=release))
    balance = momentum(simulate(scene, precision="f64", threads=1, record=WITH_FIELDS))
    assert balance.value < 1e-5


@pytest.mark.double
def test_a_mass_settles_before_it_is_let_go() -> None:
    scene = with_masses(SCENE, dataclasses.replace(COLUMN, release="settled"), duration=0.5)
    flow = simulate(scene, precision="f64", threads=1, record=WITH_FIELDS)
    (release,) = flow.summary["release_time"]
    assert 0.01 < release < 0.4
    frame = round(release / scene.frame_dt)
    kinetic = flow.summary["energy"]["kinetic"]
    weight = 0.2 * 0.3 * SAND.density
    assert kinetic[frame] < 2e-6 * 0.5 * weight * (9.81 * 0.3 / SAND.wave_speed) ** 2 < kinetic[1]
    # At its own weight, and it flows at once.
    depth = 0.3 - flow.positions[frame, :, 1]
    vertical = SAND.density * 9.81 * depth
    assert np.polyfit(vertical, flow.pressure[frame], 1)[0] == pytest.approx((1.0 + 2 * 0.43) / 3.0, rel=0.1)
    assert kinetic[frame + 8] > 1e3 * kinetic[frame]


@pytest.mark.double
def test_masses_have_their_own_times() -> None:
    first = Mass(lower=(0.0, 0.0), size=(0.2, 0.2), k0=0.5, release=0.05)
    second = Mass(lower=(0.8, 0.0), size=(0.2, 0.2), k0=0.5, release=0.1)
    third = Mass(lower=(0.4, 0.2), size=(0.1, 0.1))
    settling = Mass(lower=(0.55, 0.0), size=(0.1, 0.1), release="settled")
    # Without volume correction, which the falling mass would ask for: gaps that close slowly keep a mass from settling.
    scene = with_masses(SCENE, first, second, third, settling, duration=0.15, jitter=0.4, volume_correction=False)
    flow = simulate(scene, precision="f64", threads=1, record=WITH_FIELDS)
    particles = initial_particles(flow.scene)
    times = flow.summary["release_time"]
    assert times[:3] == [0.05, 0.1, 0.0]
    assert 0.0 < times[3] < 0.15
    for number, frame in ((0, 20), (1, 40)):
        speed = np.linalg.norm(flow.velocities[:, particles.mass == number], axis=2).max(axis=1)
        assert speed[: frame + 1].max() < 1e-9
        assert speed[frame + 1] > 1e-2
    # The free one falls meanwhile.
    falling = flow.velocities[20, particles.mass == 2, 1].mean()
    assert falling == pytest.approx(-9.81 * 0.05, rel=0.01)


@pytest.mark.double
@pytest.mark.parametrize("scene", [SCENE, pytest.param(SCENE_3D, marks=pytest.mark.slow)], ids=["2D", "3D"])
def test_a_gate_holds_what_is_above_its_foot(scene: Scene) -> None:
    gate = Gate(speed=2.0, time_constant=0.03)
    mass = dataclasses.replace(scene.masses[0], gate=gate)
    flow = simulate(with_masses(scene, mass), precision="f64", threads=1, record=WITH_FIELDS)
    gone = simulate(scene, precision="f64", threads=1, record=WITH_FIELDS)
    assert flow.summary["release_time"] == [mass.release]
    opened = round(mass.release / scene.frame_dt)
    assert (flow.positions[: opened + 1] == gone.positions[: opened + 1]).all()
    right = mass.lower[0] + mass.size[0]
    for frame in range(opened + 1, scene.frames):
        x, since = flow.positions[frame], float(flow.time[frame]) - mass.release
        # The integral of v (1 - exp(-t / tau)).
        foot = gate.speed * (since + gate.time_constant * np.expm1(-since / gate.time_constant))
        # A particle feels the nodes up to one and a half cells away.
        held = x[:, 1] > foot + 1.5 * CELL
        assert (x[held, 0] < right + 0.01 * CELL).all()
        assert (x[held, 0] > mass.lower[0] - 0.01 * CELL).all()
    # It flows out beneath, less than without a gate.
    standing, out, free = (x[:, 0].max() for x in (flow.positions[opened], flow.positions[-1], gone.positions[-1]))
    assert standing + 0.02 * CELL < out < free - 0.02 * CELL
    refused(gradient, with_masses(scene, mass), lambda x, v: (0.0, 0.0 * x, None), said="no reverse of a gate yet")


@pytest.mark.double
def test_a_fast_gate_is_none() -> None:
    fast = with_masses(SCENE, dataclasses.replace(COLUMN, gate=Gate(speed=1000.0)))
    flow, gone = (simulate(scene, precision="f64", threads=1, record=WITH_FIELDS) for scene in (fast, SCENE))
    assert (flow.positions == gone.positions).all()
