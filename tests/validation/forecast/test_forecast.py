"""Forecasts: intervals that hold further flows, maps of probability, what a scene has not, mistakes in a line."""

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import rasterio
from scipy.stats import norm

from datasets import Mass, Scene, Solid, Trajectory
from datasets.errors import InputError
from inverse.saving import in_scene, known_of
from mpm import ALL, LAST
from tests.refusals import refused, refused_by
from tests.scenes import flow_of, room, scene_of
from validation import forecast_scene
from validation.forecast.__main__ import main
from validation.forecast.predict import cells_error, height_of, numbers_of, predicted, recording_of, with_peaks
from validation.run_store import RunStore

SCENE = scene_of(Mass(lower=(0.0, 0.0), size=(0.2, 0.2)), duration=0.1, frame_dt=0.05, floor_friction=0.4)
MEAN, DEVIATION = 30.0, 1.5  # of the posterior of the friction angle [deg]
SCATTER = 0.004  # of fronts by the jitter [m]


class Slabs:
    """Deposits in one place, x = 0.6 m - 10 mm (phi - 30 deg) and a scatter; 30 mm longer on cells half as large."""

    def __init__(self, scatter: float = SCATTER) -> None:
        self.scatter, self.runs = scatter, 0

    def __call__(self, scenes: Sequence[Scene], *, record: object = LAST) -> list[Trajectory]:
        self.runs += len(scenes)
        return [self.flow(scene) for scene in scenes]

    def flow(self, scene: Scene) -> Trajectory:
        scatter = self.scatter * np.random.default_rng(scene.seed).normal()
        x = 0.6 - 0.01 * (scene.material.friction_deg - MEAN) + scatter
        if scene.domain.cell < SCENE.domain.cell:
            x += 0.03
        place = [x, 0.02] if scene.dimension == 2 else [x, 0.02, 0.4]
        return flow_of(scene, np.tile(place, (2, 50, 1)), time=np.array([0.0, scene.duration]))


def posterior(folder: Path, names: Sequence[str] = ("friction_deg",), verdict: str = "confirmed") -> Path:
    samples = np.random.default_rng(1).normal(MEAN, DEVIATION, size=(2000, len(names)))
    folder.mkdir(exist_ok=True)
    np.savez(folder / "posterior.npz", names=np.array(names), samples=samples, weights=np.full(2000, 1.0 / 2000))
    (folder / "result.json").write_text(json.dumps({"verdict": verdict}))
    return folder


def test_an_interval_holds_further_flows_as_often_as_it_says() -> None:
    """Of 80 twins: one draw of the posterior is the truth of each, whose flow has a scatter of its own."""
    rng, flows = np.random.default_rng(0), Slabs()
    coarse = replace(SCENE, domain=replace(SCENE.domain, size=(0.98, 0.5)))
    samples, held = rng.normal(MEAN, DEVIATION, size=(2000, 1)), {"interval": 0, "half": 0}
    for twin in range(80):
        scene = replace(coarse, seed=twin)
        forecast = predicted(scene, ["friction_deg"], samples, flows, draws=40)
        truth = replace(scene.with_friction_deg(float(rng.choice(samples[:, 0]))), seed=int(rng.integers(2**31)))
        x = float(flows.flow(truth).positions[-1, 0, 0])
        # The error of the cells is none of this flow's.
        values = np.sort(forecast.numbers["front"])
        for key, level in (("interval", 0.95), ("half", 0.5)):
            low, high = np.quantile(values, [0.5 - 0.5 * level, 0.5 + 0.5 * level], method="weibull")
            held[key] += low <= x <= high
        assert forecast.cells["front"] == pytest.approx(0.06, abs=4.0 * SCATTER)
    assert held["interval"] >= 70
    assert 27 <= held["half"] <= 53


def test_the_error_of_the_cells_and_of_the_model_widen_an_interval() -> None:
    """Normal errors of posterior, scatter, cells and model, whose variances add."""
    samples = np.random.default_rng(0).normal(MEAN, DEVIATION, size=(4000, 1))
    forecast = predicted(SCENE, ["friction_deg"], samples, Slabs(), draws=1000, model_error=0.05)
    spread = np.sqrt((0.01 * DEVIATION) ** 2 + SCATTER**2 + forecast.cells["front"] ** 2 + (0.05 * (0.6 - 0.2)) ** 2)
    low, high = forecast.as_json()["numbers"]["front"]["interval"]
    assert high - low == pytest.approx(2.0 * norm.ppf(0.975) * spread, rel=0.1)
    assert forecast.as_json()["numbers"]["front"]["median"] == pytest.approx(0.6, abs=0.01)


@pytest.mark.parametrize("fits", [True, False])
def test_a_box_of_an_odd_number_of_cells_has_an_error_of_the_cells_too(fits: bool) -> None:
    """In 3D, 41 cells long: a run on half the cells shows it, and a remark says so if that needs too much memory."""

    class Limited(Slabs):
        def flow(self, scene: Scene) -> Trajectory:
            if scene.domain.cell < 0.02 and not fits:
                raise InputError("a run needs more memory than is free")
            return super().flow(scene)

    sand = Mass(lower=(0.0, 0.0, 0.3), size=(0.2, 0.1, 0.2))
    scene, flows = room(sand, cell=0.02, size=(0.82, 0.82, 0.8)), Limited(scatter=0.0)
    cells, remark = cells_error(scene, ["friction_deg"], np.array([MEAN]), flows)
    assert cells.get("front") == (pytest.approx(0.06) if fits else None)
    assert remark.startswith("" if fits else "no interval includes the error of the cells: domain.size: expected")


def test_files_and_what_a_scene_has_not(tmp_path: Path) -> None:
    """The same command again makes no run; an unknown that the scene lacks, and a doubtful answer, are said."""
    result, flows = posterior(tmp_path / "loop", ("baffles[0].x", "friction_deg"), "ambiguous"), Slabs()
    for _ in range(2):
        forecast = forecast_scene(result, SCENE, tmp_path / "out", draws=10, simulate=flows)
    assert flows.runs == 14
    assert forecast.names == ("friction_deg",)
    said = json.loads((tmp_path / "out" / "forecast.json").read_text())
    assert "baffles[0].x of the inversion is not used" in said["remarks"][0]
    assert "ambiguous" in said["remarks"][1]
    assert "10 flows enclose a further one in 82 % of the cases" in said["remarks"]
    assert len(said["profile"]["x"]) == len(said["profile"]["upper"])
    assert (tmp_path / "out" / "forecast.png").exists()
    assert (tmp_path / "out" / "report.md").exists()


def test_maps_of_probability(tmp_path: Path) -> None:
    """A cell between two places is covered by the flows of the larger angles alone."""
    flows = Slabs(scatter=0.0)
    scene = replace(room(Mass(lower=(0.0, 0.0, 0.3), size=(0.2, 0.1, 0.2))), floor_friction=0.4)
    samples = np.repeat([20.0, 40.0], 500)[:, None]
    store = RunStore(tmp_path / "mpm", flows, reduce=partial(with_peaks, threshold=1.0e-4))
    forecast = predicted(scene, ["friction_deg"], samples, store, draws=10, threshold=1.0e-4)
    thickness = forecast.covered["thickness"]
    assert thickness[(np.array([0.5, 0.7]) / 0.04).astype(int), 10] == pytest.approx(0.5)
    assert thickness[5, 10] == 0.0
    forecast_scene(posterior(tmp_path / "loop"), scene, tmp_path / "out", draws=4, simulate=flows)
    with rasterio.open(tmp_path / "out" / "probability-depth.tif") as raster:
        assert 0.0 <= raster.read(1).min() <= raster.read(1).max() <= 1.0


def test_the_mean_height_of_a_thin_deposit_is_that_of_its_thickness() -> None:
    """0.02 m thick over 0.4 x 0.4 m on cells of 0.04 m, whose particles have sunk to the ground; less at its edges."""
    scene = room(Mass(lower=(0.0, 0.0, 0.3), size=(0.2, 0.1, 0.2)))
    x, z = np.meshgrid(*(0.2 + 0.01 * (np.arange(40) + 0.5),) * 2, indexing="ij")
    positions = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1)
    assert height_of(scene, positions, np.full(x.size, 0.02 * 0.01**2)) == pytest.approx(0.01, rel=0.1)


@pytest.mark.parametrize("frames", [20, 200])
def test_the_largest_force_does_not_depend_on_the_duration(frames: int) -> None:
    """A blow of 3 N s within a frame of 0.05 s, of a run of so many."""
    scene = replace(SCENE, solids=(Solid(name="wall", lower=(0.8, 0.0), size=(0.1, 0.1)),), duration=0.05 * frames)
    impulse = np.zeros((frames + 1, 1, 2), np.float32)
    impulse[8:, 0, 0] = 3.0
    run = flow_of(scene, np.full((frames + 1, 4, 2), 0.1), solid_impulse=impulse)
    deposit = with_peaks(run)
    assert recording_of(scene) == ALL
    assert numbers_of(deposit)["force wall"] == pytest.approx(60.0)
    assert len(deposit.positions) == len(deposit.time) == 1


def test_the_angle_is_that_of_the_material_which_an_unknown_changes(tmp_path: Path) -> None:
    """Not that of the scene where the mass has one of its own."""
    result = posterior(tmp_path / "loop", ("masses[0].friction_deg",))
    (result / "result.json").write_text(json.dumps({"angle": {"masses[0].friction_deg": "slope"}}))
    own, slope = replace(SCENE.masses[0], material=SCENE.material), replace(SCENE.material, angle="slope")
    refused(lambda: known_of(result, replace(SCENE, masses=(own,), material=slope)), said="masses[0].material.angle")
    known_of(result, replace(SCENE, masses=(replace(own, material=slope),)))
    known_of(result, replace(SCENE, material=slope))


def test_the_solid_of_an_unknown_is_found_by_its_name_or_its_kind() -> None:
    """Not by its place in the list: barriers stand before the terrain in one scene and behind it in the other."""
    wall = Solid(name="wall", lower=(0.8, 0.0), size=(0.1, 0.1))
    ground = Solid(kind="terrain", points=((0.0, 0.0), (1.0, 0.0)))
    scene = replace(SCENE, solids=(ground, wall, replace(wall, name="low", lower=(0.6, 0.0))))
    before = [("wall", "box"), ("bed", "terrain"), (None, "box"), (None, "mesh")]
    renamed = [in_scene(f"solids[{index}].friction", before, scene) for index in range(2)]
    assert renamed == ["solids[1].friction", "solids[0].friction"]
    assert in_scene("solids[2].friction", before, scene) == "solids[2].friction"  # one of two boxes, in its place
    refused(in_scene, "solids[3].friction", before, scene, said="expected a mesh in the scene, as solids[3]")
    for name in ("friction_deg", "solids[9].friction"):
        assert in_scene(name, before, scene) == name


def test_mistakes_in_a_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result, out = posterior(tmp_path / "loop"), ("--out", tmp_path / "out")
    other = posterior(tmp_path / "other", ("baffles[0].x",))
    assert "posterior.npz" in refused_by(capsys, main, tmp_path, "column-tall-42", *out)
    assert "baffles[0].x" in refused_by(capsys, main, other, "column-tall-42", *out)
    assert "--draws" in refused_by(capsys, main, result, "column-tall-42", *out, "--draws", 1)
    assert "--model-error" in refused_by(capsys, main, result, "column-tall-42", *out, "--model-error", -0.1)
    assert "3D" in refused_by(capsys, main, result, "column-tall-42", *out, "--pressure", 100)
    record = json.loads((result / "result.json").read_text()) | {"angle": "slope"}
    (result / "result.json").write_text(json.dumps(record))
    refused(lambda: forecast_scene(result, SCENE), said="material.angle: expected slope, as in the inversion")
    wild = tmp_path / "wild.npz"
    np.savez(wild, names=np.array(["friction_deg"]), samples=np.full((10, 1), 95.0), weights=np.full(10, 0.1))
    refused(lambda: forecast_scene(wild, SCENE, simulate=Slabs()), said="friction_deg = 95")
    (tmp_path / "broken.npz").write_bytes(b"PK")
    refused(lambda: forecast_scene(tmp_path / "broken.npz", SCENE), said="broken.npz")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_forces_on_a_barrier_by_the_real_mpm(tmp_path: Path) -> None:
    forecast = forecast_scene(posterior(tmp_path / "loop"), "baffles-2", draws=2)
    assert min(forecast.numbers["force baffles[0]"]) > 0.0
    assert forecast.covered["depth"].max() == 1.0
    assert (forecast.covered["depth"] >= forecast.covered["thickness"]).all()
