"""The page on contact with solids."""

from pathlib import Path

import pytest

from validation.bench.contact import bench as contact


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:no initial stress:UserWarning")
def test_the_page_has_its_tables_and_a_conclusion_from_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contact, "PLATES", ((0.5, 20.0),))
    monkeypatch.setattr(contact, "slopes_of_toe", lambda shifts: [-0.5 for _ in shifts])
    contact.bench(tmp_path, quick=True)
    text = (tmp_path / "contact.md").read_text()
    assert "| 0.5 | 20 | 0 | 400 |" in text
    assert "**Leaks**: 0 particles" in text
    assert "-0.50 to -0.50 by differences of 2 to 2 mm" in text
    assert text.count("| terrain, 2D |") == 1
