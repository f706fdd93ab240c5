"""`python -m validation.bench.speed.bench`: runs timed in turn, and the tables made of them."""

import dataclasses
from pathlib import Path

import pytest

from datasets.command_line import run
from datasets.library import read_scene
from datasets.particles import initial_particles, particle_count
from mpm.arrays.features import features_of
from validation.bench.speed import bench as speed
from validation.bench.speed import gains, rates
from validation.bench.speed.page import page
from validation.bench.speed.rates import Case, Way
from validation.report import machine, timing
from validation.report.timing import Run, Spread, Took, in_turn, ratio


def took(seconds: float, particle_steps: int = 1_000_000, front: float = 0.5, rest_time: float | None = None) -> Took:
    return Took(seconds=seconds, particle_steps=particle_steps, front=front, rest_time=rest_time)


def cells_of(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip("|").split("|")]


def row_of(table: list[str], name: str) -> list[str]:
    (row,) = [cells_of(line) for line in table if cells_of(line)[0] == name]
    return row


def test_a_spread_is_median_and_range() -> None:
    spread = Spread.of([3.0, 1.0, 2.0, 10.0])
    assert (spread.least, spread.middle, spread.greatest) == (1.0, 2.5, 10.0)
    assert spread.written(1) == "2.5 (1.0-10.0)"
    assert Spread.of([2.0]).written(1) == "2.0"


def test_ratios_are_taken_round_by_round() -> None:
    # The machine was half as fast in the second round.
    assert ratio([took(2.0), took(4.0)], [took(1.0), took(2.0)]) == Spread(least=2.0, middle=2.0, greatest=2.0)


def test_runs_take_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    order = []

    def fake(run: Run) -> Took:
        order.append((run.precision, run.threads))
        return took(1.0)

    monkeypatch.setattr(timing, "timed", fake)
    scenes = (rates.column(2, 50, 1),)
    runs = {
        "a": Run(scenes=scenes, precision="f64"),
        "b": Run(scenes=scenes, threads=2),
        "c": Run(scenes=scenes),
    }
    assert {key: len(each) for key, each in in_turn(runs, 2, "").items()} == {"a": 2, "b": 2, "c": 2}
    assert order == [("f32", 1), ("f32", 2), ("f64", 1)] * 2


def test_a_run_is_timed_and_its_points_and_steps_counted() -> None:
    scene = rates.column(2, 20, 2)
    once, twice = timing.timed(Run(scenes=(scene,))), timing.timed(Run(scenes=(scene, scene)))
    assert once.particle_steps % particle_count(scene) == 0
    assert twice.particle_steps == 2 * once.particle_steps > 0
    assert once.seconds > 0.0
    assert once.rate == pytest.approx(once.particle_steps / once.seconds / 1e6)
    assert 0.15 < once.front < 0.25


@pytest.mark.parametrize("case", rates.CASES, ids=lambda case: f"{case.dimension}D-{case.cells}-{case.scenes}")
def test_a_case_is_the_same_column_on_its_grid(case: Case) -> None:
    scene = rates.column(case.dimension, case.cells, case.frames)
    assert scene.frames == case.frames + 1
    volume = 0.08 if case.dimension == 2 else rates.CUBE**3
    assert particle_count(scene) * scene.particle_volume == pytest.approx(volume, rel=0.03)


def test_sizes_are_those_that_others_were_measured_at() -> None:
    sizes = [(case.dimension, particle_count(rates.column(case.dimension, case.cells, 1))) for case in rates.CASES]
    for dimension, points in ((2, 3_200), (2, 25_000), (2, 100_000), (2, 1_000_000), (3, 13_400), (3, 500_000)):
        assert any(own == dimension and abs(size / points - 1.0) < 0.05 for own, size in sizes)


def test_small_scenes_run_on_a_thread_each_and_large_ones_on_all() -> None:
    small, batch, large = rates.CASES[0], rates.CASES[1], rates.CASES[4]
    assert rates.ways(small, 2) == [Way(precision="f32", threads=1), Way(precision="f64", threads=1)]
    assert rates.ways(batch, 2) == [Way(precision="f32", threads=2), Way(precision="f64", threads=2)]
    assert [way.threads for way in rates.ways(large, 4)] == [1, 4, 4]
    assert [way.threads for way in rates.ways(large, 1)] == [1, 1]
    seeds = [scene.seed for scene in rates.runs([batch], 2)[batch, Way(precision="f32", threads=2)].scenes]
    assert seeds == [0, 1]


def test_the_table_of_rates() -> None:
    small = Case(dimension=2, cells=100, scenes=1, frames=1, aim=25.0, limit=180.0)
    large = Case(dimension=2, cells=560, scenes=1, frames=1, aim=42.0, limit=199.0)
    measured = {
        (small, Way(precision="f32", threads=1)): [took(0.02), took(0.025), took(0.04)],  # 50, 40, 25 M/s
        (small, Way(precision="f64", threads=1)): [took(0.05)] * 3,
        (large, Way(precision="f32", threads=1)): [took(0.05)] * 3,
        (large, Way(precision="f32", threads=2)): [took(1 / 30)] * 3,
        (large, Way(precision="f64", threads=2)): [took(0.04)] * 3,
    }
    head, _, first, second = rates.rates_table(measured)
    assert cells_of(head)[3:6] == ["f32, 1 thread", "f32, 2 threads", "f64, 2 threads"]
    assert cells_of(first)[:3] == ["2D", "3,200", "1"]
    assert cells_of(first)[3:] == ["40.0 (25.0-50.0)", "-", "20.0 on 1", "25: met", "90: 44 %"]
    assert cells_of(second)[1] == "100,352"
    assert cells_of(second)[3:] == ["20.0", "30.0", "25.0", "42: 71 %", "99.5: 30 %"]


def test_other_codes_have_a_rate_per_column() -> None:
    lines = rates.others_table()
    assert len({line.count("|") for line in lines}) == 1
    assert row_of(lines, "taichi_elements, sand, f32")[1] == "1.7-2.7"


@pytest.mark.parametrize("dimension", [2, 3])
def test_every_switch_compiles_one_thing_more(dimension: int) -> None:
    runs = gains.switches(dimension)

    def needs(name: str) -> dict[str, object]:
        scenes = runs[name].scenes
        found = features_of(
            scenes,
            [initial_particles(scene) for scene in scenes],
            "f32",
            record=runs[name].record,
        )
        return dataclasses.asdict(found)

    plain = needs(gains.PLAIN)
    changed = {name: {key for key in plain if needs(name)[key] != plain[key]} for name in runs}
    assert changed.pop(gains.PLAIN) == set()
    assert list(changed.values()) == [
        {"damped"},
        {"cohesive"},
        {"dilates"},
        {"heterogeneous"},
        {"contact"},
        {"velocity_recorded", "pressure_recorded", "strain_recorded", "walls_recorded"},
    ]
    counts = {particle_count(run.scenes[0]) for run in runs.values()}
    assert len(counts) == 1


@pytest.mark.parametrize("dimension", [2, 3])
def test_one_cell_of_material_spans_the_grid(dimension: int) -> None:
    scene = gains.plain(dimension)
    wide = gains.spanned(scene)
    points = initial_particles(wide).positions
    assert len(points) - particle_count(scene) == 2**dimension
    assert points.max(axis=0) == pytest.approx(scene.domain.size, abs=scene.domain.cell)


def test_the_table_of_needs() -> None:
    names = [*gains.switches(2), *gains.boxes(2)]
    measured = {(2, name): [took(1.0), took(1.5)] for name in names}
    measured[2, "damping"] = [took(1.2), took(1.8)]
    measured[2, f"{gains.SPANNED}, 1 m"] = [took(3.0), took(4.5)]
    measured[2, f"{gains.ALONE}, 2 m"] = [took(1.1), took(1.65)]
    lines = gains.needs_table(measured)
    assert row_of(lines, "damping") == ["damping", "x 1.20"]
    assert row_of(lines, "dilation")[1] == "x 1.00"
    assert row_of(lines, "whole grid cleared and updated, box of 1 m")[1] == "x 3.00"
    assert row_of(lines, "a domain of 2 m in place of 1 m, active box only")[1] == "x 1.10"


def test_the_table_of_shortcuts() -> None:
    lines = gains.shortcuts_table(
        {
            ("heap", gains.FULL): [took(2.0, front=0.5)],
            ("heap", gains.REST): [took(1.0, front=0.499, rest_time=0.44)],
            ("heap", gains.SHORT): [took(4.4, front=0.45)],
        }
    )
    assert cells_of(lines[-1]) == [
        "`heap`",
        "2.00",
        "0.44",
        "x 0.50",
        "-1.0 mm (-0.2 %)",
        "x 2.20",
        "-50.0 mm (-10.0 %)",
    ]


def test_shortcuts_take_the_scene_as_it_ships() -> None:
    runs = gains.shortcut_runs(["column-tall-42"])
    ships = read_scene("column-tall-42")
    assert runs["column-tall-42", gains.FULL].scenes == runs["column-tall-42", gains.REST].scenes == (ships,)
    assert runs["column-tall-42", gains.REST].record.until_rest
    (short,) = runs["column-tall-42", gains.SHORT].scenes
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


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["sph"], "sph"),
        (["mpm", "--rounds", "0"], "--rounds"),
        (["mpm", "--trajectories", "1001"], "--trajectories"),
        (["mpm", "--full"], "--full"),
        (["gns", "--trajectories", "0"], "--trajectories"),
        (["gns", "--longest", "0"], "--longest"),
        (["memory", "--rounds", "2"], "--rounds"),
        (["memory", "--threads", "0"], "--threads"),
    ],
)
def test_wrong_input_is_one_line_and_status_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], named: str
) -> None:
    assert run(speed.command, "speed", [*arguments, "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert named in told
    assert told.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_whole_command_on_tiny_scenes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cases = tuple(Case(dimension=d, cells=16, scenes=scenes, frames=1, aim=0.001) for d in (2, 3) for scenes in (1, 2))
    monkeypatch.setattr(rates, "CASES", cases)
    monkeypatch.setattr(gains, "CELLS", {2: 20, 3: 16})
    monkeypatch.setattr(gains, "DURATION", {2: 0.005, 3: 0.005})
    monkeypatch.setattr(gains, "SCENES", ("column-short-42",))
    assert run(speed.command, "speed", ["mpm", "--out", str(tmp_path), "--rounds", "2", "--trajectories", "1"]) == 0
    text = (tmp_path / "speed.md").read_text()
    assert text.count("0.001: met") == 4
    for part in (
        "obstacle3d --count 1",
        "| damping |",
        "column-short-42",
        "GeoTaichi",
        "validation.bench.speed.bench mpm --rounds 2",
    ):
        assert part in text


def test_the_page_has_its_sections() -> None:
    case = Case(dimension=2, cells=100, scenes=1, frames=1)
    text = page(
        {(case, Way(precision=precision, threads=1)): [took(1.0)] for precision in ("f32", "f64")},
        {(2, name): [took(1.0)] for name in [*gains.switches(2), *gains.boxes(2)]},
        {("heap", kind): [took(1.0)] for kind in (gains.FULL, gains.REST, gains.SHORT)},
        rounds=1,
    )
    assert [line for line in text.splitlines() if line.startswith("#")] == [
        "# The speed of the MPM",
        "## Million point-steps a second",
        "## What a scene does not need costs nothing",
        "## Shortcuts",
        "## What makes it fast",
    ]
    assert "## A training set" not in text
