"""`python -m validation.bench speed-gns`: networks, what is measured, what is left out, the page."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from gns.model import checkpoint
from gns.model.settings import ModelSettings
from gns.model.simulator import Normalisation, Simulator
from gns.model.state import Conditions, State
from validation.bench.speed import gns, networks
from validation.bench.speed.columns import ACROSS, FREE, column
from validation.bench.speed.networks import Family, Kind, Measure, RolloutCost, StepCase, StepCost
from validation.bench.speed.textbook import Textbook, neighbours
from validation.report import memory, plots
from validation.report.timing import spread

SETTINGS = ModelSettings(width=8, layers=2, rounds=2, grid_channels=4, grid_layers=1)
RADIUS = 0.025


def tiny(settings: ModelSettings = SETTINGS) -> Simulator:
    torch.manual_seed(0)
    normalisation = Normalisation(displacement=3.0e-3, acceleration=7.0e-4, friction_mean=0.6, friction_std=0.2)
    return Simulator(settings, normalisation).eval()


@pytest.fixture
def family() -> Family:
    return networks.family("tiny", tiny())


def case(kind: Kind, measure: Measure, nodes: int) -> StepCase:
    return StepCase(family="tiny", kind=kind, measure=measure, nodes=nodes)


def test_the_textbook_has_the_size_of_ours_and_the_paper_s_network_its_weights(family: Family) -> None:
    layers = {kind: len(family.networks[kind].layers) for kind in (Kind.TEXTBOOK, Kind.PAPER)}  # type: ignore[arg-type]
    assert layers == {Kind.TEXTBOOK: SETTINGS.layers, Kind.PAPER: 10}
    assert all(family.networks[kind].radius == SETTINGS.radius for kind in layers)
    # 10 layers of perceptrons 3 x 128 -> 128 and 2 x 128 -> 128, each with two hidden layers and a norm; two encoders
    # and a decoder.
    square, norm = 128 * 128 + 128, 2 * 128
    inner = 10 * ((3 * 128 * 128 + 128 + 2 * square + norm) + (2 * 128 * 128 + 128 + 2 * square + norm))
    ends = (15 * 128 + 128 + 2 * square + norm) + (3 * 128 + 128 + 2 * square + norm) + (2 * square + 128 * 2 + 2)
    paper = Textbook(dimension=2, radius=0.015, history=5)
    assert sum(each.numel() for each in paper.parameters()) == inner + ends


@pytest.mark.parametrize("samples", [1, 2])
def test_neighbours_are_all_pairs_within_the_radius(samples: int) -> None:
    torch.manual_seed(0)
    positions = 0.1 * torch.rand(60, 2, dtype=torch.float64)
    batch = torch.arange(60) % samples
    senders, receivers = neighbours(positions, RADIUS, batch if samples > 1 else None)
    near = torch.cdist(positions, positions) <= RADIUS
    near &= (batch[:, None] == batch) & ~torch.eye(60, dtype=torch.bool)
    found = torch.zeros_like(near)
    found[receivers, senders] = True
    assert len(senders) == int(near.sum()) > 0
    assert torch.equal(found, near)


def test_a_message_travels_one_radius_per_layer() -> None:
    # A row of nodes, each with one neighbour on either side.
    torch.manual_seed(0)
    positions = torch.stack((0.5 + 0.02 * torch.arange(6.0), torch.full((6,), 0.5)), dim=1)
    state = State(positions=positions, displacements=torch.zeros(3, 6, 2))
    _, conditions = column(ModelSettings(), 6)
    model = Textbook(dimension=2, radius=RADIUS, history=3, width=8, layers=2, hidden_layers=1)
    changed = conditions.friction.clone()
    changed[0] = 0.7
    after = [model(state, dataclasses.replace(conditions, friction=each)) for each in (changed, conditions.friction)]
    difference = (after[0].positions - after[1].positions).abs().sum(dim=1)
    assert (difference[:3] > 0.0).all()
    assert (difference[3:] == 0.0).all()


@pytest.mark.parametrize(("dimension", "nodes"), [(2, 130), (3, 700)])
def test_a_column_has_its_nodes_at_the_model_s_density(dimension: int, nodes: int) -> None:
    settings = ModelSettings(dimension=dimension)
    state, conditions = column(settings, nodes)
    assert state.positions.shape == (nodes, dimension)
    assert state.displacements.shape == (settings.history, nodes, dimension)
    height = ACROSS[dimension] * settings.cell
    assert float(state.positions[:, 1].max()) == pytest.approx(height, abs=settings.cell)
    length = float(state.positions[:, 0].max())
    assert length * height ** (dimension - 1) == pytest.approx(float(conditions.volume.sum()), rel=0.25)
    assert float(conditions.size[0, 0]) - length == pytest.approx(FREE * height, abs=settings.cell)
    assert (state.positions > 0.0).all()
    assert (state.positions < conditions.size).all()
    state, conditions = column(settings, 100, samples=2)
    assert conditions.batch is not None
    assert torch.bincount(conditions.batch).tolist() == [100, 100]
    assert conditions.samples == len(conditions.gravity) == len(conditions.damping) == 2


def test_a_longer_column_has_as_many_neighbours_per_node() -> None:
    settings = ModelSettings()
    assert networks.edges(settings, 4_000) / 4_000 == pytest.approx(networks.edges(settings, 2_000) / 2_000, rel=0.03)


def test_shipped_models_are_found(tmp_path: Path) -> None:
    for name in ("flow-fast", "flow"):
        checkpoint.save(tmp_path / f"{name}.safetensors", tiny(), {})
    checkpoint.save(tmp_path / "hill.safetensors", tiny(dataclasses.replace(SETTINGS, dimension=3)), {})
    found = networks.families(tmp_path)
    assert [each.name for each in found] == ["flow", "flow-fast", "hill"]
    # The second model has the nodes and the radius of the first.
    assert [Kind.PAPER in each.networks for each in found] == [True, False, True]


@pytest.mark.parametrize("kind", [Kind.OURS, Kind.TEXTBOOK])
def test_each_measure_does_what_its_name_says(family: Family, kind: Kind, monkeypatch: pytest.MonkeyPatch) -> None:
    network = family.networks[kind]
    calls: list[tuple[Any, ...]] = []
    inner: Callable[..., State] = type(network).forward

    def forward(self: torch.nn.Module, state: State, conditions: Conditions, *rest: Any) -> State:
        after = inner(self, state, conditions, *rest)
        calls.append((state, conditions, after, list(self.parameters())))
        return after

    monkeypatch.setattr(type(network), "forward", forward)
    for measure, samples in ((Measure.FORWARD, 1), (Measure.GRADIENT, 1), (Measure.TRAINING, 2)):
        calls.clear()
        networks.step_of(family, case(kind, measure, 100))()
        ((state, conditions, after, weights),) = calls
        assert len(state.positions) == 100 * samples
        assert after.positions.requires_grad == (measure is not Measure.FORWARD)
        if measure is Measure.GRADIENT:
            assert all(each.grad is not None for each in (conditions.friction, state.positions))
            assert all(each.grad is None for each in weights)
        if measure is Measure.TRAINING:
            assert all(each.grad is not None for each in weights)
    assert all(each.grad is None for each in network.parameters())


def test_what_is_too_costly_is_left_out(family: Family, monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[StepCase] = []
    monkeypatch.setattr(networks, "step_of", lambda _, each: lambda: ran.append(each))
    monkeypatch.setattr(networks, "extra", lambda action: action())
    monkeypatch.setattr(networks, "mean_seconds", lambda _: 0.5)
    monkeypatch.setattr(networks, "LONGEST", 1e-9)
    costs = networks.measured([family], 3, {2: (100, 300)})
    assert costs[case(Kind.OURS, Measure.FORWARD, 300)].seconds == (0.5,) * 3
    assert costs[case(Kind.PAPER, Measure.FORWARD, 300)].left_out == "~0 s"
    assert case(Kind.TEXTBOOK, Measure.TRAINING, 300) not in ran
    large = StepCost(seconds=(0.1,), peak=int(4e9))
    assert networks.too_costly(2.0, large, 5.0) == "~8 GB"
    assert networks.too_costly(1.2, large, 5.0) == ""


def test_one_second_of_flow(monkeypatch: pytest.MonkeyPatch) -> None:
    initial = networks.initial
    monkeypatch.setattr(networks, "initial", lambda settings: dataclasses.replace(initial(settings), steps=3))
    calls = []
    simulator = tiny()
    simulator.register_forward_hook(lambda *_: calls.append(1))
    found = networks.rollout_cost("tiny", simulator, 1)
    assert (found.nodes, found.steps, found.run) == (800, 3, True)
    # One for the size of the activations, two rollouts forward, two with the gradient.
    assert len(calls) == 1 + 4 * 3
    monkeypatch.setattr(networks, "initial", initial)
    monkeypatch.setattr(networks, "mean_seconds", lambda _: 0.25)
    monkeypatch.setattr(networks, "step", lambda *_: lambda: None)
    found = networks.extrapolated_cost("paper", torch.nn.Identity(), networks.PAPER)
    assert (found.nodes, found.steps, found.run) == (3_200, 400, False)
    assert (found.forward.median, found.gradient.median) == (100.0, 200.0)


def test_the_page_and_its_picture(family: Family, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    costs = {}
    for measure in Measure:
        for nodes, one in ((100, (0.01, 0.02)), (200, (0.02, 0.04))):
            costs[case(Kind.OURS, measure, nodes)] = StepCost(seconds=one)
            costs[case(Kind.TEXTBOOK, measure, nodes)] = StepCost(seconds=(4 * one[0], 4 * one[1]))
        costs[case(Kind.PAPER, measure, 100)] = StepCost(seconds=(0.3,))
        costs[case(Kind.PAPER, measure, 200)] = StepCost(left_out="~7 s")
    second = RolloutCost(name="tiny", nodes=800, steps=100, run=True, forward=spread([1.0]), gradient=spread([2.0]))
    paper = dataclasses.replace(second, name="textbook", run=False, forward=spread([740.0]))
    text = str(gns.page([family], costs, [second, paper], command="the command"))
    assert "One second of flow takes 1 s with `tiny`, with its gradient 2 s; textbook 740 s and 2 s" in text
    assert "The textbook's network of the size of `tiny` takes 4.0 to 4.0 times as long per step." in text
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    assert ["tiny", "800", "100", "1.00", "2.00"] in cells
    assert ["0.0150 (0.0100-0.0200)", "x 4.0", "x 20.0"] in [row[2:5] for row in cells if row[0] == "100"]
    assert ["0.0300 (0.0200-0.0400)", "x 4.0", "~7 s"] in [row[2:5] for row in cells if row[0] == "200"]
    monkeypatch.setattr(plots, "DPI", 30)
    gns.draw(tmp_path / "speed.png", [family], costs)
    assert (tmp_path / "speed.png").stat().st_size > 1_000


@pytest.mark.skipif(not memory.CLEAR.exists(), reason="only Linux tells the peak of a piece of work")
def test_memory_is_that_of_the_work() -> None:
    found = [memory.extra(lambda: torch.ones(20_000_000)) for _ in range(2)]
    assert found == [pytest.approx(80e6, rel=0.1)] * 2
    assert memory.extra(lambda: None) == pytest.approx(0, abs=2e6)
