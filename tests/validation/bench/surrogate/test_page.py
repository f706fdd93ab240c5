"""`python -m validation.bench surrogate` on flows with a formula: prices, gradients, bands, the page."""

import dataclasses
import math
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from datasets.definitions.definition import Definition, Split, Storage
from datasets.errors import InputError
from datasets.scene import Baffle, Domain, Mass, Scene
from datasets.trajectory import Trajectory
from gns.model import checkpoint
from gns.model.settings import ModelSettings
from gns.model.simulator import Normalisation, Simulator
from inverse.forward.gns import GnsForward
from inverse.observations import build
from mpm.output.request import ALL, Recording
from tests.validation.bench.surrogate.flows import BLOCK, sliding
from validation.bench.efficiency.gradients import blocks_problem
from validation.bench.surrogate import accuracy, bench, calibration, friction, held_out, pictures, price, velocities
from validation.bench.surrogate.accuracy import Accuracy
from validation.bench.surrogate.calibration import Band, Coverage, Warnings
from validation.bench.surrogate.friction import Strengths
from validation.bench.surrogate.held_out import Family, HeldOut, References
from validation.bench.surrogate.models import Model, RolloutTask, load
from validation.bench.surrogate.outside import out_of_range
from validation.bench.surrogate.page import Found, page
from validation.bench.surrogate.price import Point, Prices, mpm_error, mpm_seconds, said
from validation.bench.surrogate.rest import LongRollout, Rest, longer, second_half, settled
from validation.bench.surrogate.scores import Deposit, Score, compare
from validation.bench.surrogate.velocities import Compared, Gradients, Slope
from validation.report import plots


def prices(seconds: float, error: float) -> Prices:
    """An MPM whose error falls from 8 to 1 % as it costs ten times as much three times, beside a model."""
    mpm = {
        cells: Point(seconds=0.01 * 10.0**index, error=0.08 / 2.0**index) for index, cells in enumerate((7, 14, 28, 56))
    }
    return Prices(scenes=3, mpm=mpm, models={"tiny": Point(seconds=seconds, error=error)})


def test_where_a_model_lies_beside_the_curve_of_the_mpm() -> None:
    found = prices(0.1, 0.015)
    assert mpm_error(found, 0.1) == pytest.approx(0.04)
    assert mpm_error(found, 10.0**-1.5) == pytest.approx(0.04 * 2**0.5)
    assert mpm_seconds(found, 0.01) == pytest.approx(10.0)
    assert mpm_seconds(found, 0.02 / 2**0.5) == pytest.approx(10.0**0.5)
    assert mpm_seconds(found, 0.005) is None
    assert mpm_error(found, 0.001) is None
    assert "has 1.5% for 0.1 s, where the MPM has 4.0%; so small an error has the MPM only from 2.6 s on" in said(
        "tiny", found
    )
    above = said("tiny", prices(1.0, 0.04))
    assert "above the MPM's curve, which has 2.0% at that price and the same error for 0.1 s" in above
    assert "no run of the MPM" in said("tiny", prices(1.0, 0.001))
    assert "below the price of any run of the MPM (8.0% for 0.01 s)" in said("tiny", prices(0.001, 0.1))
    # A dearer run that is no better does not raise the curve.
    worse = dataclasses.replace(found, mpm={**found.mpm, 100: Point(seconds=100.0, error=0.05)})
    assert mpm_error(worse, 100.0) == pytest.approx(0.01)


@pytest.mark.parametrize("dimension", [2, 3])
def test_coarser_runs_are_as_coarse_as_they_say(dimension: int) -> None:
    # A height of 19 fine cells, a prime: no coarser one fits into it.
    size = (0.96, 0.38, 0.48)[:dimension]
    scene = dataclasses.replace(
        BLOCK,
        domain=Domain(size=size, cell=0.02),
        masses=(Mass(lower=(0.0,) * dimension, size=(0.24, 0.2, 0.24)[:dimension]),),
    )
    found = [price.coarse(scene, cells) for cells in (3, 5, 10)]
    coarsest, *others = (0.2 / each.domain.cell for each in found)
    assert 3.0 <= coarsest < 3.4
    assert others == pytest.approx([5.0, 10.0])
    for each in found:
        assert each.domain.size[::2] == scene.domain.size[::2]
        assert 0.0 <= each.domain.size[1] - 0.38 < each.domain.cell
        assert each.masses == scene.masses


def test_gradients_beside_the_mean_over_seeds() -> None:
    slopes = [np.array([1.0, 0.1]), np.array([1.0, -0.1])]
    rows = {
        "tiny": Slope(seconds=0.3, values=(2.0, 0.0)),
        "MPM, 5 cells across": Slope(seconds=0.1, values=(1.0, 1.0)),
    }
    found = velocities.gradients(2, slopes, rows, ["tiny"], 56)
    (own,), (coarse,) = found.models, found.mpm
    assert (own.cosine, own.length) == pytest.approx((1.0, 2.0))
    assert (coarse.cosine, coarse.length) == pytest.approx((0.5**0.5, 2.0**0.5))
    assert found.own == pytest.approx(0.99 / 1.01)


def test_problems_of_one_flow_on_other_cells() -> None:
    fine, coarse = velocities.problem_on(1, 10, 28, pair=1), velocities.problem_on(1, 10, 7)
    assert (fine.scene.domain.cell, coarse.scene.domain.cell) == pytest.approx((0.01, 0.04))
    assert (fine.scene.seed, fine.target.seed, coarse.scene.seed, coarse.target.seed) == (2, 3, 0, 1)
    assert fine.scene.masses == coarse.scene.masses
    assert len(fine.parameters) == 10


def spreading(scenes: Sequence[Scene], *, record: Recording = ALL) -> list[Trajectory]:
    """A block that is stretched along x by 2 less tan(phi)."""
    flows = []
    for scene in scenes:
        flow = sliding(scene, 0.0)
        factor = np.float32([2.0 - math.tan(math.radians(scene.material.friction_deg)), 1.0])
        flows.append(dataclasses.replace(flow, positions=flow.positions[-1:] * factor, time=flow.time[-1:]))
    return flows


@pytest.fixture
def tiny(tmp_path: Path) -> Model:
    """A model on disk whose output is small noise."""
    torch.manual_seed(0)
    settings = ModelSettings(
        width=8, layers=2, rounds=1, grid_channels=4, grid_layers=1, frames_per_step=1, frame_dt=0.02, rest_speed=0.0
    )
    normalisation = Normalisation(displacement=3e-3, acceleration=7e-4, friction_mean=0.6, friction_std=0.2)
    simulator = Simulator(settings, normalisation)
    with torch.no_grad():
        simulator.network.decoder.mlp[-1].weight.normal_(std=0.3)
    path = tmp_path / "tiny.safetensors"
    provenance = {"log": {"updates": 3000}, "seed": 7, "datasets": ["none: 0"]}
    checkpoint.save(path, simulator, provenance)
    (model,) = load([path])
    return model


def test_strength_of_the_answer_to_friction(tiny: Model) -> None:
    column = HeldOut(kind="column", number=1, scene=BLOCK)
    problem = friction.problem_of(column, "front")
    slope = friction.answer(problem, spreading, seeds=2)
    front = sliding(BLOCK, 0.0).positions[-1, :, 0].max()
    assert slope[0] == pytest.approx(-front * math.radians(1.0) / math.cos(math.radians(30.0)) ** 2, rel=0.02)
    profile = friction.problem_of(column, "profile")
    reference = friction.answer(profile, spreading)
    assert len(reference) == 21
    # The model's strength is its derivative along the reference, here also by differences.
    own = friction.model_strength(profile, tiny, reference)
    double = dataclasses.replace(tiny, simulator=tiny.simulator.double())
    forward = GnsForward(double.simulator, profile, build(profile.observation, BLOCK))
    ahead, behind = forward.observe([profile.initial + 0.01, profile.initial - 0.01])
    assert own == pytest.approx((ahead - behind) / 0.02 @ reference / (reference @ reference), rel=0.02)
    assert friction.within([Strengths(front=1.05, profile=1.2, seconds=1.0)], "front") == 1
    assert friction.within([Strengths(front=1.05, profile=1.2, seconds=1.0)], "profile") == 0


def test_a_creeping_deposit_and_one_in_a_baffle() -> None:
    still = second_half(sliding(longer(BLOCK), 0.0))
    assert still == LongRollout(creep=0.0, transport=0.0, contained=True)
    creeping = second_half(sliding(longer(BLOCK), -0.003))
    assert creeping.creep == pytest.approx(-3.0, rel=1e-2)
    assert creeping.transport == pytest.approx(3.0, rel=1e-2)
    assert creeping.contained
    blocked = dataclasses.replace(BLOCK, baffles=(Baffle(lower=(0.25, 0.0), size=(0.1, 0.1)),))
    assert not second_half(sliding(blocked, 0.6)).contained


def with_front(error: float, number: int, *, at_wall: bool = False) -> tuple[HeldOut, Score]:
    """A scene and its score."""
    score = compare(sliding(BLOCK, 1.0), sliding(BLOCK, 1.0), 0.005)
    changed = dataclasses.replace(score, deposit=Deposit(front=error, transport=0.01), at_wall=at_wall)
    return HeldOut(kind="column", number=number, scene=dataclasses.replace(BLOCK, seed=number)), changed


def accurate(*pairs: tuple[HeldOut, Score]) -> Accuracy:
    """Scores of a model called tiny."""
    return Accuracy(
        scenes=[scene for scene, _ in pairs],
        scores={"tiny": [score for _, score in pairs]},
        finer=[Deposit(front=-0.004, transport=0.003)],
        jitter=[Deposit(front=0.002, transport=0.001)],
    )


def test_every_scene_by_every_model_once(tiny: Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(held_out, "simulate_many", lambda them, **_: [sliding(each, 0.5) for each in them])
    references = References(tmp_path, Storage(cell=0.01, kept=1))
    scenes = [HeldOut(kind="block", number=seed, scene=dataclasses.replace(BLOCK, seed=seed)) for seed in (1, 2)]
    tasks: list[RolloutTask] = []

    def rolled(_: object, some: Sequence[RolloutTask]) -> list[Trajectory]:
        tasks.extend(some)
        return [sliding(task.scene, 0.5) for task in some]

    found = accuracy.measure(scenes, [tiny], references, tmp_path, rolled)
    again = accuracy.measure(scenes, [tiny], references, tmp_path, rolled)
    assert [task.scene for task in tasks] == [each.scene for each in scenes]
    assert again == found
    assert [score.deposit.error < 0.05 for score in found["tiny"]] == [True, True]
    assert accuracy.spread_over_kinds(scenes, 1) == scenes[:1]
    assert settled(scenes, references, 2) == []


def test_bands_hold_a_share_of_the_free_fronts(tiny: Model, tmp_path: Path) -> None:
    found = accurate(with_front(0.0, 1), with_front(0.0, 2), with_front(0.0, 3, at_wall=True))
    front = found.scores["tiny"][0].front
    bands = {1: Band(low=front - 0.01, high=front + 0.01), 2: Band(low=front + 0.01, high=front + 0.03)}
    held = calibration.coverages(found, [tiny], tmp_path, lambda scene, _: bands[scene.seed])["tiny"]
    assert isinstance(held, Coverage)
    assert (held.fronts, held.inside, held.share) == (2, 1, 0.5)
    assert held.width == pytest.approx(0.01 / found.scores["tiny"][0].extent)

    def unknown(scene: Scene, _: Path) -> Band:
        raise InputError("no members")

    assert calibration.coverages(found, [tiny], tmp_path / "other", unknown) == {"tiny": "no members"}
    assert calibration.coverages(found, [tiny], tmp_path, None) == {}


def test_scenes_out_of_range_are_twenty_and_warnings_are_counted(tiny: Model) -> None:
    scenes = out_of_range(tiny.settings)
    assert len({each.to_json() for each in scenes.values()}) == 20
    inside = [HeldOut(kind="column", number=number, scene=BLOCK) for number in range(50)]
    # Without a card a model warns of everything.
    found = calibration.warnings(tiny, inside)
    assert (found.missed, len(found.outside)) == ([], 20)
    assert len(found.false) == len(found.inside) == calibration.IN_RANGE
    quiet = Warnings(outside={"a": True, "b": False}, inside={"c": None})
    assert (quiet.missed, quiet.false) == (["b"], [])


def test_the_page_has_its_conclusion_from_the_numbers(
    tiny: Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scores = accurate(with_front(0.005, 1), with_front(-0.06, 2), with_front(0.0, 3, at_wall=True))
    column = scores.scenes[0]
    row = Compared(method="tiny", seconds=0.3, cosine=0.95, length=0.9)
    found = Found(
        models=[tiny],
        accuracy={2: scores},
        prices={2: prices(0.1, 0.015)},
        gradients=[Gradients(unknowns=10, compared=10, cells=56, own=0.999, models=[row], mpm=[])],
        friction={"tiny": [Strengths(front=0.95, profile=0.8, seconds=0.5)]},
        rest={
            2: Rest(scenes=[column], rollouts={"tiny": [LongRollout(creep=-0.2, transport=0.1, contained=True)]}),
        },
        coverages={"tiny": Coverage(fronts=100, inside=96, width=0.02)},
        warnings={"tiny": Warnings(outside={"steep": False, "soft": True}, inside={"column 1": None})},
    )
    text = str(page(found, quick=False))
    sentences = [line for line in text.splitlines() if line.startswith("- ")][:5]
    assert "`tiny` 3.2% on average, worst -6.0 % of 2, profile 1.0%." in sentences[0]
    assert "the MPM only from 2.6 s on" in sentences[1]
    assert "cosine 0.950 in 10 velocities (`tiny`, 0.3 s)" in sentences[2]
    assert "within 10% in 1 and 0 of 1 columns (`tiny`)" in sentences[2]
    assert "-0.2 mm/s (`tiny`)" in sentences[3]
    assert "hold 96% of 100 fronts" in sentences[4]
    assert "warns of 1 of 2 scenes out of range and of 0 of 1 in range" in sentences[4]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    assert ["column", "3", "1", "**3.2 %** (**-6.0 %**)", "1.0 % (+1.0 %)"] in [each[:5] for each in rows]
    assert ["`tiny`", "0.3", "**0.950**", "0.90"] in rows
    assert ["`tiny`", "0.200", "**-0.200**", "0 of 1", "0.100", "1 of 1"] in rows
    assert "(not of: steep)" in text
    monkeypatch.setattr(plots, "DPI", 30)
    flow = sliding(BLOCK, 0.5)
    pictures.draw_errors(tmp_path / "errors.png", 2, scores)
    pictures.draw_deposits(tmp_path / "deposits.png", [pictures.Pictured(name="a", truth=flow, rollouts={"m": flow})])
    pictures.draw_prices(tmp_path / "prices.png", found.prices)
    pictures.draw_gradients(tmp_path / "gradients.png", found.gradients)
    assert len(list(tmp_path.glob("*.png"))) == 4


def test_models_have_names_of_their_own(tiny: Model) -> None:
    assert (tiny.name, tiny.updates) == ("tiny", 3000)
    with pytest.raises(InputError, match="--model"):
        load([tiny.path, tiny.path])


@pytest.mark.slow
def test_the_whole_command_in_its_quick_form(tiny: Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def draw(stream: np.random.Generator, index: int) -> Scene:
        thrown = dataclasses.replace(BLOCK.masses[0], velocity=(0.5, 0.0))
        return dataclasses.replace(BLOCK, masses=(thrown,), duration=0.1, seed=int(stream.integers(100)))

    storage = Storage(cell=0.01, kept=1)
    definition = Definition(
        name="toys", size=4, connectivity_radius=0.02, split=lambda _: Split.TRAIN, draw=draw, storage=storage
    )
    family = Family(definition=definition, kinds=("column",), storage=storage, cell=0.01)
    monkeypatch.setattr(held_out, "family", lambda dimension: family if dimension == 2 else None)
    monkeypatch.setattr(
        bench, "pool", lambda jobs: nullcontext(SimpleNamespace(executor=SimpleNamespace(map=map), width=lambda: jobs))
    )
    monkeypatch.setattr(velocities, "blocks_problem", lambda *cut, duration: blocks_problem(*cut, duration=0.05))
    monkeypatch.setattr(calibration, "shipped_bands", lambda: lambda scene, _: Band(low=0.0, high=1.0))
    monkeypatch.setattr(plots, "DPI", 30)
    said = bench.bench(tmp_path / "out", quick=True, keep=tmp_path / "keep", model=(tiny.path,))
    assert said.count("\n- ") == 3
    for part in ("Fronts of held-out scenes", "Error over seconds", "Gradients beside", "hold 100% of 1 fronts"):
        assert part in said
    text = (tmp_path / "out" / "gns.md").read_text()
    for name in ("gns-held-out-2d.png", "gns-deposits-2d.png", "gns-price.png", "gns-gradients.png"):
        assert name in text
        assert (tmp_path / "out" / name).is_file()
    # What was measured is not measured again.
    monkeypatch.setattr(held_out, "simulate_many", lambda *_, **__: pytest.fail("it is there"))
    monkeypatch.setattr(price, "all_runs", lambda *_: pytest.fail("it is there"))
    bench.bench(tmp_path / "again", quick=True, keep=tmp_path / "keep", model=(tiny.path,))
    figures = [line for line in text.splitlines() if line.startswith("|")]
    assert [line for line in (tmp_path / "again" / "gns.md").read_text().splitlines() if line[:1] == "|"] == figures
