"""The page on contact with solids."""

from pathlib import Path

import pytest

from validation.bench.contact import bench as contact


@pytest.mark.slow
def test_the_page_has_its_tables_and_a_conclusion_from_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contact, "PLATES", ((0.5, 20.0),))
    monkeypatch.setattr(contact, "toe_slopes", lambda shifts: [-0.5 for _ in shifts])
    conclusion = contact.bench(tmp_path, quick=True, keep=tmp_path)
    text = (tmp_path / "contact.md").read_text()
    assert "**Leaks**: 0 particles" in conclusion
    assert conclusion in text
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()]
    assert ["0.5", "20", "0", "400"] in cells
    assert "-0.50 to -0.50 by differences of 2 to 2 mm" in text
    assert sum(row[:1] == ["terrain, 2D"] for row in cells) == 1
    assert (tmp_path / "contact-flume.png").stat().st_size > 10_000
