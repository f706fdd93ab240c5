"""Other codes' fronts as data, and a page that follows the numbers."""

import dataclasses
from pathlib import Path

import pytest

from mpm import AT_REST
from validation.bench.columns.codes import ASPECTS, SEEDS, Front, Fronts, our_runs, read_codes, write


def fronts(factors: dict[str, float]) -> list[Front]:
    """Fronts on the laws of Lube et al., times a factor by code and transfer."""
    return [
        Front(
            code=name.split()[0],
            transfer=name.split()[1],
            aspect=aspect,
            cells=cells,
            seed=0,
            front=factor * (1.2 * aspect if aspect <= 2.0 else 1.9 * aspect**0.6667),
            runout=2.0 * aspect,
            height=1.0,
        )
        for name, factor in factors.items()
        for cells in (16, 32)
        for aspect in ASPECTS
    ]


def test_the_other_codes_ran_on_our_grids() -> None:
    others = read_codes()
    ours = {(aspect, cells) for _, aspect, cells, *_ in our_runs(ASPECTS, SEEDS)}
    assert {each.code for each in others.fronts} == {code.name for code in others.codes}
    assert {(each.aspect, each.cells) for each in others.fronts} <= ours
    assert all(each.runout > each.front > 0.0 for each in others.fronts)
    keys = [(each.name, each.aspect, each.cells, each.seed) for each in others.fronts]
    assert len(keys) == len(set(keys))


def test_our_transfers_differ_in_the_relaxation_time_alone() -> None:
    default, apic = (run for *_, run in our_runs((1.0,), {16: 1}))
    assert default.scene.relaxation_time is None
    assert apic.scene.relaxation_time == 0.0
    assert dataclasses.replace(apic.scene, relaxation_time=None) == default.scene
    assert default.record == apic.record == AT_REST


def test_differences_are_computed(tmp_path: Path) -> None:
    some = fronts({"Talus AFLIP": 1.1, "Talus APIC": 1.0, "Matter APIC": 0.98})
    text = write(tmp_path, Fronts(fronts=some), read_codes().codes)
    assert "Talus APIC's fronts differ from Matter APIC's by 2 % rms over 10 columns, by +2.0 % at most" in text
    assert "against our APIC on 32 cells: +10.0 % at 0.5, +10.0 % at 1" in text
    assert "- Against Lube et al. 2005, channel (32 cells): +10.0 % to +10.0 % from 1.2 a^1, +10.0 %" in text
    page = " ".join((tmp_path / "codes.md").read_text().split())
    assert "| Matter APIC | 0.59 (-10.9 %) |" in page
    assert "Talus APIC, 16 cells | 1.00 | 0.83 |" in page
    for code in read_codes().codes:
        assert code.commit[:10] in page


def test_a_code_without_a_column_is_a_gap(tmp_path: Path) -> None:
    every = fronts({"Talus AFLIP": 1.0, "Talus APIC": 1.0, "Matter APIC": 1.0})
    some = Fronts(fronts=[each for each in every if not (each.code == "Matter" and each.aspect == 8.0)])
    write(tmp_path, some, read_codes().codes)
    page = (tmp_path / "codes.md").read_text()
    line = next(line for line in page.splitlines() if line.startswith("| Matter APIC "))
    assert line.split("|")[-2].strip() == "-"
    assert (tmp_path / "codes.png").stat().st_size > 10_000
    assert some.mean("Matter APIC", 16, 1.0) == pytest.approx(1.2)
