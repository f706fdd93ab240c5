"""Models on disk, whole or refused in a line; their cards: training ranges, and the quantities of a scene outside."""

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import save_file

from datasets import Baffle, Channel, Domain, Mass, Scene, Solid, read_scene
from datasets.definitions import FAMILIES, read_definition
from datasets.scene.grid_field import Field
from gns import card, checkpoint
from gns.card import Calibration
from gns.library import model_path, models, shipped
from gns.ranges import outside, quantities
from gns.settings import ModelSettings
from gns.simulator import Simulator
from tests.gns.conftest import NORMALISATION
from tests.refusals import refused

SCALED = ModelSettings(body_length=0.08**0.5, history=2, width=8, layers=1, rounds=1, grid_channels=4, grid_layers=1)
PROVENANCE = {"command": "python -m gns.train data/flow2d --out runs/a", "seed": 4, "log": {"updates": 3000}}


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model of another name than those that ship, with its card."""
    path = tmp_path_factory.mktemp("card") / "own.safetensors"
    torch.manual_seed(0)
    simulator = Simulator(SCALED, NORMALISATION)
    scenes = [entry.scene for entry in read_definition("flow2d").entries(seed=0, count=200)]
    card.write(path, card.describe(simulator, PROVENANCE, {"flow2d": scenes}))
    checkpoint.save(path, simulator, PROVENANCE)
    return path


def test_a_card_says_what_the_model_is(model: Path) -> None:
    model_card = card.read(model)
    first = checkpoint.load(model).simulator.network.encoder.mlp[0]
    assert sum(model_card.features.values()) == first.in_features
    assert model_card.settings == SCALED
    assert model_card.normalisation["friction_mean"] == pytest.approx(NORMALISATION.friction_mean)
    assert model_card.datasets["flow2d"].scenes == 200
    assert model_card.datasets["flow2d"].cells_across[1] == pytest.approx(56.6, abs=0.1)
    training = model_card.training
    assert (training.command, training.seed, training.updates) == (PROVENANCE["command"], 4, 3000)
    assert (model_card.scores, model_card.calibration(COLUMN)) == ("", None)
    # The ranges are those of the training scenes.
    assert set(model_card.ranges) < set(quantities(COLUMN))
    assert model_card.ranges["tension_cutoff"] == (0.5, 0.5)
    assert model_card.ranges["damping"][0] == 0.0
    assert model_card.ranges["baffles"] == (0.0, 3.0)
    # rho g l of 1800 kg/m^3 and 0.08 m^2; terrain holds some smaller bodies.
    assert model_card.ranges["young"][0] == pytest.approx(1.0e6 / (1800.0 * 9.81 * 0.08**0.5))
    assert all(low <= high for low, high in model_card.ranges.values())


COLUMN = read_scene("column-tall-42")
column = partial(replace, COLUMN)


def with_mass(**changes: Any) -> Scene:
    return column(masses=(replace(COLUMN.masses[0], **changes),))


def sand(**changes: Any) -> Scene:
    return column(material=replace(COLUMN.material, **changes))


def on(slope: float) -> Scene:
    """The column on a plateau above ground that falls by 0.2 m over `slope` metres."""
    points = ((0.0, 0.3), (0.25, 0.3), (0.25 + slope, 0.1), (2.0, 0.1))
    ground = Solid(kind="terrain", points=points, friction=0.4)
    mass = Mass(lower=(0.0, 0.3), size=(0.2, 0.4))
    return column(domain=Domain(size=(2.0, 1.0), cell=0.01), masses=(mass,), solids=(ground,))


OUTSIDE: dict[str, Callable[[], Scene]] = {
    "friction_deg": lambda: sand(friction_deg=62.0),
    "friction_limit_deg": lambda: sand(friction_limit_deg=50.0, grain_diameter=1e-3),
    "cohesion": lambda: sand(cohesion=5000.0, tension_cutoff=2500.0),
    "tension_cutoff": lambda: sand(tension_cutoff=None),
    "young": lambda: sand(young=2.0e5),
    "softening_length": lambda: sand(softening_length=0.01, residual_friction_deg=30.0),
    "dilation_deg": lambda: sand(dilation_deg=15.0),
    "k0": lambda: with_mass(k0=0.5),
    "barriers": lambda: with_mass(release=0.2),
    "volume_correction": lambda: column(volume_correction=True),
    "channel": lambda: column(channel=Channel(width=0.1, friction_deg=10.0)),
    "floor_friction": lambda: column(floor_friction=2.0),
    "damping": lambda: column(damping=0.7),
    "slope_deg": lambda: column(slope_deg=50.0),
    "ground_deg": lambda: on(0.05),
    "slope_length": lambda: column(slope_deg=20.0, domain=Domain(size=(4.0, 1.0), cell=0.01)),
    "masses": lambda: column(masses=tuple(Mass(lower=(0.0, 0.02 * row), size=(0.2, 0.02)) for row in range(20))),
    "mass_aspect": lambda: with_mass(size=(0.8, 0.05)),
    "drop": lambda: with_mass(lower=(0.0, 0.55)),
    "room_along": lambda: with_mass(size=(0.95, 0.4)),
    "speed": lambda: with_mass(velocity=(4.0, 0.0)),
    "spin": lambda: with_mass(angular_velocity=5.0),
    "baffles": lambda: column(baffles=tuple(Baffle(lower=(0.3 + 0.08 * i, 0.0), size=(0.02, 0.05)) for i in range(8))),
    "baffle_distance": lambda: column(
        domain=Domain(size=(3.0, 1.0), cell=0.01), baffles=(Baffle(lower=(2.0, 0.0), size=(0.1, 0.1)),)
    ),
    "duration": lambda: column(duration=3.0),
    "spacing": lambda: column(domain=Domain(size=(1.0, 1.0), cell=0.05)),
    "gravity": lambda: column(gravity=0.0),
}


@pytest.mark.parametrize("name", OUTSIDE)
def test_a_scene_outside_is_warned_of_in_a_line_that_names_the_quantity(name: str, model: Path) -> None:
    assert card.warning(shipped(OUTSIDE[name]()), OUTSIDE[name]()) is not None
    said = card.warning(model, OUTSIDE[name]())
    assert said.startswith("own.safetensors lies outside its training range: ")
    assert "\n" not in said
    reasons = said.split("range: ", 1)[1].split("; ")
    cause = next(reason for reason in reasons if reason.startswith(f"{name} "))
    assert re.search(r"\(none in the training data\)$|\(trained: .*, \S+ (above|below)\)$", cause)


def test_fields_and_the_floor_count_where_particles_have_them_or_touch_it(model: Path) -> None:
    def varied(quantity: str, *values: float) -> Scene:
        grid = {"origin": (0.0, 0.0), "spacing": (0.2, 0.4), "nodes": (2, 2)}
        return column(fields=(Field(quantity=quantity, values=values, **grid),))

    ranges = card.read(model).ranges
    low, *_ = outside(varied("friction_deg", 3.0, 3.0, 30.0, 30.0), ranges)
    assert re.match(r"friction_deg 3\.\d* deg \(trained: .* below\)", low)
    assert outside(varied("friction_deg", 30.0, 30.0, 40.0, 40.0), ranges) == outside(COLUMN, ranges)
    assert outside(varied("velocity_x", 30.0, 30.0, 30.0, 30.0), ranges)[0].startswith("speed ")
    assert quantities(varied("velocity_y", 1.0, 1.0, 1.0, 1.0))["upward_speed"].values
    # A terrain over all of the floor leaves nothing on it.
    assert not quantities(replace(on(0.5), floor_friction=2.0))["floor_friction"].values
    low_ground = replace(on(0.5).solids[0], points=((0.0, 0.3), (0.25, 0.3), (0.75, -0.1), (2.0, -0.1)))
    assert quantities(replace(on(0.5), solids=(low_ground,)))["floor_friction"].values == [COLUMN.floor_friction]


def test_a_quantity_outside_is_named_with_its_range_and_by_how_much(model: Path) -> None:
    ranges = {**card.read(model).ranges, "friction_deg": (12.0, 48.0), "damping": (0.12, 0.12)}
    scene = replace(sand(friction_deg=60.0), damping=0.0)
    assert outside(scene, ranges) == [
        "friction_deg 60 deg (trained: 12 to 48, 12 above)",
        "damping 0 (trained: 0.12, 0.12 below)",
    ]
    # A tenth of the width, that of ln tan(phi), is less towards sand without friction than towards rough sand.
    wide = ranges | {"friction_deg": (8.0, 52.0), "damping": (0.0, 0.12)}
    for angle, inside in ((6.0, False), (7.0, True), (57.0, True), (60.0, False)):
        assert (outside(sand(friction_deg=angle), wide) == []) is inside, angle
    # A tenth of the width is admitted, a shorter flow is a part of a longer one, stiffer sand is as good as rigid.
    near = replace(sand(friction_deg=51.0, young=1.0e8), duration=0.1)
    assert outside(near, ranges | {"damping": (0.0, 0.12)}) == []


def test_the_band_is_that_of_the_narrowest_dataset_that_holds_the_scene(model: Path) -> None:
    wide = card.read(model).datasets["flow2d"]
    narrow = replace(wide, ranges=wide.ranges | {"friction_deg": (40.0, 45.0)})
    bands = {key: Calibration(front={"0.95": q}, profile={"0.95": q}, flows=20) for key, q in (("a", 0.2), ("b", 0.1))}
    model_card = replace(card.read(model), datasets={"a": wide, "b": narrow}).keeping(bands)
    assert model_card.calibration(sand(friction_deg=42.0)) == bands["b"]
    assert model_card.calibration(sand(friction_deg=30.0)) == bands["a"]
    # Outside of all the widest: the warning is another matter.
    assert model_card.calibration(sand(friction_deg=70.0)) == bands["a"]
    lowest, highest = wide.ranges["friction_deg"]
    assert model_card.ranges["friction_deg"] == (min(lowest, 40.0), highest)


def test_a_model_without_a_card_says_so(tmp_path: Path) -> None:
    path = tmp_path / "new.safetensors"
    assert "has no card" in (card.warning(path, COLUMN) or "")
    for text in ('{"ranges": 3}', "3", "{"):
        card.card_path(path).write_text(text)
        refused(card.read, path, said="new.json")


@pytest.mark.parametrize("weights", models(), ids=lambda path: path.stem)
def test_every_model_that_ships_has_a_card(weights: Path) -> None:
    model_card = card.read(weights)
    assert set(model_card.ranges) <= set(quantities(COLUMN))
    assert model_card.training.updates
    assert all(data.calibration is not None for data in model_card.datasets.values())


@pytest.mark.parametrize("name", FAMILIES)
def test_scenes_of_a_definition_are_within_the_shipped_card(name: str) -> None:
    """Its distributions are those of the flows that the weights saw; a rare one reaches farther than all of these."""
    learned = "flow2d" if name.endswith("2d") else "terrain3d" if name in ("terrain3d", "cohesive3d") else "obstacle3d"
    ranges = card.read(model_path(learned)).ranges
    beyond = [outside(entry.scene, ranges) for entry in read_definition(name).entries(seed=1, count=100)]
    assert sum(map(bool, beyond)) <= 6


LAST = "network.decoder.mlp.2.weight"


@pytest.fixture
def file(lively: Simulator, tmp_path: Path) -> Path:
    path = tmp_path / "model.safetensors"
    checkpoint.save(path, lively, {"seed": 3, "datasets": ["a"], "score": math.nan})
    return path


def test_a_model_comes_back_without_flags(lively: Simulator, file: Path) -> None:
    model = checkpoint.load(file)
    assert model.simulator.settings == lively.settings
    assert model.provenance == {"seed": 3, "datasets": ["a"], "score": None}
    assert model.simulator.acceleration_scale.item() == pytest.approx(NORMALISATION.acceleration_scale)
    assert not model.simulator.training
    again, expected = model.simulator.state_dict(), lively.state_dict()
    assert again.keys() == expected.keys()
    assert all(torch.equal(again[name], expected[name]) for name in expected)


def test_missing_truncated_and_foreign_files_are_input_errors(file: Path, tmp_path: Path) -> None:
    whole = file.read_bytes()
    for content in (whole[: len(whole) // 2], whole[:10], b"", b"not a model"):
        file.write_bytes(content)
        refused(checkpoint.load, file, said="model.safetensors: expected whole weights")
    refused(checkpoint.load, tmp_path / "absent.safetensors", said="there is no such file")
    save_file({"weights": torch.zeros(1)}, file)
    refused(checkpoint.load, file, said="model.safetensors: format: expected a model of format")


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"width": 10**9}, "expected weights of a model of these settings.*size mismatch"),
        ({"rounds": 0}, "rounds: expected an integer of 1 to 100, got 0"),
        ({"layers": 9998}, "layers: expected an integer of 1 to 100, got 9998"),
        ({"radius": -1.0}, "radius: expected a positive number, got -1.0"),
        ({"rounds": 1, "layers": 1}, "expected weights of a model of these settings.*Unexpected key"),
        ({"widht": 8}, "widht: expected a known key, did you mean 'width'"),
        ({}, LAST + ": expected finite numbers"),
    ],
)
def test_each_fault_is_named_in_a_line(file: Path, changes: dict[str, Any], expected: str) -> None:
    tensors, metadata = checkpoint.read(file)
    settings = json.dumps(json.loads(metadata["settings"]) | changes)
    if not changes:
        tensors[LAST] *= math.nan
    save_file(tensors, file, {**metadata, "settings": settings})
    assert re.search(r"model\.safetensors: " + expected, str(refused(checkpoint.load, file)))


@pytest.mark.parametrize("text", ["", "3", "{", "[" * 10_000])
def test_metadata_that_is_no_table_is_refused(file: Path, text: str) -> None:
    tensors, metadata = checkpoint.read(file)
    for key in ("settings", "provenance"):
        save_file(tensors, file, {**metadata, key: text})
        assert "JSON" in str(refused(checkpoint.load, file, said=f"model.safetensors: {key}: expected"))
