"""Other codes' fronts as data, and a page whose words follow the numbers."""

import dataclasses
from pathlib import Path

import pytest

from validation.bench.columns import codes_page as peers_report
from validation.bench.columns.codes import ASPECTS, SEEDS, our_runs
from validation.bench.columns.fronts import Front, read_peers
from validation.bench.columns.scaling_laws import read_laws

LAWS = [law for law in read_laws() if law.dimension == 2 and law.quantity == "runout"]


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


def test_the_other_codes_stand_on_our_grids() -> None:
    peers = read_peers()
    ours = {(what.aspect, what.cells) for what in our_runs(ASPECTS, SEEDS)}
    assert {each.code for each in peers.fronts} == {code.name for code in peers.codes}
    assert {(each.aspect, each.cells) for each in peers.fronts} <= ours
    assert all(each.runout > each.front > 0.0 for each in peers.fronts)
    keys = [(each.name, each.aspect, each.cells, each.seed) for each in peers.fronts]
    assert len(keys) == len(set(keys))


def test_our_transfers_differ_in_nothing_but_the_relaxation_time() -> None:
    runs = our_runs((1.0,), {16: 1})
    (default, apic) = (run.scene for run in runs.values())
    assert default.relaxation_time is None
    assert apic.relaxation_time == 0.0
    assert dataclasses.replace(apic, relaxation_time=None) == default
    assert all(run.record.until_rest for run in runs.values())


def test_differences_are_computed() -> None:
    some = fronts({"Talus AFLIP": 1.1, "Talus APIC": 1.0, "Matter APIC": 0.98})
    text = peers_report.text(some, read_peers().codes, LAWS)
    assert "Talus APIC's fronts differ from Matter APIC's by 2 % rms over 10 columns, by +2.0 % at most" in text
    assert "against our APIC on 32 cells: +10.0 % at 0.5, +10.0 % at 1" in text
    assert "- Against Lube et al. 2005, channel, 1.2 a^1: +10.0 % to +10.0 % (32 cells)." in text
    assert "| Matter APIC | 0.59 (-10.9 %) |" in text
    assert "Talus APIC, 16 cells | 1.00 | 0.83 |" in text
    for code in read_peers().codes:
        assert code.commit[:10] in text


def test_a_code_without_a_column_is_a_gap(tmp_path: Path) -> None:
    every = fronts({"Talus AFLIP": 1.0, "Talus APIC": 1.0, "Matter APIC": 1.0})
    some = [each for each in every if not (each.code == "Matter" and each.aspect == 8.0)]
    text = peers_report.text(some, read_peers().codes, LAWS)
    line = next(line for line in text.splitlines() if line.startswith("| Matter APIC |"))
    assert line.endswith("| - |")
    peers_report.draw(tmp_path / "peers.png", some, LAWS)
    assert (tmp_path / "peers.png").stat().st_size > 10_000
    assert peers_report.of(some, "Matter APIC", 16, 1.0) == pytest.approx(1.2)
