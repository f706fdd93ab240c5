"""The dispatcher: names, flags of a page, one line for a wrong name; the writer of pages; the page of speeds."""

import inspect
import shutil
from pathlib import Path

import numpy as np
import pytest

from datasets.lock import locked
from datasets.particles import particle_count
from tests.commands import DOCS
from validation.bench import __main__, efficiency
from validation.bench.__main__ import BENCHES, bench_of, main
from validation.bench.large import CELL, QUICK, Found, friction, slide
from validation.bench.speed import CASES, Price, column, draw, enlarged, mean_x, modes, page
from validation.report.measuring import Spread
from validation.report.page import Page

FROZEN = Path(__main__.__file__).parent / "frozen"
"""Sections that no command measures any more."""


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


def test_a_page_begins_with_its_conclusion(tmp_path: Path) -> None:
    page = Page("Title", "it --flag", ["a = 1", "b = 2"], quick=True)
    page.section("Section")
    page.text("""
        One line
        and another.
    """)
    page.table([{"x [m]": "0.12", "who": "us"}, {"x [m]": "", "who": "them"}])
    assert page.write(tmp_path / "page.md") == "- a = 1\n- b = 2"
    text = (tmp_path / "page.md").read_text(encoding="utf-8")
    assert text.startswith("# Title\n\n- a = 1\n- b = 2\n\n`python -m validation.bench it --flag`")
    assert "`--quick`" in text
    assert "## Section\n\nOne line\nand another.\n\n| x [m]   | who" in text
    assert "| 0.12 " in text
    with pytest.raises(ValueError, match="conclusion"):
        Page("Title", "it", ["one"] * 6, quick=False)


@pytest.mark.parametrize("frozen", sorted(FROZEN.glob("*.md")), ids=lambda path: path.stem)
def test_a_page_ends_with_what_was_measured_once(frozen: Path) -> None:
    assert (DOCS / frozen.name).read_text(encoding="utf-8").endswith(frozen.read_text(encoding="utf-8"))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:masses:UserWarning")  # the MPM beside a network is coarse on purpose
@pytest.mark.parametrize(("name", "flags"), [("accuracy", ()), ("efficiency", ()), ("gns", ("--model", "flow2d"))])
def test_a_quick_page(name: str, flags: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(efficiency, "JITTERS", 2)
    assert main([name, "--quick", "--out", str(tmp_path), *flags]) == 0
    assert "--quick" in (tmp_path / f"{name}.md").read_text()
    assert list(tmp_path.rglob("*.png"))


RATES = {
    (case, mode): Spread([10.0 * rank, 12.0 * rank])
    for rank, case in enumerate(CASES, start=1)
    for mode in (("f32", 2), ("f64", 2))
}
PRICES = [
    Price(particles=3200, steps=4400, run=1.0, gradient=5.0, memory=2**20),
    Price(particles=12800, steps=4400, run=4.0, gradient=22.0, memory=2**24),
]


RUN = {"particles": 1_000_000, "steps": 1000, "seconds": 100.0, "memory": 2e9, "disk": 1e8, "before": 10.0}
TERRAIN: dict[str, Found] = {
    "coarse": {"particles": 125_000, "memory": 2e9 - 8.75e8},
    "flow": {**RUN, "cell": 0.5, "nodes": "9 x 9 x 9", "most": 2e7, "front": 61.0, "remarks": ["not at rest"]},
    "maps": {"seconds": 20.0, "frames": 17, "memory": 6e8, "disk": 1e6, "thickness_max": 5.2},
    "friction": {"runs": [11, 7], "seconds": [50.0, 650.0], "memory": 2e9, "disk": 2e8, "found": 0.39}
    | {"half_width": 0.02, "coarse_found": 0.38, "verdict": "confirmed"},
}


def test_the_page_says_what_was_measured(tmp_path: Path) -> None:
    networks = [{"model": "`flow2d`", "nodes": "500", "µs per node": "148"}]
    starts = {"2D column": (8.0, 3.0), "3D column": (20.0, 4.0), "3D baffles": (41.0, 5.0)}
    text = page(RATES, [], starts, PRICES, networks, TERRAIN, rounds=1, quick=False)
    assert "takes 8 s of CPU in 2D and 20 to 41 s of CPU in 3D until" in " ".join(str(text).split())
    assert "| 3D baffles |" in str(text)
    assert "In 2D the MPM makes 22 to 55 million particle-steps a second, at 3,200 to " in text.conclusion
    assert "5.0 to 5.5 runs, for any number of unknowns, and at most 16 MiB (12,800" in text.conclusion
    assert "takes 148 µs for each node" in text.conclusion
    assert "takes 130 s from raster to maps, and 700 s for the friction of its bed by 7 such runs." in text.conclusion
    assert "GeoTaichi" in str(text)
    assert "| maps of 17 frames " in str(text)
    # 1,000 bytes each; the third root of a hundred times as many steps.
    assert "take 94.1 GiB of memory, 1000 bytes for each more\nparticle with" in str(text)
    assert "its cells; 4,642 steps in 13 hours" in str(text)
    assert "It is not at rest." in str(text)
    draw(tmp_path / "speed.png", RATES, PRICES)
    assert (tmp_path / "speed.png").stat().st_size > 10_000


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
