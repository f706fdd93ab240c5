"""The pages: what they share; the writer of pages; the page of speeds."""

import inspect
import shutil
from pathlib import Path

import numpy as np
import pytest

from datasets.lock import locked
from datasets.scene.particles import particle_count
from tests.commands import found_at
from validation.bench import efficiency
from validation.bench import gns as bench_gns
from validation.bench import page as pages
from validation.bench.__main__ import PAGES, main
from validation.bench.accuracy import bench as accuracy
from validation.bench.measuring import Spread
from validation.bench.page import formatted, write_page
from validation.bench.speed import CASES, column, mean_x, modes, slide
from validation.runs import kept


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_measured_as_it_ships_without_flags_of_its_own(name: str) -> None:
    out, *flags = inspect.signature(found_at(PAGES[name][0])).parameters.values()
    assert out.name == "out"
    # A comparison's data are not in the repository.
    assert all(flag.default is not flag.empty for flag in flags if flag.name != "data")


def test_finished_work_is_held_and_goes_with_a_temporary_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with kept(None) as folder:
        assert folder.is_dir()
    assert not folder.exists()
    with locked(tmp_path / "keep"):
        assert main(["accuracy", "--out", str(tmp_path), "--keep", str(tmp_path / "keep")]) == 1
    assert "writes here since" in capsys.readouterr().err


def test_a_page_is_its_template_with_its_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pages, "TEMPLATES", tmp_path)
    (tmp_path / "it.md").write_text("# Title\n\n{conclusion}\n\n{made}\n\nOf {count:g}:\n\n{rows}\n")
    rows = [*formatted([{"x [m]": 0.123, "who": "us"}], {"x [m]": ".2f"}), {"x [m]": "", "who": "them"}]
    said = write_page(tmp_path / "out", "it", ["a = 1", "b = 2"], flags=" --flag", count=2.0, rows=rows)
    assert said == "- a = 1\n- b = 2"
    text = (tmp_path / "out" / "it.md").read_text(encoding="utf-8")
    assert text.startswith("# Title\n\n- a = 1\n- b = 2\n\n`python -m validation.bench it --flag --out docs`, ")
    assert "Of 2:\n\n| x [m]   | who" in text
    assert "| 0.12 " in text
    with pytest.raises(ValueError, match="conclusion"):
        write_page(tmp_path, "it", ["one"] * 6, count=2.0, rows=rows)
    with pytest.raises(KeyError, match="count"):
        write_page(tmp_path, "it", ["one"])


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:masses:UserWarning")  # the MPM beside a network is coarse on purpose
@pytest.mark.parametrize(("name", "flags"), [("accuracy", ()), ("efficiency", ()), ("gns", ("--model", "flow2d"))])
def test_a_page_of_few_runs(name: str, flags: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(efficiency, "CUTS", ((1, 1),))
    monkeypatch.setattr(efficiency, "JITTERS", 2)
    monkeypatch.setattr(efficiency, "BAFFLE_JITTERS", 1)
    monkeypatch.setattr(accuracy, "REFERENCE", {2: 14.0})
    monkeypatch.setattr(accuracy, "TRIED", (0.2,))
    monkeypatch.setattr(bench_gns, "SCENES", {2: {"columns2d": 2}})
    monkeypatch.setattr(bench_gns, "CELLS", {2: (7, 10)})
    monkeypatch.setattr(bench_gns, "JITTERS", 1)
    assert main([name, "--out", str(tmp_path), *flags]) == 0
    assert (tmp_path / f"{name}.md").read_text().startswith("# ")
    assert list(tmp_path.rglob("*.png")) or name == "efficiency"


def test_a_spread_is_a_median_with_its_range() -> None:
    assert f"{Spread([1.0, 4.0, 2.0]):.1f}, {Spread([0.5]):.2f}" == "2.0 (1.0-4.0), 0.50"


def test_columns_have_the_particles_that_the_cases_state() -> None:
    assert [case.particles for case in CASES if case.dimension == 2] == [3200, 3200, 25088, 100352, 1002528]
    assert modes(CASES[0]) == [("f32", 1), ("f64", 1)]
    assert column(3, 32, 10).frames == 11


def test_the_large_terrain_has_about_a_million_particles() -> None:
    assert particle_count(slide()) == 1_013_760


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
