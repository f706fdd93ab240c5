"""The page on contact with solids: from made-up figures, and of simulations."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from validation.bench.contact import bench as contact


def cells_of(text: str) -> list[list[str]]:
    """The rows of all tables of a page."""
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]


def test_the_conclusion_follows_the_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made_up = {
        "layer_error": lambda kind, dimension, *_: contact.LayerError(
            surface=f"{kind}, {dimension}D", height=-0.002, gain=3e-5, force=0.01 if kind == "floor" else -0.004
        ),
        "acceleration": lambda slope_deg, _: 1.01 * contact.block_acceleration(slope_deg),
        "incline_extents": lambda *_: np.array([[1.0, 1.02], [1.0, 0.99]]),
        "simulate": lambda _: SimpleNamespace(positions=np.zeros((1, 400, 2))),
        "particles_beyond": lambda _: 1,
        "particles_inside": lambda _: 2,
        "thrust": lambda _: 370.0,
        "toe_slopes": lambda shifts: [-0.5 - shift for shift in shifts],
        "roughness": lambda *_: (0.125, 0.25),
        "run_flume": lambda: SimpleNamespace(front=2.5, peak=(400.0, 1.25), balance=1e-8),
        "draw": lambda *_: None,
    }
    for name, value in made_up.items():
        monkeypatch.setattr(contact, name, value)
    conclusion = contact.bench(tmp_path, quick=False, keep=tmp_path)
    assert (
        "by 0.002 cells at most, gain 3.0e-05 of their energy, and press with their weight within 0.4 %" in conclusion
    )
    assert "within 1 % of the closed form" in conclusion
    assert (
        "95 % of the sand come as far as down the floor of a tilted box within 1 %, the front within 2 %" in conclusion
    )
    assert "**Leaks**: 8 particles" in conclusion
    assert "within 0.12 mm of a parabola (cells of 20 mm; standard error over jitters 0.25 mm)" in conclusion
    assert "-0.52 to -0.50 by differences of 20 to 0.02 mm" in conclusion
    text = (tmp_path / "contact.md").read_text()
    assert conclusion in text
    rows = cells_of(text)
    assert ["0.5", "50", "1", "400"] in rows
    assert ["floor, 2D", "-0.0020", "3.0e-05", "+1.00%"] in rows


@pytest.mark.slow
def test_the_quick_bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contact, "PLATES", ((0.5, 20.0),))
    monkeypatch.setattr(contact, "toe_slopes", lambda shifts: [-0.5 for _ in shifts])
    assert "**Leaks**: 0 particles" in contact.bench(tmp_path, quick=True, keep=tmp_path)
    assert ["0.5", "20", "0", "400"] in cells_of((tmp_path / "contact.md").read_text())
    assert (tmp_path / "contact-flume.png").stat().st_size > 10_000
