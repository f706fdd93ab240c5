"""One step: its symmetries, walls that hold; the gradient of a rollout; the models that ship.

`shipped.json` has the MPM's deposits of two scenes of each dimension, each found by

    figures(mpm.simulate(name, record=mpm.LAST), column)

of this file, on the cells of the scene, in single precision.
"""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import gns
from datasets import Mass, Material, Scene, Solid, Trajectory, read_scene
from datasets.flow import measures
from gns import card
from gns.library import shipped
from gns.simulator import Simulator, moving, step_activation_bytes, unroll
from gns.surroundings.forces import Moment
from gns.surroundings.initial import initial_state
from gns.surroundings.state import Conditions, State, in_model_units
from tests.gns.conftest import NORMALISATION, Cloud
from tests.scenes import scene_of


def test_the_order_of_the_particles_does_not_matter(lively: Simulator, cloud: Cloud) -> None:
    lively.double()
    state, conditions = (part.to(dtype=torch.float64) for part in cloud(lower=(0.0, 0.0)))
    friction = torch.linspace(0.3, 0.9, len(state.positions), dtype=torch.float64)
    conditions = replace(conditions, friction=friction)
    order = torch.randperm(len(friction), generator=torch.Generator().manual_seed(3))
    shuffled = State(positions=state.positions[order], displacements=state.displacements[:, order])
    after = lively(shuffled, replace(conditions, friction=friction[order]))
    torch.testing.assert_close(after.positions, lively(state, conditions).positions[order])


def test_far_from_the_walls_a_shift_by_grid_cells_changes_nothing(lively: Simulator, cloud: Cloud) -> None:
    lively.double()
    state, conditions = (part.to(dtype=torch.float64) for part in cloud(velocity=(0.5, 0.2)))
    conditions = replace(conditions, size=torch.full((1, 2), 8.0, dtype=torch.float64))
    shift = lively.settings.grid_cell * torch.tensor([200.0, 31.0], dtype=torch.float64)
    moved = State(positions=state.positions + shift, displacements=state.displacements)
    with torch.no_grad():
        here, there = (unroll(lively, initial, conditions, 5) for initial in (state, moved))
    assert (here[-1] - here[0]).std(dim=0).min() > 1e-5
    torch.testing.assert_close(there - shift, here, atol=1e-9, rtol=0.0)


@pytest.mark.parametrize("frames", [1, 2, 4, 6])
def test_a_short_past_is_continued_with_the_initial_velocity(frames: int) -> None:
    velocity = torch.tensor([[1.0, 0.0]])
    track = torch.arange(frames).view(-1, 1, 1).square() * torch.tensor([0.0, 0.01])
    state = State.observed(track, velocity, step=0.1, history=3)
    past = (track[1:] - track[:-1])[-3:]
    made_up = torch.tensor([0.1, 0.0]).expand(3 - len(past), 1, 2)
    torch.testing.assert_close(state.displacements, torch.cat((made_up, past)))
    torch.testing.assert_close(state.positions, track[-1])


def test_a_creeping_deposit_comes_to_rest(lively: Simulator, cloud: Cloud) -> None:
    # Small errors of the acceleration, of a network that is not exact, in sand that nothing else drives.
    with torch.no_grad():
        lively.network.decoder.mlp[-1].weight.mul_(0.1)
    state, conditions = cloud(lower=(0.4, 0.4))
    conditions = replace(conditions, gravity=torch.zeros(1, 2))
    speeds = []
    two = replace(conditions, batch=torch.tensor([0, 0, 1]), size=torch.ones(2, 2))
    for rest_speed, training in ((0.0, True), (0.05, True), (0.05, False)):
        lively.train(training).settings = replace(lively.settings, rest_speed=rest_speed)
        with torch.no_grad():
            moved = unroll(lively, state, conditions, 40)[-1] - state.positions
        speeds.append(float(moved.norm(dim=1).mean()) / (40 * lively.settings.step))
    assert speeds[0] > 1e-3
    assert speeds[1] < 0.05 * speeds[0]
    # It is at rest, not nearly so; one flow's rest is not another's.
    assert speeds[2] < 1e-4
    assert moving(torch.tensor([[0.1, 0.0], [0.0, 0.0], [2.0, 0.0]]), 1.0, two).flatten().tolist() == [0.0, 0.0, 1.0]


def test_a_flow_at_rest_takes_no_more_steps(lively: Simulator, cloud: Cloud, monkeypatch: pytest.MonkeyPatch) -> None:
    state, conditions = cloud(lower=(0.4, 0.4))
    still = replace(conditions, gravity=torch.zeros(1, 2))
    lively.eval().settings = replace(lively.settings, rest_speed=10.0)
    calls, step = [], lively.forward
    monkeypatch.setattr(lively, "forward", lambda *given: calls.append(1) or step(*given))
    with torch.no_grad():
        short = unroll(lively, state, still, 40)
    assert len(calls) == 1
    assert torch.equal(short, state.positions.expand(41, -1, -1))
    # With gradients every step is taken, to the same positions.
    assert torch.equal(unroll(lively, state, still, 5, kept_steps=5), short[:6])
    assert len(calls) == 6


def mound(friction_deg: float, below_deg: float, tilt_deg: float, *, floor_friction: float = 0.5, deep: bool) -> Scene:
    """A wedge, or in 3D a pyramid, whose steepest side is so far below its angle of friction, on a tilted floor."""
    slope = math.tan(math.radians(friction_deg - below_deg - tilt_deg))
    half = (0.75 * 0.032 / slope) ** (1 / 3) if deep else math.sqrt(0.08 / slope)
    x, high, cell = (0.4, 0.4 + half, 0.4 + 2.0 * half), half * slope, 1 / 48 if deep else 0.01
    width = cell * math.ceil((x[2] + 0.4) / cell)
    if deep:
        corners = tuple((a, 0.0, b) for a, b in ((x[0], x[0]), (x[2], x[0]), (x[2], x[2]), (x[0], x[2])))
        faces = ((0, 1, 2), (0, 2, 3), (0, 4, 1), (1, 4, 2), (2, 4, 3), (3, 4, 0))
        mass = Mass(kind="mesh", vertices=(*corners, (x[1], high, x[1])), triangles=faces)
    else:
        mass = Mass(kind="polygon", vertices=((x[0], 0.0), (x[2], 0.0), (x[1], high)))
    settings = {"floor_friction": floor_friction, "slope_deg": tilt_deg, "duration": 1.2, "frame_dt": 0.02}
    size = (width, cell * round(0.6 / cell), *([width] if deep else []))
    return scene_of(mass, size=size, cell=cell, material=Material(friction_deg=friction_deg), **settings)


@pytest.mark.parametrize(
    ("angle", "tilt", "deep", "margin"),
    [
        *((angle, tilt, False, 5.0) for angle, tilt in ((30.0, 8.0), (30.0, 12.0), (38.0, 12.0))),
        *((angle, tilt, True, 5.0) for angle, tilt in ((30.0, 0.0), (38.0, 8.0))),
        (28.0, 0.0, False, 1.4),
        (45.0, 18.0, False, 0.4),
    ],
)
def test_a_mound_below_its_angle_of_friction_stands(angle: float, tilt: float, deep: bool, margin: float) -> None:
    flow = gns.simulate(mound(angle, margin, tilt, deep=deep))
    speed = measures.rms(np.linalg.norm(flow.positions[-1] - flow.positions[0], axis=1)) / flow.time[-1]
    assert speed < 1.0e-3


@pytest.mark.parametrize("deep", [False, True])
def test_what_can_stand_is_what_no_known_law_moves(deep: bool) -> None:
    settings = gns.load(shipped(mound(30.0, 5.0, 0.0, deep=deep))).settings

    def stands(scene: Scene) -> bool:
        initial = initial_state(scene, settings)
        return bool(Moment(*in_model_units(initial.state, initial.conditions), settings, NORMALISATION).stands())

    assert stands(mound(35.0, 5.0, 8.0, deep=deep))
    assert not stands(mound(35.0, -4.0, 8.0, deep=deep))
    # A floor that is too smooth for its tilt, or for the thrust of the sides.
    assert not stands(mound(35.0, 5.0, 8.0, floor_friction=0.13, deep=deep))
    assert not stands(mound(35.0, 5.0, 0.0, floor_friction=0.1, deep=deep))
    assert stands(mound(35.0, 5.0, 0.0, floor_friction=0.25, deep=deep))
    # A side that is cut, whatever lies behind it; a mound on terrain of that tilt.
    assert not stands(replace(read_scene("baffles-2" if deep else "column-short-21"), baffles=()))
    scene, plan = mound(35.0, 5.0, 0.0, deep=deep), (0.0, 3.0)
    for rise, same in ((0.05, True), (0.2, False)):
        rows = tuple(tuple(0.05 + rise * x for _ in plan) for x in plan)
        points = {"origin": (0.0, 0.0), "spacing": (3.0, 3.0), "heights": rows}
        points = points if deep else {"points": tuple((x, row[0]) for x, row in zip(plan, rows, strict=True))}
        (mass,) = scene.masses
        lifted = tuple((p[0], p[1] + 0.05 + rise * p[0], *p[2:]) for p in mass.vertices)
        ground = Solid(kind="terrain", friction=0.5, **points)
        masses = (replace(mass, vertices=lifted),)
        assert stands(replace(scene, solids=(ground,), masses=masses)) is same


def test_a_mass_that_cannot_stand_spreads_or_is_named() -> None:
    """A mound of sand on a smooth floor: the MPM's front is at 1.381 m, from 1.3 m."""
    sand, mass = Material(friction_deg=35.0), Mass(kind="polygon", vertices=((0.5, 0.0), (1.3, 0.0), (0.9, 0.2)))
    scene = scene_of(mass, size=(2.0, 0.6), cell=0.02, material=sand, floor_friction=0.05, duration=0.5)
    assert gns.simulate(scene).summary["front"] == pytest.approx(1.381, abs=0.05)
    held = gns.load("flow2d")
    held.settings = replace(held.settings, rest_speed=10.0)
    with pytest.warns(UserWarning, match="predicts rest on a bed too smooth or too steep to hold the mass"):
        gns.simulate(scene, model=held)


@pytest.mark.parametrize("name", ["column-tall-42", "layers-10"])
def test_shipped_flows_come_to_rest(name: str) -> None:
    scene = read_scene(name)
    flow = gns.simulate(replace(scene, duration=1.2 * scene.duration))
    assert flow.positions[-2:, :, 0].max() > flow.positions[0, :, 0].max() + 0.1
    speeds = np.linalg.norm(flow.positions[-1] - flow.positions[-2], axis=1) / (flow.time[-1] - flow.time[-2])
    assert speeds.max() < 1e-4


STEPS = 6


@pytest.fixture
def problem(lively: Simulator, cloud: Cloud) -> tuple[Simulator, State, Conditions]:
    """A frozen model in double precision and a block at the left wall."""
    state, conditions = (part.to(dtype=torch.float64) for part in cloud(lower=(0.0, 0.0)))
    return lively.double().requires_grad_(False), state, conditions


def front(problem: tuple[Simulator, State, Conditions], friction: Tensor, kept_steps: int) -> Tensor:
    """The x [m] that 99.5 % of the points are behind after a rollout."""
    simulator, state, conditions = problem
    conditions = replace(conditions, friction=friction.expand(len(state.positions)))
    positions = unroll(simulator, state, conditions, STEPS, kept_steps=kept_steps)
    return torch.quantile(positions[-1, :, 0], 0.995)


def test_a_kept_step_costs_what_was_measured_and_changes_nothing(problem: tuple[Simulator, State, Conditions]) -> None:
    results = set()

    def stored(kept_steps: int) -> int:
        storages: dict[int, Tensor] = {}

        def keep(tensor: Tensor) -> Tensor:
            # The tensor itself too: a freed address could be counted for another.
            storages[tensor.untyped_storage().data_ptr()] = tensor
            return tensor

        friction = torch.tensor(0.5, dtype=torch.float64, requires_grad=True)
        with torch.autograd.graph.saved_tensors_hooks(keep, lambda tensor: tensor):
            value = front(problem, friction, kept_steps)
        size = sum(tensor.untyped_storage().nbytes() for tensor in storages.values())
        results.add((value.item(), torch.autograd.grad(value, friction)[0].item()))
        return size

    simulator, state, conditions = problem
    per_step = step_activation_bytes(simulator, state, conditions)
    assert per_step > 10 * state.displacements.nbytes
    assert stored(4) - stored(1) == pytest.approx(3 * per_step, rel=0.2)
    # More than there are keeps all.
    assert stored(STEPS + 3) > stored(4) > stored(0)
    assert len(results) == 1


# Mean x [m] after the steps above and its derivative with respect to tan(phi) [m]: other libraries round otherwise,
# other weights or features give other numbers.
STORED = [("flow2d", "column-tall-42", 0.1345151, -0.02683643), ("obstacle3d", "baffles-2", 0.5842266, -0.03759485)]


def mean_x(simulator: Simulator, scene: str, change: torch.Tensor) -> torch.Tensor:
    """Mean x [m] of the particles after the steps, with tan(phi) changed."""
    initial = initial_state(read_scene(scene), simulator.settings)
    # Thrown, so that contact forces act from the first step on.
    moving = replace(initial.state, displacements=initial.state.displacements + 0.002)
    conditions = replace(initial.conditions, friction=initial.conditions.friction + change)
    return unroll(simulator, moving, conditions, STEPS)[-1, :, 0].mean()


@pytest.mark.parametrize(("model", "scene", "position", "slope"), STORED)
def test_a_rollout_and_its_gradient_are_as_stored(model: str, scene: str, position: float, slope: float) -> None:
    simulator = gns.load(model)
    assert not simulator.training
    assert not any(weight.requires_grad for weight in simulator.parameters())
    change = torch.zeros((), requires_grad=True)
    mean = mean_x(simulator, scene, change)
    (gradient,) = torch.autograd.grad(mean, change)
    assert mean.item() == pytest.approx(position, rel=1e-5)
    assert gradient.item() == pytest.approx(slope, rel=1e-3)


MPM: dict[str, dict[str, Any]] = json.loads((Path(__file__).parent / "shipped.json").read_text())
BANDS = 2.0
"""Fronts lie within so many of the 95 % bands of the model's card: the MPM that it learned from has finer cells."""
HEIGHT, THICKNESS = 0.1, {2: 0.1, 3: 0.25}
"""Largest error of the mean height over the MPM's, and of the thickness (rms) over its largest, by dimension [-]."""


def figures(flow: Trajectory, column: float) -> dict[str, Any]:
    """Ends [m], mean height [m] and thickness in columns of the plan [m] of a deposit; column: their width [m]."""
    scene, volumes = flow.scene, flow.volumes
    raised = measures.above(flow.positions[-1], measures.ground_of(scene))
    spacing = measures.particle_spacing(volumes, scene.dimension)
    thickness = measures.thickness(raised, spacing, column, scene.domain.size[::2])
    return {
        "ends": measures.ends(raised, volumes),
        "height": measures.mean_height(raised, volumes),
        "column": column,
        "thickness": thickness.round(4).tolist(),
    }


@pytest.mark.parametrize("name", MPM)
def test_a_shipped_model_is_as_near_to_the_mpm_as_its_card_says(name: str) -> None:
    scene, expected = read_scene(name), MPM[name]
    band = card.read(shipped(scene)).calibration(scene)
    deposit = figures(gns.simulate(scene), expected["column"])
    rear, front = expected["ends"]
    assert deposit["ends"][1] == pytest.approx(front, abs=BANDS * band.front["0.95"] * (front - rear))
    assert deposit["height"] == pytest.approx(expected["height"], rel=HEIGHT)
    thickness = np.array(expected["thickness"])
    apart = measures.thickness_apart(thickness, np.array(deposit["thickness"]))
    assert apart < THICKNESS[scene.dimension] * thickness.max()
