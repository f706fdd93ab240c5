"""Observations: the smooth forms against the exact ones; errors of measured numbers; multiple ones in one problem."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from datasets import Baffle, Domain, Mass, Scene, Trajectory
from datasets.flow import measures
from inverse import Problem, read_problem
from inverse.observations import (
    KINDS,
    ArrivalSettings,
    FrontSettings,
    GaugesSettings,
    ImpulseSettings,
    Observation,
    ObservationSettings,
    OutlineSettings,
    PeakForceSettings,
    ProfileSettings,
    Rollout,
    SpeedSettings,
)
from inverse.observations.errors import Covariance
from inverse.observations.observation import Joint
from inverse.observations.target import joined
from inverse.target import read_target
from tests.refusals import refused
from tests.scenes import flow_of, scene_of

SCENE = scene_of(Mass(lower=(0.0, 0.0), size=(0.2, 0.4)), size=(1.0, 0.5), cell=0.01)


def deposit(points: int, seed: int = 0) -> np.ndarray:
    """A wedge 0.6 m long [m], shape [points, 2]."""
    stream = np.random.default_rng(seed)
    return np.stack([0.6 * (1.0 - np.sqrt(stream.random(points))), 0.1 * stream.random(points)], axis=1)


def made(kind: str) -> Observation:
    return KINDS[kind](**({"line": 0.3} if kind == "passed" else {})).operator(SCENE)


@pytest.mark.parametrize(("kind", "within"), [("runout", 0.01), ("toe", 0.003), ("passed", 0.005)])
def test_the_smooth_form_of_all_points_is_near_the_exact_one(kind: str, within: float) -> None:
    positions = deposit(3200)
    smooth = made(kind).smooth(torch.from_numpy(positions), torch.ones(3200)).numpy()
    assert smooth == pytest.approx(made(kind).exact(positions), abs=within)


def test_front_and_profile_weigh_points_by_their_volume() -> None:
    positions, volumes = deposit(3200), np.random.default_rng(1).uniform(0.5, 1.5, 3200)
    tail = made("front").smooth(torch.from_numpy(positions), torch.from_numpy(volumes)).item()
    assert tail == pytest.approx(measures.front(positions, volumes), rel=1e-12)
    x = torch.from_numpy(np.random.default_rng(3).random((400, 2)) * 0.6)
    volumes = torch.ones(400)
    volumes[:100] = 2.0
    profile = made("profile")
    twice = profile.smooth(torch.cat([x, x[:100]]), torch.ones(500)).numpy()
    np.testing.assert_allclose(profile.smooth(x, volumes).numpy(), twice, rtol=1e-9)


def test_the_smooth_toe_is_a_tenth_of_the_volume() -> None:
    """Two piles of equal points, the further one a tenth of the volume: the toe is its centroid, whatever it weighs."""
    toe = made("toe")
    far = torch.rand(50, 2, dtype=torch.float64) * 0.01 + torch.tensor([0.8, 0.2])
    near = torch.rand(100, 2, dtype=torch.float64) * 0.01
    volumes = torch.cat([torch.full((50,), 1.0), torch.full((100,), 4.5)])
    seen = toe.smooth(torch.cat([far, near]), volumes)
    torch.testing.assert_close(seen, far.mean(dim=0), rtol=0.0, atol=1e-6)


def test_the_loss_of_points_is_their_mean_squared_distance() -> None:
    required, predicted = deposit(200, seed=0), deposit(200, seed=1)
    whole = made("deposit")
    expected = np.mean(np.sum((predicted - required) ** 2, axis=1))
    assert whole.misfit(predicted.ravel(), required.ravel()) == pytest.approx(expected)
    some = np.array([3, 17, 90])
    part = whole.of_particles(required.ravel(), some)
    np.testing.assert_array_equal(part, required[some].ravel())
    toe = made("toe")
    apart = toe.exact(predicted) - toe.exact(required)
    assert toe.misfit(toe.exact(predicted), toe.exact(required)) == pytest.approx(float(apart @ apart))


ROOT = np.random.default_rng(0).normal(size=(4, 4))
FORMS = pytest.mark.parametrize("errors", [Covariance.of(ROOT @ ROOT.T), Covariance(np.array([0.5, 1.0, 0.0, 2.0]))])
"""Dependent errors, and independent ones."""


@FORMS
def test_every_form_is_that_of_the_matrix(errors: Covariance) -> None:
    index, scale = np.array([2, 0]), np.array([1.0, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(errors.deviation**2, np.diag(errors.matrix))
    np.testing.assert_allclose(errors.combined(ROOT), ROOT.T @ errors.matrix @ ROOT)
    np.testing.assert_allclose(errors.over(scale).matrix, errors.matrix / np.outer(scale, scale))
    np.testing.assert_allclose(errors.some(index).matrix, errors.matrix[index][:, index])
    both = Covariance.joined([errors, errors]).matrix
    np.testing.assert_allclose(both[4:, 4:], errors.matrix)
    assert not both[:4, 4:].any()


@FORMS
def test_errors_are_drawn_as_they_are_stated(errors: Covariance) -> None:
    rng = np.random.default_rng(1)
    drawn = np.stack([errors.drawn(rng) for _ in range(20_000)])
    np.testing.assert_allclose(np.cov(drawn, rowvar=False), errors.matrix, atol=0.04 * errors.matrix.max())


HEAD = 'scene = "column-tall-42"\n[[unknowns]]\nname = "friction_deg"\ninitial = 30.0\nlower = 12.0\nupper = 52.0\n'


def written(folder: Path, text: str) -> Problem:
    (folder / "problem.toml").write_text(HEAD + text)
    return read_problem(str(folder / "problem.toml"))


def joint(folder: Path, text: str) -> tuple[Joint, np.ndarray]:
    """Operator and the target's values in their own units."""
    target = read_target(written(folder, text), never)
    return target.observation, target.observation.scale * target.values


def never(scene: Scene) -> Trajectory:
    raise AssertionError("measured numbers need no simulation")


def flow(scene: Scene, frames: int = 11) -> Trajectory:
    """400 particles that run 0.1 to 0.5 m, thin out, and push a baffle with 2 N s in all."""
    rng = np.random.default_rng(1)
    start = rng.random((400, scene.dimension)) * 0.2
    time = np.linspace(0.0, scene.duration, frames)
    positions = np.stack([start * ([1.0 + 2.0 * t] + [1.0] * (scene.dimension - 1)) for t in time / scene.duration])
    impulse = np.zeros((frames, len(scene.baffles), scene.dimension))
    impulse[:, :1, 0] = 2.0 * (time[:, None] / scene.duration) ** 2
    return flow_of(scene, positions, time=time, solid_impulse=impulse)


def test_each_brings_its_numbers_and_its_noise(tmp_path: Path) -> None:
    (tmp_path / "camera.csv").write_text("time,front\n0.2,30\n0.4,52.5\n")
    (tmp_path / "gauge.csv").write_text("x,height,time\n0.1,1.2,0.3\n0.3,1.1,1.0\n")
    observation, values = joint(
        tmp_path,
        '[[observations]]\nkind = "front"\nvalue = 0.7\nnoise = 0.01\n'
        '[[observations]]\nkind = "front"\ncsv = "camera.csv"\nunit = "cm"\nnoise = "4%"\n'
        '[[observations]]\nkind = "height"\nname = "mast"\ncsv = "gauge.csv"\ndatum = 1.0\nnoise = 0.005\n'
        '[[observations]]\nkind = "passed"\nline = 0.5\nvalue = 0.1\n',
    )
    np.testing.assert_allclose(values, [0.7, 0.3, 0.525, 0.2, 0.1, 0.1], rtol=1e-12)
    assert [part.name for part in observation.parts] == ["front", "front 2", "mast", "passed"]
    assert [part.numbers for part in observation.parts] == [slice(0, 1), slice(1, 3), slice(3, 5), slice(5, 6)]
    chance = 0.25 * 0.01
    expected = np.hypot([0.01, 0.012, 0.021, 0.005, 0.005, 0.0], [*[chance] * 5, 0.005])
    np.testing.assert_allclose(observation.scale, expected)
    assert observation.over_time
    assert observation.of_positions


def test_a_twin_makes_all_of_them(tmp_path: Path) -> None:
    asked = written(
        tmp_path,
        "[target]\ntwin = true\ntruth = { friction_deg = 24.0 }\n"
        '[[observations]]\nkind = "front"\ntimes = [0.25, 0.5, 1.0]\nnoise = "3%"\n'
        '[[observations]]\nkind = "height"\nx = [0.05, 0.1]\ntimes = [0.5]\nnoise = "3%"\n'
        '[[observations]]\nkind = "profile"\nnoise = "3%"\n',
    )
    target = read_target(asked, flow)
    observation = target.observation
    assert target.truth == {"friction_deg": 24.0}
    assert len(target.values) == 3 + 2 + 21
    # With the stated noise on them.
    off = (observation.observe(flow(asked.scene)) - target.values) / target.deviation
    assert 0.5 < np.sqrt(np.mean(off**2)) < 2.0
    np.testing.assert_array_equal(read_target(asked, flow).values, target.values)


@pytest.mark.parametrize(
    ("text", "key", "message"),
    [
        ('"front"', "", "expected what was measured for front: value"),
        ('"front"\nvalue = 0.7\nnoise = "3 per cent"', ".noise", "percentage"),
        ('"front"\nvalue = 0.7\nnoise = -1.0', ".noise", "at least 0"),
        ('"front"\nvalue = 0.7\nnoise = nan', ".noise", "at least 0, got nan"),
        ('"front"\ntimes = []\nvalues = []', ".values", "at least one number"),
        ('"height"\nx = [0.1, 0.3]\nvalues = [150, 80]', ".values", " m, got [150.0, 80.0]"),
        ('"front"\nvalue = 0.7\nnoise = { kind = "cauchy" }', ".noise.kind", "student"),
        ('"front"\nnoise = { kind = "student", dof = 0.5, deviation = 1.0 }', ".noise.dof", "at least 1"),
        ('"profile"\nnoise = { kind = "student", deviation = 0.1 }', ".noise", "depend on each other"),
        ('"profile"\ntimes = [0.1, 0.2]', ".times", "one time"),
        ('"impulse"\nvalue = 1.0', ".solid", "the scene has no solids"),
        ('"outline"\nvalues = [1.0]', ".kind", "in 3D"),
        ('"height"\nvalues = [1.0]', ".x", "the x [m] of the gauges"),
        ('"front"\ntimes = [0.5, 1.5]\nvalues = [0.1, 0.2]', ".times", "got 1.5"),
        ('"deposit"\n[[observations]]\nkind = "front"', ".kind", "few numbers"),
        ('"front"\nvalue = 0.7\n[target]\ntwin = true', "", "no numbers"),
    ],
)
def test_what_is_wrong_names_its_key(tmp_path: Path, text: str, key: str, message: str) -> None:
    text = f"[[observations]]\nkind = {text}\n"
    assert refused(lambda: read_target(written(tmp_path, text), flow), said=message).key == f"observations[0]{key}"


BAFFLE = Baffle(lower=(0.8, 0.0), size=(0.1, 0.1))
BAFFLED = scene_of(Mass(lower=(0.0, 0.0), size=(0.2, 0.4)), size=(1.0, 0.4), baffles=(BAFFLE,))


def rolled(run: Trajectory) -> Rollout:
    volumes = torch.full((400,), 0.08 / 400, dtype=torch.float64)  # Of the masses, as the MPM's.
    return Rollout(positions=torch.from_numpy(run.positions).double(), times=run.time, volumes=volumes)


@pytest.mark.parametrize(
    "settings",
    [
        FrontSettings(times=(0.05, 0.33, 1.0)),
        ProfileSettings(times=(0.33,)),
        GaugesSettings(spacing=0.05, x=(0.0, 0.1, 0.3)),
        GaugesSettings(spacing=0.05, x=(0.1, 0.3), times=(0.12, 0.5)),
    ],
)
def test_the_smooth_form_is_the_exact_one(settings: ObservationSettings) -> None:
    run, observation = flow(BAFFLED), settings.operator(BAFFLED)
    assert observation.over_time == (settings.times is not None)
    exact = observation.observe(run)
    np.testing.assert_allclose(observation.predict(rolled(run)).numpy(), exact, atol=0.004)
    assert len(exact) > 1


def test_gauges_read_the_height_of_a_layer_up_to_the_walls() -> None:
    rng = np.random.default_rng(2)
    run = flow(BAFFLED, 2)
    layer = rng.random((400, 2)) * [1.0, 0.08]
    layer[:, 0] = (np.arange(400) + 0.5) / 400
    run.positions[-1] = layer
    gauges = GaugesSettings(x=(0.0, 0.5, 0.99), spacing=0.1).operator(BAFFLED)
    np.testing.assert_allclose(gauges.observe(run), 0.08, rtol=0.01)
    # A run of another release than the scene's has its own.
    half = dataclasses.replace(run, volume=np.float32(0.5 * run.volumes))
    np.testing.assert_allclose(gauges.observe(half), 0.04, rtol=0.01)


@pytest.mark.parametrize(("count", "times"), [(2, (0.2, 0.5)), (4, (0.2, 0.5, 0.2, 0.5))])
def test_as_many_gauges_as_times(count: int, times: tuple[float, ...]) -> None:
    """A value for each pair, or for each gauge at each time: their number says which."""
    gauges = GaugesSettings(x=(0.1, 0.3), times=(0.2, 0.5), values=(0.05,) * count).operator(BAFFLED)
    assert gauges.x.tolist() == sorted((0.1, 0.3) * (count // 2))
    assert gauges.times.tolist() == list(times)


def test_a_noise_in_per_cent_without_its_sign_is_said() -> None:
    settings = FrontSettings(value=0.7, noise=5.0)
    with pytest.warns(UserWarning, match='a percentage is written "5%"'):
        settings.read(BAFFLED, Path(), (0.0, 1.0))
    tall = dataclasses.replace(BAFFLED, domain=dataclasses.replace(BAFFLED.domain, size=(20.0, 20.0)))
    with pytest.warns(UserWarning, match='noise of 5 is more than every number, at most 0.7; .* is written "5%"'):
        settings.read(tall, Path(), (0.0, 1.0))


def test_the_impulse_is_that_of_the_solid() -> None:
    run = flow(BAFFLED, 101)
    once = ImpulseSettings().operator(BAFFLED)
    np.testing.assert_allclose(once.observe(run), [2.0])
    twice = ImpulseSettings(times=(0.5, 0.123)).operator(BAFFLED)
    np.testing.assert_allclose(twice.observe(run)[0], 0.5)
    for force in (once, twice):
        assert not force.of_positions
        predicted = force.predict(dataclasses.replace(rolled(run), impulses=torch.from_numpy(run.solid_impulse)))
        np.testing.assert_allclose(predicted.numpy(), force.observe(run))
    refused(once.observe, dataclasses.replace(run, solid_impulse=None), said="solid 0")


def test_impulses_and_forces_in_2d_are_per_metre_of_width(tmp_path: Path) -> None:
    units = [settings.operator(BAFFLED).unit for settings in (ImpulseSettings(), PeakForceSettings(window=0.1))]
    assert units == ["N s/m", "N/m"]
    (tmp_path / "table.csv").write_text("time,impulse [N s]\n0.5,1\n1.0,2\n")
    read = ImpulseSettings(csv="table.csv", noise=0.1).read
    refused(read, BAFFLED, tmp_path, (0.0, 1.0), said="per metre of width in 2D, got impulse [N s]")


def test_an_outline_is_the_extent_of_the_deposit_each_way() -> None:
    scene = scene_of(Mass(lower=(0.4, 0.0, 0.4), size=(0.2, 0.2, 0.2)), size=(1.0, 0.5, 1.0), cell=0.05)
    outline = OutlineSettings(directions_deg=(0.0, 90.0, 180.0, 270.0)).operator(scene)
    angle = np.linspace(0.0, 2.0 * np.pi, 4000, endpoint=False)
    rim = np.stack([0.5 + 0.3 * np.cos(angle), np.zeros(4000), 0.5 + 0.2 * np.sin(angle)], axis=1)
    extents = outline.smooth(torch.from_numpy(rim), torch.ones(4000)).numpy()
    np.testing.assert_allclose(extents, [0.3, 0.2, 0.3, 0.2], rtol=0.001)


def block(*, speed: float = 2.0, until: float = 0.4, dimension: int = 2) -> Trajectory:
    """A block 0.2 m long and 0.1 m high that runs from the wall at 2 m/s (1000 particles), and stops at 0.4 s."""
    sides = (0.2, 0.1, 0.3)[:dimension]
    scene = scene_of(Mass(lower=(0.0,) * dimension, size=sides), size=(2.0, 0.5, 0.3)[:dimension], cell=0.02)
    scene = dataclasses.replace(scene, duration=1.0, frame_dt=0.05)
    lattice = np.stack(np.meshgrid(*(side * (np.arange(40) + 0.5) / 40 for side in sides), indexing="ij"), axis=-1)
    time = np.arange(21) * 0.05
    moved = np.zeros((21, 1, dimension))
    moved[:, 0, 0] = speed * np.minimum(time, until)
    return flow_of(scene, lattice.reshape(-1, dimension) + moved)


def test_a_flow_arrives_when_its_front_or_a_thickness_is_there() -> None:
    run = block()
    tip = measures.front(run.positions[0], run.volumes)
    arrival = ArrivalSettings(x=(tip + 0.33, 0.1, tip + 1.2)).operator(run.scene)
    # At 2 m/s; at the start; and as if what ran 0.8 m in 0.4 s had run on.
    np.testing.assert_allclose(arrival.observe(run), [0.165, 0.0, 0.6], atol=1e-6)
    # Half of the thickness at a gauge in the middle of its hat, which the edge of the block passes from x = 0.2 m on.
    half = ArrivalSettings(x=(0.7,), thickness=0.05, spacing=0.04).operator(run.scene)
    np.testing.assert_allclose(half.observe(run), [0.25], atol=0.003)
    beside = ArrivalSettings(x=(0.7,), z=0.1, thickness=0.05, spacing=0.04).operator(block(dimension=3).scene)
    np.testing.assert_allclose(beside.observe(block(dimension=3)), [0.25], atol=0.003)
    refused(lambda: ArrivalSettings(x=(0.7,), z=0.1).operator(block(dimension=3).scene), said="a thickness")


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_speed_at_a_place_is_the_mean_of_what_is_there(dimension: int) -> None:
    run = block(dimension=dimension)
    across = None if dimension == 2 else (0.1, 0.2)
    at = SpeedSettings(x=(0.2, 0.4), z=across, times=(0.1, 0.15, 0.9)).operator(run.scene)
    np.testing.assert_allclose(at.observe(run), [2.0, 2.0, 0.0], rtol=1e-5, atol=1e-9)
    # The block stops at 0.4 s, with its rear at 0.8 m: half of a window around that moment.
    peak = SpeedSettings(x=(0.8, 1.0), z=across).operator(run.scene)
    np.testing.assert_allclose(peak.observe(run), [2.0], rtol=1e-5)
    around = SpeedSettings(x=(0.8, 1.0), z=across, times=(0.4,), window=0.1).operator(run.scene)
    np.testing.assert_allclose(around.observe(run), [1.0], rtol=1e-5)
    refused(lambda: SpeedSettings(x=(0.4, 0.2)).operator(run.scene), said="two lengths")


def test_the_speed_of_a_narrow_flow_in_a_wide_box_is_its_own() -> None:
    """Seen over 1.6 m of a box 3 m wide, of which half a layer of particles is four times the volume of the block."""
    run = block(dimension=3)
    wide = dataclasses.replace(run.scene, domain=Domain(size=(2.0, 0.5, 3.0), cell=0.02))
    seen = SpeedSettings(x=(0.2, 1.8)).operator(wide)
    np.testing.assert_allclose(seen.observe(dataclasses.replace(run, scene=wide)), [2.0], rtol=1e-5)


def test_what_moves_is_differentiable_in_the_speed() -> None:
    """Arrival d / v has the slope -d / v^2, a speed v the slope 1."""
    run = block()
    speed = torch.tensor(2.0, dtype=torch.float64, requires_grad=True)
    start = torch.from_numpy(run.positions[0]).double()
    way = torch.tensor([1.0, 0.0]) * (speed * torch.clamp(torch.from_numpy(run.time), max=0.4))[:, None, None]
    rollout = Rollout(positions=start + way, times=run.time, volumes=torch.from_numpy(run.volumes))
    tip = measures.front(run.positions[0], run.volumes)
    for settings, slope in ((ArrivalSettings(x=(tip + 0.4,)), -0.1), (SpeedSettings(x=(0.2, 0.6)), 1.0)):
        (number,) = settings.operator(run.scene).predict(rollout)
        (derivative,) = torch.autograd.grad(number, speed, retain_graph=True)
        assert float(derivative) == pytest.approx(slope, rel=1e-4)


def test_a_run_that_ended_at_rest_goes_on_leaning_on_the_solid() -> None:
    """As one that was computed to its end does: by its impulse later, and by the peak over a long window."""
    run = flow(BAFFLED)
    whole, ended = (
        dataclasses.replace(run, solid_impulse=time[:, None, None] * [[3.0, 0.0]], summary={"end_time": time[-1]})
        for time in (run.time, np.minimum(run.time, 0.4))
    )
    for settings in (ImpulseSettings(times=(0.2, 0.9)), ImpulseSettings(), PeakForceSettings(window=0.8)):
        operator = settings.operator(run.scene)
        np.testing.assert_allclose(operator.observe(ended), operator.observe(whole), rtol=1e-9)


def test_the_peak_force_is_the_largest_mean_over_its_window() -> None:
    """J = 2 t^2 kg m/s and, from 0.5 s on, less by 3 N: the last window before 0.5 s, or any after it, either way."""
    run = flow(BAFFLED, 101)
    for window in (0.1, 0.085):
        peak = PeakForceSettings(window=window).operator(BAFFLED)
        # Exact at frames; between them J is a chord of the parabola, within dt^2 / 4 of it.
        np.testing.assert_allclose(peak.observe(run), 2.0 * (2.0 - window), atol=1e-9 if window == 0.1 else 1e-3)
    after = run.solid_impulse - 9.0 * np.maximum(run.time - 0.5, 0.0)[:, None, None] * [1.0, 0.0]
    falling = dataclasses.replace(run, solid_impulse=after)
    steepest = 9.0 - 2.0 * (2.0 * 0.5 + 0.1)
    peak = PeakForceSettings(window=0.1).operator(BAFFLED)
    np.testing.assert_allclose(peak.observe(falling), steepest, rtol=1e-9)
    rollout = dataclasses.replace(rolled(run), impulses=torch.from_numpy(run.solid_impulse))
    np.testing.assert_allclose(peak.predict(rollout).numpy(), 3.8)
    assert not peak.of_positions
    refused(PeakForceSettings(window=5.0).operator, BAFFLED, said="a time from")


def test_robust_noise_is_stated_in_a_table_and_drawn_with_its_tails(tmp_path: Path) -> None:
    times = ", ".join(f"{time:.3f}" for time in np.linspace(0.0, 1.0, 400))
    text = f'[[observations]]\nkind = "front"\ntimes = [{times}]\nnoise = {{ kind = "student", deviation = 0.01 }}\n'
    (tmp_path / "twin").mkdir()
    asked = written(tmp_path / "twin", text + "[target]\ntwin = true\n")
    target = read_target(asked, flow)
    np.testing.assert_array_equal(target.dof, 4.0)
    off = (target.values - target.observation.observe(flow(asked.scene))) / 0.01
    # Of 400 normal numbers 1 is beyond 3, of Student's t 16; and half of either within 0.67 and 0.74.
    assert 6 <= np.sum(np.abs(off) > 3.0) <= 32
    assert np.median(np.abs(off)) == pytest.approx(0.74, abs=0.12)
    # Beside normal noise one number is down-weighted, the other never.
    both = joined([target, dataclasses.replace(target, dof=None)], ["a", "b"])
    shown = both.reweighted((both.deviation * 10.0) ** 2)
    np.testing.assert_allclose(shown.deviation[:400] / both.deviation[:400], np.sqrt(104.0 / 5.0))
    np.testing.assert_allclose(shown.deviation[400:], both.deviation[400:])
    np.testing.assert_allclose(shown.reweighted(both.deviation**2).deviation, both.deviation)
