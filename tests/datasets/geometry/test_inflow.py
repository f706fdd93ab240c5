"""Hydrographs as particles: mass and momentum to a particle at any time, depths on level and rough ground, mistakes."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from datasets import Mass, Scene, Solid, read_scene
from datasets.geometry.bodies import filling, height
from datasets.geometry.ground import elevation
from datasets.scene.library import write_scene
from datasets.scene.particles import initial_particles
from tests.refusals import refused
from tests.scenes import scene_of

TRIANGLE = ((0.25, 0.0, 1.0), (0.75, 0.4, 1.0), (1.5, 0.0, 1.0))
FASTER = ((0.25, 0.0, 1.0), (0.75, 8.0, 4.0), (1.0, 0.0, 0.0), (1.25, 0.0, 0.0), (2.0, 4.0, 2.0))
RECTANGLE = {"section": ((5.0, 14.0, 6.0), (5.0, 14.0, 10.0)), "direction": (1.0, 0.0, 0.0)}


def flat(size: tuple[float, ...] = (4.0, 1.0), cell: float = 0.05, **changes: Any) -> Scene:
    """In 2D through a section at x = 0.5 m."""
    mass = {"kind": "inflow", "section": ((0.5,),), "hydrograph": TRIANGLE} | changes
    return scene_of(Mass(**mass), size=size, cell=cell, duration=2.0, frame_dt=0.01)


def valley(**changes: Any) -> Scene:
    """In 3D across a valley that falls by a quarter along x."""
    x, z = np.arange(41.0), np.arange(21.0)
    heights = (12.0 - 0.25 * x)[:, None] + 0.1 * np.abs(z - 10.0) ** 1.5
    terrain = Solid(kind="terrain", origin=(0.0, 0.0), spacing=(1.0, 1.0), heights=tuple(map(tuple, heights.tolist())))
    mass = {"kind": "inflow", "section": ((5.0, 4.0), (5.0, 16.0)), "hydrograph": FASTER} | changes
    return scene_of(Mass(**mass), size=(40.0, 20.0, 20.0), cell=0.5, solids=(terrain,), duration=2.0, frame_dt=0.1)


@pytest.mark.parametrize(
    "scene",
    [
        flat(),
        flat(hydrograph=tuple((t, q / 8.0, v) for t, q, v in FASTER)),
        flat((200.0, 50.0), 2.5, hydrograph=((0.0, 100.0, 10.0), (2.0, 50.0, 10.0))),
        valley(),
        valley(**RECTANGLE),
    ],
)
def test_mass_and_momentum_that_have_entered_are_those_of_the_hydrograph_to_a_particle(scene: Scene) -> None:
    particles, (time, discharge, speed) = initial_particles(scene), np.array(scene.masses[0].hydrograph).T
    fine = np.linspace(0.0, scene.duration, 20_001)
    q, v = np.interp(fine, time, discharge, left=0.0, right=0.0), np.interp(fine, time, speed)
    entered = np.searchsorted(particles.entry_time, fine, side="right")
    for rate, weight in ((q, np.ones(len(particles.volume))), (q * v, np.linalg.norm(particles.velocities, axis=1))):
        exact = np.append(0.0, np.cumsum(0.5 * np.diff(fine) * (rate[1:] + rate[:-1])))
        total = np.append(0.0, np.cumsum(particles.volume * weight))[entered]
        assert np.abs(total - exact).max() < particles.volume[0] * weight.max()
    assert particles.volume.sum() == pytest.approx(np.trapezoid(discharge, time), rel=1e-12)


def test_the_depth_is_discharge_over_speed_and_the_distances_are_those_of_a_lattice() -> None:
    particles = initial_particles(flat(hydrograph=((0.0, 0.2, 1.0), (1.0, 0.2, 0.5))))
    speed = 1.0 - 0.5 * particles.entry_time
    assert (particles.positions[:, 1] < 0.2 / speed + 1e-8).all()
    np.testing.assert_allclose(particles.positions[:, 0], 0.5)
    # As bodies that move apart: along the flow by the speed times the time.
    uniform = initial_particles(flat(hydrograph=((0.0, 0.2, 1.0), (1.0, 0.2, 1.0))))
    places = uniform.positions - uniform.entry_time[:, None] * uniform.velocities
    nearest = cKDTree(places).query(places, 2)[0][:, 1] / np.sqrt(uniform.volume[0])
    assert nearest.min() > 0.7
    assert height(flat(), flat().masses[0]) == pytest.approx(0.4, abs=0.02)


def test_another_jitter_has_other_places_and_the_same_times() -> None:
    one, other = initial_particles(flat()), initial_particles(dataclasses.replace(flat(), seed=1))
    assert np.abs(one.positions[:, 1] - other.positions[:, 1]).min() > 1e-4
    np.testing.assert_array_equal(one.entry_time, other.entry_time)


def test_across_a_valley_the_surface_is_level_above_the_ground_and_the_flow_goes_down_along_it() -> None:
    scene = valley(hydrograph=((0.0, 20.0, 4.0), (2.0, 20.0, 4.0)))
    particles, inflow = initial_particles(scene), filling(scene, scene.masses[0]).inflow
    np.testing.assert_allclose(inflow.flow, np.array([1.0, -0.25, 0.0]) / np.hypot(1.0, 0.25), atol=1e-9)
    above = particles.positions[:, 1] - elevation(scene.solids, scene.domain, particles.positions[:, ::2])
    assert above.min() >= 0.0
    # Across the flow the area is discharge over speed: as many particles lie below any share of the depth.
    height_above = (particles.positions - inflow.foot) @ inflow.up
    area = np.maximum(inflow.level[0] - inflow.bed, 0.0).sum() * inflow.width / len(inflow.bed)
    assert area == pytest.approx(5.0, rel=1e-9)
    assert height_above.max() < inflow.level[0] + 1e-6
    middle = np.abs(particles.positions[:, 2] - 10.0) < 1.0
    strips = np.abs((np.arange(len(inflow.bed)) + 0.5) / len(inflow.bed) - 0.5) * inflow.width < 1.0
    share = np.maximum(inflow.level[0] - inflow.bed, 0.0)[strips].sum() * inflow.width / len(inflow.bed) / area
    assert middle.mean() == pytest.approx(share, abs=0.01)
    np.testing.assert_allclose((particles.positions - inflow.foot) @ inflow.flow, 0.0, atol=0.05)


def test_what_enters_is_that_before_the_end_times_the_factor() -> None:
    particles = initial_particles(dataclasses.replace(flat(discharge_factor=1.5), duration=0.75))
    assert particles.volume.sum() == pytest.approx(1.5 * 0.1, rel=1e-12)
    assert particles.entry_time.max() < 0.75
    # A single particle at the end of the box may leave it.
    mass = flat(section=((4.0,),), hydrograph=((0.0, 0.05, 1.0), (0.01, 0.05, 1.0))).masses[0]
    assert min(mass.size) > 0.0
    assert np.add(mass.lower, mass.size)[0] == pytest.approx(4.0)


TOML = """
duration = 2.0
domain = { size = [4.0, 1.0], cell = 0.05, origin = [100.0, 1300.0] }
material = { friction_deg = 30.0 }
[[masses]]
kind = "inflow"
section = [[100.5, 1300.1]]
file = "hydrograph.csv"
"""


def test_a_hydrograph_from_a_spreadsheet_in_map_coordinates_is_written_and_read_again(tmp_path: Path) -> None:
    path, table = tmp_path / "scene.toml", "time [s];discharge [l/s/m];speed [m/s]\n0;0;1,0\n1;400;1,0\n2;0;1,0\n"
    path.write_text(TOML)
    (tmp_path / "hydrograph.csv").write_text(table)
    with pytest.warns(UserWarning, match="decimal commas"):
        scene = read_scene(path)
    assert scene.masses[0].section == ((0.5, 0.1),)
    assert scene.masses[0].hydrograph == ((0.0, 0.0, 1.0), (1.0, 0.4, 1.0), (2.0, 0.0, 1.0))
    write_scene(scene, tmp_path / "again.toml")
    assert read_scene(tmp_path / "again.toml") == scene
    assert Scene.from_json(scene.to_json()) == scene
    (tmp_path / "hydrograph.csv").write_text("time,discharge,speed\n0,0,1\n1,0.4,1\n2,0,1\n")
    path.write_text(TOML.replace("[[100.5, 1300.1]]", "[[100.5]]"))
    assert read_scene(path).masses[0].section == ((0.5,),)
    path.write_text(TOML + "at = [1.0, 2.0]\n")
    refused(read_scene, path, said="masses[0].at: expected no such key beside a hydrograph")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"hydrograph": ((0.0, 0.0, 1.0), (1.0, -1.0, 1.0))}, "hydrograph[1]: expected a discharge and a speed of at"),
        ({"hydrograph": ((0.0, 1.0, 1.0), (0.0, 1.0, 1.0))}, "hydrograph[1]: expected times in ascending order"),
        ({"hydrograph": ((0.0, 1.0, 0.0), (1.0, 1.0, 1.0))}, "hydrograph[0]: expected a speed above 0"),
        ({"hydrograph": ((2.0, 1.0, 1.0), (3.0, 1.0, 1.0))}, "expected some discharge before the end at 2 s"),
        ({"hydrograph": ((0.0, 0.01, 1.0), (1.0, 0.01, 1.0))}, "of at least a particle, 0.025 m, got 0.01 m"),
        ({"hydrograph": ((0.0, 1.5, 1.0), (1.0, 1.5, 1.0))}, "up to its greatest depth"),
        ({"hydrograph": None}, "hydrograph: expected `section`, `hydrograph` or a file of an inflow"),
        ({"section": ((5.0,),)}, "section: expected a section inside the domain"),
        ({"section": ((1.0, -0.1),)}, "section: expected a section inside the domain"),
        ({"direction": (0.0, 1.0)}, "direction: expected one that is not vertical"),
        ({"k0": 0.5}, "k0: expected none of an inflow"),
        ({"velocity": (1.0, 0.0)}, "velocity: expected none of an inflow"),
        ({"thickness": 1.0}, "thickness: expected no such key of kind inflow"),
        ({"discharge_factor": 0.0}, "discharge_factor: expected a positive factor"),
    ],
)
def test_what_is_no_inflow_is_refused_in_a_line(changes: dict[str, Any], said: str) -> None:
    refused(flat, **changes, said=said)


def test_a_section_in_a_solid_or_askew_is_refused_in_a_line() -> None:
    block = Solid(lower=(0.4, 0.1), size=(0.3, 0.1))
    refused(dataclasses.replace, flat(), solids=(block,), said="masses[0]: expected a body clear of solids[0]")
    refused(valley, direction=(1.0, 0.0, 0.5), said="direction: expected a vector at right angles to the section")
    buried = ((5.0, 9.0, 6.0), (5.0, 9.0, 10.0))
    refused(valley, section=buried, direction=(1.0, 0.0, 0.0), said="section: expected a section above the ground")
    across = {"section": ((5.0, 14.0, 6.0), (9.0, 14.0, 6.0))}
    refused(valley, **across, said="direction: expected the direction of the flow through a section on level ground")
