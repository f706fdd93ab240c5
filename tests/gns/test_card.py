"""Cards: the training range of a surrogate, and the quantities of a scene outside of it."""

import dataclasses
import json
from pathlib import Path

import pytest

from datasets.errors import InputError
from datasets.library import SCENES, find, read_scene
from datasets.scene import Scene
from gns import card
from gns.inference import WEIGHTS, shipped


def scene(name: str = "column-tall-42") -> Scene:
    return read_scene(str(find(name, SCENES, "scene")))


@pytest.mark.parametrize("weights", sorted(WEIGHTS.glob("*.pt")), ids=lambda path: path.stem)
def test_every_model_that_ships_has_a_card(weights: Path) -> None:
    known = card.read(weights)
    assert known is not None
    assert set(known.ranges) <= set(card.QUANTITIES)
    assert all(low <= high for low, high in known.ranges.values())


def test_a_card_is_what_the_definitions_say() -> None:
    made = card.from_definitions({"flow2d": 40})
    whole = card.read(shipped(2))
    assert whole is not None
    assert made.ranges["damping"] == (0.12, 0.12)
    assert made.ranges["friction_deg"] == (15.0, 45.0)
    assert all(
        whole.ranges[name][0] <= low and high <= whole.ranges[name][1] for name, (low, high) in made.ranges.items()
    )
    with pytest.raises(InputError, match="flow2d"):
        card.from_definitions({"flow3d": 3})


@pytest.mark.parametrize("name", ["column-tall-42", "column-short-21", "layers-10", "baffles-2", "baffles-3"])
def test_the_scenes_of_the_paper_are_within(name: str) -> None:
    assert card.warning(shipped(scene(name).dimension), scene(name)) is None


def test_a_wider_box_than_any_in_the_training_data_is_outside() -> None:
    said = card.warning(shipped(3), scene("baffles-5"))
    assert said is not None
    assert "box_width 1.8125 (trained: 1) m" in said


def test_a_quantity_outside_is_named_with_its_range() -> None:
    dry = dataclasses.replace(scene(), damping=0.0)
    assert card.warning(shipped(2), dry) == "flow2d.pt is outside of its training range: damping 0 (trained: 0.12)"
    stiff = dataclasses.replace(scene(), material=dataclasses.replace(scene().material, young=2e7, friction_deg=60.0))
    known = card.read(shipped(2))
    assert known is not None
    assert known.outside(stiff) == ["friction_deg 60 (trained: 15 to 45) deg", "young 2e+07 (trained: 2e+06) Pa"]
    shorter = dataclasses.replace(scene(), duration=0.5)
    assert known.outside(shorter) == []
    held = dataclasses.replace(scene(), masses=(dataclasses.replace(scene().masses[0], k0=0.5),))
    assert known.outside(held) == [card.UNSUPPORTED]


def test_a_model_without_a_card_or_of_a_short_training_says_so(tmp_path: Path) -> None:
    assert "has no card" in (card.warning(tmp_path / "own.pt", scene()) or "")
    whole = json.loads(card.card_path(shipped(2)).read_text())
    # A short training is named, under the quantities' old names too.
    old = {key.replace("mass_", "body_"): value for key, value in whole["ranges"].items()}
    (tmp_path / "own.json").write_text(json.dumps({**whole, "ranges": old, "updates": 300}))
    assert card.warning(tmp_path / "own.pt", scene()) == (
        "own.pt: 300 updates in all, 2.5 % of those of flow2d.pt (12002): "
        "far too short, no answer should rest on this model"
    )
    (tmp_path / "own.json").write_text('{"ranges": 3}')
    with pytest.raises(InputError, match=r"own\.json"):
        card.read(tmp_path / "own.pt")
