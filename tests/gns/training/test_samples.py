"""Samples: flows at a model's step, stretches in all their symmetries, alone, side by side, in two processes."""

import os
import socket
import subprocess
import sys
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.nn.parallel import DistributedDataParallel

from datasets import Baffle, Mass, Material, Solid
from datasets.scene.grid_field import Field
from datasets.scene.particles import initial_particles
from gns.network.features import Inputs
from gns.settings import ModelSettings, TrainingSettings
from gns.simulator import Simulator
from gns.surroundings.initial import conditions_of, initial_state
from gns.surroundings.state import Ground, State, in_model_units
from gns.surroundings.units import Units
from gns.training.loop import LAST, joined, rank, untrained
from gns.training.losses import UnrolledLoss
from gns.training.samples import Flows, SampleBatch, Sampler, batched, flows_of, reflected, statistics, stretch, turned
from tests.gns.conftest import TINY, rows, spreading
from tests.refusals import refused
from tests.scenes import flow_of, scene_of


@pytest.fixture
def flows(dataset: Path, settings: ModelSettings) -> Flows:
    """The training flows."""
    return flows_of(dataset, "train", settings)


def test_a_flow_takes_every_so_many_frames(tmp_path: Path) -> None:
    trajectory = spreading(30.0)
    trajectory.save(tmp_path / "a.npz")
    (flow,) = Flows([tmp_path / "a.npz"], ModelSettings(frames_per_step=2))
    assert np.array_equal(flow.positions, trajectory.positions[::2])
    assert (flow.step, flow.velocity0.any()) == (0.005, False)
    for step in (0.004, 0.001):
        other = Flows([tmp_path / "a.npz"], ModelSettings(frame_dt=step, frames_per_step=1))
        refused(lambda other=other: other[0], said="a.npz: expected frames 0.00")


def test_a_flow_of_any_size_is_that_of_a_rollout(tmp_path: Path) -> None:
    """In the rollout's units whatever its frames: it was scored at its own size where these did not fit the step."""
    settings = ModelSettings(body_length=0.1, frame_dt=0.01, frames_per_step=1)
    body = Mass(lower=(0.0, 0.0), size=(0.05, 0.05), velocity=(1.0, 0.0))
    for frame_dt, near in ((0.003, 1e-6), (0.0071, 0.03), (0.01, None)):
        scene = scene_of(body, size=(0.3, 0.1), cell=0.01, duration=10 * frame_dt, frame_dt=frame_dt)
        points, time = initial_particles(scene).positions, frame_dt * np.arange(11)[:, None, None]
        flow_of(scene, points + np.array([1.0, 0.0]) * time).save(tmp_path / "a.npz")
        flows = Flows([tmp_path / "a.npz"], settings)
        if near is None:
            refused(lambda flows=flows: flows[0], said="frames at most 0.00")
            continue
        units = initial_state(scene, settings).conditions.units
        assert flows[0].units.length == pytest.approx(units.length, rel=2.0 * near)
        assert flows[0].step == pytest.approx(units.time * settings.step, rel=near)
        passed = flows[0].positions[-1, :, 0] - points[:, 0]
        np.testing.assert_allclose(passed, flows[0].step * (len(flows[0].positions) - 1), rtol=1e-5)


@pytest.mark.parametrize("body_length", [None, 0.1])
def test_training_sees_what_a_rollout_does(body_length: float | None, simulator: Simulator, tmp_path: Path) -> None:
    """Of masses whose cohesion grows with depth and whose friction varies, over terrain and before a baffle."""
    clay = Material(friction_deg=25.0, cohesion=200.0, strength_gradient=3.0e3)
    ramp = Solid(kind="terrain", points=((0.0, 0.1), (0.4, 0.0), (0.6, 0.0)), friction=0.5)
    fields = (
        Field((0.0, 0.0), (0.3, 0.4), (2, 1), quantity="friction_deg", values=(22.0, 38.0), mass=1),
        Field((0.0, 0.0), (0.1, 0.1), (1, 2), quantity="velocity_x", values=(0.0, 1.0)),
    )
    layer = Mass(kind="layer", thickness=0.06, outline=((0.0,), (0.2,)))
    lump = Mass(lower=(0.24, 0.12), size=(0.1, 0.1), material=replace(clay, strength_gradient=0.0))
    baffle = Baffle(lower=(0.5, 0.0), size=(0.02, 0.1), friction=0.3)
    around = {"solids": (ramp,), "baffles": (baffle,), "floor_friction": 0.4, "wall_friction": 0.2, "damping": 0.1}
    scene = scene_of(layer, lump, size=(0.6, 0.4), cell=0.01, material=clay, fields=fields, duration=0.05, **around)
    settings = simulator.settings = replace(simulator.settings, body_length=body_length)
    units = Units.of_model(scene, settings)
    scene = replace(scene, frame_dt=units.time * settings.step)
    particles, frames = initial_particles(scene), scene.frames
    start = np.repeat(particles.positions[None], frames, axis=0)
    velocity0 = particles.velocities.astype(np.float32)
    flow_of(scene, start, velocity0=velocity0, friction=particles.friction).save(tmp_path / "a.npz")
    (flow,) = Flows([tmp_path / "a.npz"], settings)
    sample = stretch(flow, settings, now=0, steps=1, rng=np.random.default_rng(0))
    rollout = initial_state(scene, settings)
    assert (rollout.conditions.units == Units()) is (body_length is None)
    assert rollout.conditions.cohesion.unique().numel() > 10
    unitless = in_model_units(rollout.state, rollout.conditions)
    trained, rolled = (
        {**tensors(state), **tensors(conditions), **tensors(Inputs.of_moment(moment)), "forces": moment.forces}
        for state, conditions in ((sample.state, sample.conditions), unitless)
        for moment in (simulator.moment(state, conditions),)
    )
    assert trained.keys() == rolled.keys()
    assert {"cohesion", "displacements", "ground.elevation", "baffles", "features", "graph.edge_index"} <= set(rolled)
    assert all(rolled[name].any() for name in ("displacements", "cohesion", "forces"))
    for name, value in rolled.items():
        torch.testing.assert_close(trained[name], value, rtol=1e-5, atol=1e-6, msg=lambda s, name=name: f"{name}: {s}")


@pytest.mark.parametrize(("now", "given"), [(0, []), (2, [0, 1, 2]), (6, [3, 4, 5, 6])])
def test_a_stretch_gives_the_known_past(flows: Flows, settings: ModelSettings, now: int, given: list[int]) -> None:
    flow, every = flows[0], replace(settings, particles_per_cell=4)
    sample = stretch(flow, every, now=now, steps=3, rng=np.random.default_rng(0))
    state, past = sample.state, np.diff(flow.positions[given], axis=0)
    assert np.array_equal(state.positions, flow.positions[now])
    assert np.array_equal(state.displacements[len(state.displacements) - len(past) :], past)
    assert np.array_equal(sample.targets, flow.positions[now + 1 : now + 4])
    few = stretch(flow, settings, now=now, steps=3, rng=np.random.default_rng(0))
    assert few.conditions.volume.sum() == pytest.approx(flow.volume.sum())


def test_flows_are_opened_when_they_are_asked_for(tmp_path: Path, settings: ModelSettings) -> None:
    trajectory = spreading(30.0)
    for name in ("a", "b", "c"):
        trajectory.save(tmp_path / "train" / f"{name}.npz")
    flows = flows_of(tmp_path, "train", settings)
    assert np.array_equal(flows[1].positions, trajectory.positions[::4])
    assert not flows[1].positions.flags.owndata
    assert [Path(flow.name).stem for flow in flows] == ["a", "b", "c"]
    (tmp_path / "train" / "b.npz").write_bytes(b"none")
    assert Path(flows[2].name).stem == "c"
    refused(lambda: flows[1], said="b.npz: expected a whole NPZ")
    refused(flows_of, tmp_path, "train", settings, said="b.npz: expected a whole NPZ")


def after(simulator: Simulator, some: list[SampleBatch]) -> torch.Tensor:
    """Where a step takes the particles of samples side by side [m]."""
    batch = batched(some)
    with torch.no_grad():
        return simulator(batch.state, batch.conditions).positions


def test_baffles_and_ground_of_one_sample_have_no_effect_on_another(lively: Simulator, flows: Flows) -> None:
    first = stretch(flows[0], lively.settings, now=5, steps=2, rng=np.random.default_rng(0))
    rougher = 0.1 + first.conditions.friction
    second = replace(first, conditions=replace(first.conditions, friction=rougher))
    ground = torch.linspace(0.05, 0.0, 61)[None]
    around = {
        "baffles": torch.tensor([[[[0.15, 0.0], [0.2, 0.1]]]]),
        "baffle_friction": torch.tensor([[0.5]]),
        "baffle_turn": torch.tensor([[0.4]]),
        "ground": Ground(elevation=ground, friction=torch.full_like(ground, 0.3), spacing=lively.settings.cell),
    }
    rough = replace(second, conditions=replace(second.conditions, **around))
    alone = [after(lively, [sample]) for sample in (first, rough)]
    assert (alone[1] - after(lively, [second])).abs().max() > 1e-3
    torch.testing.assert_close(after(lively, [first, rough]), torch.cat(alone), atol=1e-6, rtol=0.0)


def test_samples_are_stretches_of_the_flows(flows: Flows, settings: ModelSettings) -> None:
    sampler, rng = Sampler([flows], settings, TrainingSettings()), np.random.default_rng(0)
    drawn = [sampler.sample(4, rng) for _ in range(60)]
    # Of a flow that begins at rest the past that there is not is at rest too.
    assert {int(sample.state.displacements.any(dim=2).any(dim=1).sum()) for sample in drawn} == {0, 1, 2, 3}
    assert all(len(sample.targets) == 4 for sample in drawn)
    # The columns lean on the left wall; mirrored ones on the right.
    assert {bool(sample.state.positions[:, 0].mean() > 0.3) for sample in drawn} == {False, True}
    for sample in drawn:
        assert sample.conditions.volume.sum() == pytest.approx(0.12 * 0.16, rel=1e-5)


def test_a_batch_joins_domains_and_datasets_have_their_shares(flows: Flows, settings: ModelSettings) -> None:
    size = torch.tensor([[1.2, 0.4]])
    wide = [replace(flow, conditions=replace(flow.conditions, size=size)) for flow in flows]
    training = TrainingSettings(batch=2, shares=(1.0, 3.0))
    sampler, rng = Sampler([flows, wide], settings, training), np.random.default_rng(0)
    sizes = torch.cat([sampler.batch(1, rng).conditions.size for _ in range(100)])
    torch.testing.assert_close(sizes.unique(dim=0), torch.tensor([[0.6, 0.4], [1.2, 0.4]]))
    # 200 samples: three standard deviations.
    assert (sizes[:, 0] > 1.0).float().mean().item() == pytest.approx(0.75, abs=0.1)


@pytest.mark.parametrize("along", [0.0, 3.0])
def test_statistics_leave_gravity_out(flows: Flows, along: float) -> None:
    gravity = np.array([along, -9.81], np.float32)
    time = np.arange(8) * 0.01
    corner = np.stack((0.1 * np.arange(5), np.full(5, 0.9)), axis=1)
    falling = (corner + 0.5 * time[:, None, None] ** 2 * gravity).astype(np.float32)
    changes = {"gravity": torch.from_numpy(gravity)[None], "friction": torch.ones(5)}
    conditions = replace(flows[0].conditions, **changes)
    flow = replace(flows[0], positions=falling, velocity0=np.zeros((5, 2), np.float32), conditions=conditions)
    normalisation, _ = statistics([[flow]])
    assert normalisation.acceleration_scale < 1e-6
    assert normalisation.friction_mean == pytest.approx(1.0)
    assert normalisation.friction_std == 1.0


def test_a_training_begins_with_the_mean_upward_acceleration(flows: Flows, settings: ModelSettings) -> None:
    resting = np.tile(flows[0].positions[0], (6, 1, 1))
    # Every second displacement is gone, so that the flow counts as moving; without gravity's it is held all the same.
    resting[1::2, :, 0] += 1.0e-3 * flows[0].units.length
    flow = replace(flows[0], positions=resting, velocity0=np.zeros_like(flows[0].velocity0))
    normalisation, upward = statistics([[flow]])
    assert upward * normalisation.acceleration_scale == pytest.approx(9.81 * flow.step**2 / flow.units.length, rel=1e-3)
    bias = list(untrained(settings, [[flow]]).network.decoder.parameters())[-1]
    assert bias[:2].tolist() == pytest.approx([0.0, upward])


@pytest.fixture
def deep() -> SampleBatch:
    """A sample in a box of 0.8 x 0.6 x 0.8 m, points and elevations at random, before two baffles."""
    rng = np.random.default_rng(0)
    block = Mass(lower=(0.0, 0.0, 0.0), size=(0.2, 0.1, 0.1))
    straight = Baffle(lower=(0.5, 0.0, 0.1), size=(0.1, 0.3, 0.2))
    askew = Baffle(lower=(0.2, 0.0, 0.6), size=(0.05, 0.4, 0.1), turned_deg=30.0)
    around = {"baffles": (straight, askew), "slope_deg": 20.0, "baffle_friction": 0.3}
    scene = scene_of(block, size=(0.8, 0.6, 0.8), cell=0.1, **around)

    def some(*shape: int) -> torch.Tensor:
        return torch.from_numpy(rng.random(shape, np.float32))

    per_particle = dict(zip(("friction", "cohesion", "volume"), some(3, 7), strict=True))
    ground = Ground(elevation=some(1, 9, 9), friction=some(1, 9, 9), spacing=0.1, drag=some(1, 9, 9))
    return SampleBatch(
        state=State(positions=some(7, 3), displacements=some(3, 7, 3)),
        conditions=replace(conditions_of(scene, 0.1, **per_particle, units=Units()), ground=ground),
        targets=some(2, 7, 3),
    )


def tensors(value: Any) -> dict[str, torch.Tensor]:
    """All tensors of a record, by name."""
    by_name = {}
    for field in fields(value):
        member = getattr(value, field.name)
        if isinstance(member, torch.Tensor):
            by_name[field.name] = member
        elif is_dataclass(member):
            by_name |= {f"{field.name}.{name}": part for name, part in tensors(member).items()}
    return by_name


@pytest.mark.parametrize("axis", [0, 2, None])
def test_a_mirror_turns_its_axes_and_twice_changes_nothing(deep: SampleBatch, axis: int | None) -> None:
    """All lengths are those of one body: in the mirror distances to baffles, walls and ground are what they were."""
    once = reflected(deep, axis)
    order, sign = ([2, 1, 0], 1.0) if axis is None else ([0, 1, 2], -1.0)
    side = 0 if axis is None else axis
    moved, before, after = deep.state.displacements, deep.conditions, once.conditions
    torch.testing.assert_close(once.state.displacements[..., side], sign * moved[..., order[side]])
    assert after.gravity[0, side] == sign * before.gravity[0, order[side]]
    assert torch.equal(after.baffle_turn, -before.baffle_turn)
    for original, there in ((deep.state.positions, once.state.positions), (deep.targets, once.targets)):
        mine = original[..., order]
        torch.testing.assert_close(there[..., side], mine[..., side] if sign > 0 else 0.8 - mine[..., side])
        assert torch.equal(there[..., 1], mine[..., 1])
        gaps = [
            (points[..., None, None, :] - around.baffles[0]).abs().sort(dim=-2).values[..., axes]
            for points, around, axes in ((original, before, order), (there, after, [0, 1, 2]))
        ]
        torch.testing.assert_close(*gaps, atol=1e-6, rtol=0.0)
    for name in ("elevation", "friction"):
        there, here = getattr(after.ground, name), getattr(before.ground, name)
        expected = here.mT if axis is None else here.flip(min(axis, 1) + 1)
        torch.testing.assert_close(there, expected, atol=1e-6, rtol=0.0)
    again, given = tensors(reflected(once, axis)), tensors(deep)
    assert again.keys() == given.keys()
    for name, value in given.items():
        torch.testing.assert_close(again[name], value, atol=1e-6, rtol=0.0)


def test_samples_in_3d_come_in_all_eight_symmetries(deep: SampleBatch) -> None:
    rng = np.random.default_rng(0)
    variants = {tuple(turned(deep, rng).targets[0, 0].double().round(decimals=5).tolist()) for _ in range(100)}
    assert len(variants) == 8


ROOT = Path(__file__).parents[3]
STEPS = 3


def gradients(simulator: Simulator, samples: list[SampleBatch]) -> dict[str, torch.Tensor]:
    """Those of one update, in double precision; one step keeps its activations, the others are checkpointed."""
    batch = batched(samples).to(dtype=torch.float64)
    model: torch.nn.Module = UnrolledLoss(simulator, TrainingSettings(memory_gib=2e-3))
    if torch.distributed.is_initialized():
        model = DistributedDataParallel(model)
    simulator.zero_grad()
    model(batch).backward()
    return {name: value.grad for name, value in simulator.named_parameters() if value.grad is not None}


def work(number: int, port: str, simulator: Simulator, parts: list[list[SampleBatch]], out: Path) -> None:
    """One of two processes."""
    os.environ.update(MASTER_ADDR="127.0.0.1", MASTER_PORT=port, WORLD_SIZE="2", RANK=str(number))
    with joined("cpu"):
        torch.save(gradients(simulator, parts[rank()]), out / f"{rank()}.pt")


def test_two_processes_give_the_mean(lively: Simulator, settings: ModelSettings, dataset: Path, tmp_path: Path) -> None:
    simulator, rng = lively.double(), np.random.default_rng(0)
    flows = flows_of(dataset, "train", settings)
    samples = [stretch(flow, settings, now=t, steps=STEPS, rng=rng) for flow, t in zip(flows, (0, 5, 9), strict=False)]
    parts = [samples[:2], samples[2:]]
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    torch.multiprocessing.start_processes(work, (port, simulator, parts, tmp_path), nprocs=2, start_method="fork")
    alone = [gradients(simulator, part) for part in parts]
    first, second = (torch.load(tmp_path / f"{rank}.pt", weights_only=True) for rank in (0, 1))
    assert alone[0].keys() == first.keys()
    for name, value in first.items():
        expected = 0.5 * (alone[0][name] + alone[1][name])
        assert torch.equal(value, second[name])
        assert (value - expected).norm() <= 1e-6 * expected.norm()
        assert expected.norm() > 0.0


@pytest.mark.slow
def test_torchrun_trains_and_resumes(dataset: Path, tmp_path: Path) -> None:
    def run(out: Path, *more: str) -> int:
        command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", "-m"]
        command += ["gns.train", str(dataset), "--out", str(out), *TINY, "--validations", "2", *more]
        subprocess.run(command, cwd=ROOT, check=True, timeout=120)
        return int(torch.load(out / LAST, weights_only=True)["position"]["updates"])

    assert run(tmp_path, "--updates", "6") == 6
    assert len(rows(tmp_path)) == 2
    assert run(tmp_path, "--updates", "8", "--resume") == 8
