"""`python -m validation.bench speed`: runs timed in turn, and the tables made of them."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace

import pytest

from datasets.errors import InputError
from datasets.library import read_scene
from datasets.particles import initial_particles, particle_count
from datasets.scene import Scene
from mpm.arrays.features import features_of
from validation.bench.speed import features, mpm, rates
from validation.bench.speed.rates import Mode, RateCase
from validation.report import machine, timing
from validation.report.page import table
from validation.report.timing import Spread, TimedRun, Timing, in_turn, ratio, spread


def timing_of(seconds: float, front: float = 0.5, rest_time: float | None = None) -> Timing:
    return Timing(seconds=seconds, particle_steps=1_000_000, front=front, rest_time=rest_time)


def test_spreads_and_ratios() -> None:
    assert spread([3.0, 1.0, 2.0, 10.0]) == Spread(minimum=1.0, median=2.5, maximum=10.0)
    assert spread([3.0, 1.0, 2.0, 10.0]).written(1) == "2.5 (1.0-10.0)"
    assert spread([2.0]).written(1) == "2.0"
    # The machine was half as fast in the second round.
    assert ratio([timing_of(2.0), timing_of(4.0)], [timing_of(1.0), timing_of(2.0)]) == spread([2.0])


def test_runs_take_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    order = []

    def timed(run: TimedRun) -> Timing:
        order.append((run.precision, run.threads))
        return timing_of(1.0)

    monkeypatch.setattr(timing, "timed", timed)
    scenes = (rates.column(2, 50, 1),)
    runs = {
        "a": TimedRun(scenes=scenes, precision="f64"),
        "b": TimedRun(scenes=scenes, threads=2),
        "c": TimedRun(scenes=scenes),
    }
    assert {key: len(each) for key, each in in_turn(runs, 2, "").items()} == {"a": 2, "b": 2, "c": 2}
    assert order == [("f32", 1), ("f32", 2), ("f64", 1)] * 2


def test_a_run_is_timed_and_its_particle_steps_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    def simulate(scenes: tuple[Scene, ...], **_: object) -> list[SimpleNamespace]:
        summary = {"wall_s": 2.0, "particles": 100, "steps": 30, "front": 0.2, "rest_time": None}
        return [SimpleNamespace(summary=summary) for _ in scenes]

    monkeypatch.setattr(timing, "simulate_many", simulate)
    scene = rates.column(2, 20, 2)
    found = timing.timed(TimedRun(scenes=(scene, scene)))
    assert (found.seconds, found.particle_steps, found.front) == (2.0, 6_000, 0.2)
    assert found.rate == pytest.approx(0.003)


def test_cases_are_the_same_column_at_the_sizes_of_other_codes() -> None:
    for case in rates.CASES:
        scene = rates.column(case.dimension, case.cells, case.frames)
        assert scene.frames == case.frames + 1
        volume = 0.08 if case.dimension == 2 else rates.CUBE**3
        assert particle_count(scene) * scene.particle_volume == pytest.approx(volume, rel=0.03)
    sizes = [(case.dimension, case.particles) for case in rates.CASES]
    for dimension, particles in ((2, 3_200), (2, 25_000), (2, 100_000), (2, 1_000_000), (3, 13_400), (3, 500_000)):
        assert any(own == dimension and abs(size / particles - 1.0) < 0.05 for own, size in sizes)


def test_small_scenes_run_on_a_thread_each_and_large_ones_on_all() -> None:
    small, copies, large = rates.CASES[0], rates.CASES[1], rates.CASES[4]
    assert rates.modes(small, 2) == [Mode(precision="f32", threads=1), Mode(precision="f64", threads=1)]
    assert rates.modes(copies, 2) == [Mode(precision="f32", threads=2), Mode(precision="f64", threads=2)]
    assert [mode.threads for mode in rates.modes(large, 4)] == [1, 4, 4]
    assert [mode.threads for mode in rates.modes(large, 1)] == [1, 1]
    runs = rates.runs([copies], 2)[copies, Mode(precision="f32", threads=2)]
    assert [scene.seed for scene in runs.scenes] == [0, 1]


SMALL = RateCase(dimension=2, cells=100, scenes=1, frames=1, aim=25.0, limit=180.0)
LARGE = RateCase(dimension=2, cells=560, scenes=1, frames=1, aim=42.0, limit=199.0)
SPEEDS = {
    (SMALL, Mode(precision="f32", threads=1)): [timing_of(0.02), timing_of(0.025), timing_of(0.04)],
    (SMALL, Mode(precision="f64", threads=1)): [timing_of(0.05)] * 3,
    (LARGE, Mode(precision="f32", threads=1)): [timing_of(0.05)] * 3,
    (LARGE, Mode(precision="f32", threads=2)): [timing_of(1 / 30)] * 3,
    (LARGE, Mode(precision="f64", threads=2)): [timing_of(0.04)] * 3,
}


def test_the_table_of_rates() -> None:
    first, second = rates.rate_rows(SPEEDS)
    assert isinstance(first, dict)
    assert isinstance(second, dict)
    assert list(first)[3:6] == ["f32, 1 thread", "f32, 2 threads", "f64, 2 threads"]
    assert list(first.values()) == ["2D", "3,200", 1, "40.0 (25.0-50.0)", "-", "20.0 on 1", "25: met", "90: 44 %"]
    assert list(second.values()) == ["2D", "100,352", 1, "20.0", "30.0", "25.0", "42: 71 %", "99.5: 30 %"]
    assert "1.7-2.7" in table(rates.other_rows())


@pytest.mark.parametrize("dimension", [2, 3])
def test_every_switch_compiles_one_feature_more(dimension: int) -> None:
    runs = features.switches(dimension)

    def compiled(name: str) -> dict[str, object]:
        scenes = runs[name].scenes
        particles = [initial_particles(scene) for scene in scenes]
        return dataclasses.asdict(features_of(scenes, particles, "f32", record=runs[name].record))

    plain = compiled(features.PLAIN)
    changed = {name: {key for key in plain if compiled(name)[key] != plain[key]} for name in runs}
    assert changed.pop(features.PLAIN) == set()
    assert list(changed.values()) == [
        {"damped"},
        {"cohesive"},
        {"dilates"},
        {"heterogeneous"},
        {"contact"},
        {"velocity_recorded", "pressure_recorded", "strain_recorded", "walls_recorded"},
    ]
    assert len({particle_count(run.scenes[0]) for run in runs.values()}) == 1
    scene = features.plain(dimension)
    positions = initial_particles(features.with_corner_cell(scene)).positions
    assert len(positions) - particle_count(scene) == 2**dimension
    assert positions.max(axis=0) == pytest.approx(scene.domain.size, abs=scene.domain.cell)


def test_the_page_and_its_conclusion() -> None:
    switched = {(2, name): [timing_of(1.0), timing_of(1.5)] for name in (*features.switches(2), *features.boxes(2))}
    switched[2, "damping"] = [timing_of(1.2), timing_of(1.8)]
    switched[2, f"{features.WHOLE}, 1 m"] = [timing_of(3.0), timing_of(4.5)]
    switched[2, f"{features.ACTIVE}, 2 m"] = [timing_of(1.1), timing_of(1.65)]
    short = {
        ("column", features.FULL): [timing_of(2.0, front=0.5)],
        ("column", features.REST): [timing_of(1.0, front=0.499, rest_time=0.44)],
        ("column", features.SHORT): [timing_of(4.4, front=0.45)],
    }
    text = str(mpm.page(SPEEDS, switched, short, command="the command"))
    assert "In 2D 30.0 to 40.0 million particle-steps a second from 3,200 to 100,352 particles; 1 of 2 aims" in text
    assert "The costliest single feature is damping, x 1.20; updating the whole grid instead of the active box" in text
    assert "up to x 3.00." in text
    assert "Ending at rest takes 0.50 to 0.50 of the seconds" in text
    assert "takes 2.20 to 2.20 times as long and moves fronts by up to 50.0 mm." in text
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    assert ["damping", "x 1.20"] in cells
    assert ["a domain of 2 m in place of 1 m, active box", "x 1.10"] in cells
    assert ["`column`", "2.00", "0.44", "x 0.50", "-1.0 mm (-0.2 %)", "x 2.20", "-50.0 mm (-10.0 %)"] in cells


def test_shortcuts_are_of_the_scene_as_it_ships() -> None:
    runs = features.shortcut_runs(["column-tall-42"])
    ships = read_scene("column-tall-42")
    assert runs["column-tall-42", features.FULL].scenes == runs["column-tall-42", features.REST].scenes == (ships,)
    assert runs["column-tall-42", features.REST].record.until_rest
    (short,) = runs["column-tall-42", features.SHORT].scenes
    assert short == dataclasses.replace(ships, step_fraction=0.4)


def test_the_machine_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    file = tmp_path / "cpuinfo"
    file.write_text("processor\t: 0\nmodel name\t: Some CPU\nflags\t\t: fpu avx512f\n\nmodel name\t: Another\n")
    monkeypatch.setattr(machine, "CPUINFO", file)
    assert machine.machine().startswith("Some CPU with AVX-512, ")
    assert "Taichi 1." in machine.machine()
    assert "PyTorch 2." in machine.machine(machine.GNS)
    monkeypatch.setattr(machine, "CPUINFO", tmp_path / "absent")
    assert machine.machine()


@pytest.mark.parametrize(("flags", "named"), [({"rounds": 0}, "--rounds"), ({"trajectories": 1001}, "--trajectories")])
def test_wrong_flags_are_errors(tmp_path: Path, flags: dict[str, int], named: str) -> None:
    with pytest.raises(InputError, match=named):
        mpm.bench(tmp_path, quick=False, keep=tmp_path, **flags)
