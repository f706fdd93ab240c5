"""`python -m validation.bench.speed.bench gns`: what is measured, what is left out, and the tables."""

import dataclasses
import time
from pathlib import Path

import pytest
import torch

from datasets.command_line import run
from gns.model import checkpoint
from gns.model.settings import ModelSettings
from gns.model.simulator import Simulator
from validation.bench.speed import bench as speed
from validation.bench.speed import gns_rates, whole_second
from validation.bench.speed.gns_page import draw, memory_table, page, times_table
from validation.bench.speed.gns_rates import Case, Cost, Family, Kind, LeftOut, Measure
from validation.bench.speed.whole_second import Second
from validation.report import memory as footprint
from validation.report.timing import Spread, turns

SETTINGS = ModelSettings(width=8, layers=2, rounds=2, grid_channels=4, grid_layers=1)


def tiny(settings: ModelSettings = SETTINGS) -> Simulator:
    torch.manual_seed(0)
    return Simulator(settings, gns_rates.UNTRAINED).eval()


def case(kind: Kind, measure: Measure, points: int) -> Case:
    return Case(family="tiny", kind=kind, measure=measure, points=points)


def cells_of(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip("|").split("|")]


def costs(family: Family) -> dict[Case, Cost | LeftOut]:
    """As if measured: the textbook takes four times ours, the paper's size was too much for the larger dam."""
    found: dict[Case, Cost | LeftOut] = {}
    for measure in Measure:
        for points, one in ((100, (0.01, 0.02)), (200, (0.02, 0.04))):
            found[case(Kind.OURS, measure, points)] = Cost(seconds=one, peak=2_000_000)
            found[case(Kind.TEXTBOOK, measure, points)] = Cost(seconds=(4 * one[0], 4 * one[1]), peak=9_000_000)
        found[case(Kind.PAPER, measure, 100)] = Cost(seconds=(0.3,), peak=None)
        found[case(Kind.PAPER, measure, 200)] = LeftOut(reason="~7 s")
    return found


@pytest.fixture
def family() -> Family:
    return gns_rates.family("tiny", tiny())


def test_the_textbook_has_the_size_of_ours(family: Family) -> None:
    hops = {kind: len(family.networks[kind].hops) for kind in (Kind.TEXTBOOK, Kind.PAPER)}
    assert hops == {Kind.TEXTBOOK: SETTINGS.layers, Kind.PAPER: 10}
    assert all(family.networks[kind].radius == SETTINGS.radius for kind in hops)


def test_shipped_models_are_found_and_3d_is_never_missing(tmp_path: Path) -> None:
    for name in ("flow-fast", "flow"):
        checkpoint.save(tmp_path / f"{name}.pt", tiny(), {})
    found = gns_rates.families(tmp_path)
    assert [each.name for each in found] == ["flow", "flow-fast", "default settings in 3D, untrained"]
    # The second model has the points and the radius of the first.
    assert [Kind.PAPER in each.networks for each in found] == [True, False, True]
    solid = tiny(dataclasses.replace(SETTINGS, dimension=3))
    checkpoint.save(tmp_path / "hill.pt", solid, {})
    assert [each.name for each in gns_rates.families(tmp_path)] == ["flow", "flow-fast", "hill"]


@pytest.mark.parametrize("kind", [Kind.OURS, Kind.TEXTBOOK])
def test_each_measure_does_what_it_says(family: Family, kind: Kind, monkeypatch: pytest.MonkeyPatch) -> None:
    network = family.networks[kind]
    seen = []
    monkeypatch.setattr(type(network), "forward", record(type(network).forward, seen))
    for measure, samples in ((Measure.FORWARD, 1), (Measure.GRADIENT, 1), (Measure.TRAINING, 2)):
        seen.clear()
        gns_rates.case_work(family, case(kind, measure, 100))()
        ((state, conditions, after, weights),) = seen
        assert len(state.positions) == 100 * samples
        assert conditions.friction.requires_grad == (measure is Measure.GRADIENT)
        assert (conditions.friction.grad is not None) == (measure is Measure.GRADIENT)
        assert weights == (measure is Measure.TRAINING)
        assert after.positions.requires_grad == (measure is not Measure.FORWARD)


def record(forward, seen):  # type: ignore[no-untyped-def]
    def recorded(self, state, conditions):  # type: ignore[no-untyped-def]
        after = forward(self, state, conditions)
        seen.append((state, conditions, after, next(self.parameters()).requires_grad))
        return after

    return recorded


def test_training_leaves_the_measured_model_as_it_is(family: Family) -> None:
    before = [each.clone() for each in family.networks[Kind.OURS].parameters()]
    gns_rates.case_work(family, case(Kind.OURS, Measure.TRAINING, 60))()
    after = list(family.networks[Kind.OURS].parameters())
    assert all(torch.equal(a, b) for a, b in zip(before, after, strict=True))


def test_sizes_are_measured_until_one_would_be_too_much(family: Family, monkeypatch: pytest.MonkeyPatch) -> None:
    slow = dataclasses.replace(family, networks={kind: family.networks[kind] for kind in (Kind.OURS, Kind.TEXTBOOK)})

    def fake(each: Family, one: Case):  # type: ignore[no-untyped-def]
        ours, points = one.kind is Kind.OURS, one.points
        return lambda: time.sleep(0.0 if ours or points == gns_rates.WARM_UP else points * 1.0e-4)

    monkeypatch.setattr(gns_rates, "case_work", fake)
    monkeypatch.setattr(gns_rates, "LEAST", 0.0)
    monkeypatch.setattr(gns_rates, "extra", lambda action: action())
    found = gns_rates.measured([slow], rounds=2, longest=0.1, sizes={2: (100, 400, 3_000)})
    ours = [found[case(Kind.OURS, Measure.FORWARD, points)] for points in (100, 400, 3_000)]
    theirs = [found[case(Kind.TEXTBOOK, Measure.FORWARD, points)] for points in (100, 400, 3_000)]
    assert [isinstance(each, Cost) for each in (*ours, *theirs)] == [True] * 5 + [False]
    assert all(isinstance(each, Cost) and len(each.seconds) == 2 for each in ours)


def test_what_is_too_much() -> None:
    smaller = Cost(seconds=(1.0,), peak=1_000_000_000)
    assert gns_rates.too_much(3.0, smaller, 4.0) == ""
    assert gns_rates.too_much(5.0, smaller, 4.0) == "~5 s"
    assert gns_rates.too_much(7.0, smaller, 100.0) == "~7 GB"


def test_ratios_of_what_was_measured_once_are_to_the_median() -> None:
    ours = Cost(seconds=(1.0, 2.0, 4.0), peak=None)
    assert gns_rates.ratio(Cost(seconds=(2.0, 2.0, 8.0), peak=None), ours) == Spread(least=1, middle=2, greatest=2)
    assert gns_rates.ratio(Cost(seconds=(10.0,), peak=None), ours).written(1) == "5.0"


def test_turns() -> None:
    order = []
    found = turns({"a": lambda: order.append("a") or 1, "b": lambda: order.append("b") or 2}, 2, "")
    assert order == ["a", "b", "a", "b"]
    assert found == {"a": [1, 1], "b": [2, 2]}


def test_the_tables(family: Family) -> None:
    head, _, small, large = times_table(family, costs(family))
    assert cells_of(head)[2:5] == ["forward [s]", "textbook", "128 x 10"]
    assert cells_of(small)[0] == "100"
    assert cells_of(small)[2:5] == ["0.0150 (0.0100-0.0200)", "x 4.0", "x 20.0"]
    assert cells_of(large)[2:5] == ["0.0300 (0.0200-0.0400)", "x 4.0", "~7 s"]
    _, _, small, large = memory_table(family, costs(family))
    assert cells_of(small) == ["100", *["2", "9", "-"] * 3]
    assert cells_of(large) == ["200", *["2", "9", "~7 s"] * 3]


def test_the_page_and_its_picture(family: Family, tmp_path: Path) -> None:
    spread = Spread.of([1.0])
    second = Second(name="tiny", points=800, steps=100, run=True, forward=spread, gradient=spread, peak=None)
    text = page([family], costs(family), [second], rounds=2, longest=4.0)
    assert "| tiny | 800 | 100 | 1.00 | 1.00 | - |" in text
    assert "--rounds 2 --longest 4" in text
    assert "### tiny" in text
    assert max(len(line) for line in text.splitlines() if not line.startswith("|")) <= 120
    draw(tmp_path / "speed.png", [family], costs(family))
    assert (tmp_path / "speed.png").stat().st_size > 10_000


def test_a_second_is_run_through_all_its_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    class Short:
        """The column's first steps."""

        def __init__(self, settings: ModelSettings) -> None:
            self.__dict__ |= vars(start(settings)) | {"steps": 3}

    start = whole_second.start
    monkeypatch.setattr(whole_second, "start", Short)
    calls = []
    simulator = tiny()
    simulator.register_forward_hook(lambda *_: calls.append(1))
    found = whole_second.rolled_out("tiny", simulator, 1)
    assert (found.points, found.steps, found.run) == (800, 3, True)
    # One for the size of the activations, two rollouts forward, two with the gradient.
    assert len(calls) == 1 + 4 * 3
    assert found.gradient.middle > 0.0


def test_a_textbooks_second_is_its_steps_times_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(whole_second, "timed", lambda action: 0.25)
    monkeypatch.setattr(whole_second, "work", lambda *_: lambda: None)
    found = whole_second.multiplied("paper", torch.nn.Identity(), whole_second.PEERS)
    assert (found.points, found.steps, found.run) == (3_200, 400, False)
    assert (found.forward.middle, found.gradient.middle) == (100.0, 200.0)


@pytest.mark.skipif(not footprint.CLEAR.exists(), reason="Linux alone tells the peak of a piece of work")
def test_memory_is_what_the_work_took() -> None:
    def work() -> None:
        torch.ones(20_000_000)

    taken = [footprint.extra(work) for _ in range(2)]
    assert taken == [pytest.approx(80e6, rel=0.1)] * 2
    assert footprint.extra(lambda: None) == pytest.approx(0, abs=2e6)


@pytest.mark.slow
def test_the_whole_command_on_tiny_networks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    weights = tmp_path / "weights"
    checkpoint.save(weights / "flow.pt", tiny(), {})
    monkeypatch.setattr(gns_rates.families, "__defaults__", (weights,))
    monkeypatch.setattr(whole_second, "PEERS", ModelSettings(cell=0.04, radius=0.1, frames_per_step=40))
    monkeypatch.setattr(gns_rates.measured, "__defaults__", ({2: (100, 200), 3: (300,)},))
    assert run(speed.command, "speed", ["gns", "--out", str(tmp_path), "--rounds", "1", "--longest", "1"]) == 0
    text = (tmp_path / "speed-gns.md").read_text()
    assert "### flow" in text
    assert "untrained" in text
    assert (tmp_path / "speed-gns.png").exists()
