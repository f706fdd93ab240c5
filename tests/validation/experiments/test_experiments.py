"""Every experiment that ships is complete and can be run; a wrong one is refused by name."""

import dataclasses
import math
from pathlib import Path

import pytest

from datasets.errors import InputError
from datasets.particles import particle_count
from validation.experiments.experiment import (
    Angle,
    Assumption,
    Experiment,
    Measured,
    MeasuredScene,
    Quantity,
    Shipped,
    Status,
    read_experiment,
    read_experiments,
)

SHIPPED = read_experiments()
PLAUSIBLE_DEG = 25.0


@pytest.mark.parametrize("shipped", SHIPPED, ids=lambda each: each.name)
def test_scenes_are_undamped_and_hold_what_was_measured(shipped: Shipped) -> None:
    files = [(case.scene, case) for case in shipped.experiment.cases]
    for file, case in files:
        coarse, fine = shipped.cells(case)
        assert fine < coarse
        for cell in (coarse, fine):
            scene = shipped.scene(file, cell, PLAUSIBLE_DEG)
            assert scene.damping == 0.0
            assert scene.material.friction_deg == PLAUSIBLE_DEG
            assert scene.material.cohesion == 0.0
            assert scene.floor_friction == pytest.approx(math.tan(math.radians(PLAUSIBLE_DEG)))
            assert 500 < particle_count(scene) < 60_000
        for measured in case.measured:
            # The box must not be what stops the flow.
            if measured.quantity in (Quantity.FRONT, Quantity.RADIUS):
                assert measured.value + 3.0 * measured.spread < scene.domain.size[0]


def changed(shelf: Path, old: str, new: str) -> Path:
    """The experiment of the shelf with a text of its file replaced."""
    path = shelf / "wedge" / "experiment.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    return path.parent


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ('licence = "MIT"', "", "licence"),
        ('licence = "MIT"', 'license = "MIT"', "license"),
        ("spread = 0.005", "", "spread"),
        ("spread = 0.005", "spread = 0.0", "spread"),
        ('status = "read"', 'status = "recalled"', "status"),
        ("lower_deg = 24.5", "lower_deg = 34.5", "lower_deg"),
        ('quantity = "front"', 'quantity = "height"', "within"),
        ('floor = "material"', 'floor = "rough"', "floor"),
        ("value = 0.52", "value = -0.52", "value"),
    ],
)
def test_a_wrong_experiment_is_refused_by_file_and_key(shelf: Path, old: str, new: str, key: str) -> None:
    folder = changed(shelf, old, new)
    with pytest.raises(InputError) as caught:
        read_experiment(folder)
    assert caught.value.where == str(folder / "experiment.toml")
    assert key in caught.value.key


def test_the_page_on_formats_names_every_key() -> None:
    page = (Path(__file__).parents[3] / "docs" / "formats.md").read_text(encoding="utf-8")
    section = page.split("\n## A measured experiment (TOML)\n")[1].split("\n## ")[0]
    for kind in (Experiment, Angle, MeasuredScene, Measured, Assumption):
        for each in dataclasses.fields(kind):
            assert f"`{each.name}`" in section or f"[{each.name}]" in section or f".{each.name}]" in section, each.name
    for status in Status:
        assert status in section.replace("\n", " ")
    for quantity in Quantity:
        assert f"`{quantity}`" in section
