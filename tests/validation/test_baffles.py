"""The report on contact with baffles."""

from pathlib import Path

import numpy as np
import pytest

from datasets.command_line import run
from validation import baffles


def test_the_report_has_both_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(baffles, "OFFSETS", np.array([0.0, 0.5, 1.0, 1.5]))
    monkeypatch.setattr(baffles, "PHASES", (0.0,))
    assert run(baffles.command, "validation.baffles", ["--out", str(tmp_path), "--seeds", "2"]) == 0
    text = (tmp_path / "baffles.md").read_text()
    assert "| 1.5 |" in text
    assert "The centre lies" in text
    assert text.count("| 0 |") == 1
