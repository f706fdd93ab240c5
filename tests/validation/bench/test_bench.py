"""The dispatcher: names, flags of a page, one line for a wrong name; the writer of pages; the page of speeds."""

import inspect
import shutil
from pathlib import Path

import numpy as np
import pytest

from datasets.lock import locked
from datasets.particles import particle_count
from validation.bench import __main__, efficiency
from validation.bench.__main__ import BENCHES, bench_of, main
from validation.bench.large import CELL, QUICK, friction, slide
from validation.bench.speed import CASES, column, enlarged, mean_x, modes


@pytest.mark.parametrize("name", BENCHES)
def test_every_module_has_a_bench_with_the_common_flags(name: str) -> None:
    out, *flags = inspect.signature(bench_of(name)).parameters.values()
    assert (out.name, out.kind) == ("out", out.POSITIONAL_OR_KEYWORD)
    assert {"quick", "keep"} <= {flag.name for flag in flags if flag.kind is flag.KEYWORD_ONLY}
    # Without its own flags a page is measured as it ships.
    assert all(flag.default is not flag.empty for flag in flags if flag.name not in ("quick", "keep"))


def test_a_page_gets_its_flags(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def bench(out: Path, *, quick: bool, keep: Path, seeds: int = 2) -> str:
        assert keep.is_dir()
        return f"{out.name} {quick} {seeds}"

    monkeypatch.setitem(BENCHES, "fake", "")
    monkeypatch.setattr(__main__, "bench_of", lambda _: bench)
    assert main(["fake", "--out", str(tmp_path), "--quick", "--seeds", "3"]) == 0
    assert capsys.readouterr().out.startswith(f"{tmp_path.name} True 3\n")
    assert main(["fake", "--out", str(tmp_path)]) == 0
    assert capsys.readouterr().out.startswith(f"{tmp_path.name} False 2\n")
    assert main(["fake", "--out", str(tmp_path), "--seeds", "many"]) == 2


def test_runs_that_another_process_keeps_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with locked(tmp_path / "keep"):
        assert main(["accuracy", "--out", str(tmp_path), "--keep", str(tmp_path / "keep"), "--quick"]) == 1
    assert "writes here since" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [[], ["experiment"]])
def test_a_wrong_name_takes_one_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "experiments" in error


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:masses:UserWarning")  # the MPM beside a network is coarse on purpose
@pytest.mark.parametrize(("name", "flags"), [("accuracy", ()), ("efficiency", ()), ("gns", ("--model", "flow2d"))])
def test_a_quick_page(name: str, flags: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(efficiency, "JITTERS", 2)
    assert main([name, "--quick", "--out", str(tmp_path), *flags]) == 0
    assert "--quick" in (tmp_path / f"{name}.md").read_text()
    assert list(tmp_path.rglob("*.png"))


def test_columns_have_the_particles_that_the_cases_state() -> None:
    assert [case.particles for case in CASES if case.dimension == 2] == [3200, 3200, 25088, 100352, 1002528]
    assert particle_count(enlarged(2.0, 0.1)) == 4 * particle_count(enlarged(1.0, 0.1)) == 12800
    assert modes(CASES[0]) == [("f32", 1), ("f64", 1)]
    assert column(3, 32, 10).frames == 11


def test_the_large_terrain_has_about_a_million_particles() -> None:
    assert particle_count(slide(CELL)) == 1_013_760
    # The larger cells of its search fit the box too.
    assert [particle_count(slide(2.0 * cell)) for cell in (CELL, QUICK)] == [130_560, 1920]
    assert friction(QUICK).loop.budget(1) == 6


def test_the_objective_of_the_priced_gradient_has_its_derivative() -> None:
    positions = np.random.default_rng(0).random((1, 5, 2))
    value, slope, _ = mean_x(positions, positions)
    moved = positions.copy()
    moved[0, 3, 0] += 1e-6
    assert (mean_x(moved, moved)[0] - value) / 1e-6 == pytest.approx(slope[0, 3, 0])


@pytest.mark.skipif(shutil.which("nvidia-smi") is not None, reason="there may be a GPU here")
def test_a_page_of_a_gpu_needs_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["gpu", "--out", str(tmp_path)]) == 2
    assert "expected a GPU that torch can use, there is none" in capsys.readouterr().err
    assert not (tmp_path / "gpu.md").exists()
