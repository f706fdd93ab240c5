"""A network of one's own: what it must have, where it is taken, on how many threads it runs."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

import gns
from datasets import Mass
from datasets.compare import compare
from gns.score import calibrated, evaluate
from gns.settings import ModelSettings
from gns.simulator import advanced, on_threads
from gns.surroundings.state import Conditions, State
from gns.training.samples import flows_of
from inverse.forward.gns import GnsForward
from inverse.observations import FrontSettings
from tests.inverse.flows import problem_of
from tests.refusals import refused
from tests.scenes import scene_of
from validation.bench.stability.exact_solutions import FreeFlight


class Braked(nn.Module):
    """Flight against a drag in proportion to the speed and to tan(phi)."""

    def __init__(self, settings: ModelSettings, drag: float = 0.0, *, learned: bool = True) -> None:
        super().__init__()
        self.settings, self.drag = settings, nn.Parameter(torch.tensor(drag)) if learned else drag

    def forward(self, state: State, conditions: Conditions) -> State:
        brake = -self.drag * conditions.friction.unsqueeze(1) * state.displacements[-1]
        return advanced(state, conditions, brake, self.settings)


def test_a_network_of_ones_own_flies(tmp_path: Path) -> None:
    scene = scene_of(Mass(lower=(0.1, 0.4), size=(0.1, 0.1), velocity=(1.0, 0.5)), duration=0.1, frame_dt=0.01)
    settings = ModelSettings(cell=0.02)
    flow = gns.simulate(scene, model=Braked(settings))
    flight = FreeFlight(velocity=(1.0, 0.5), gravity=(0.0, -9.81), step=settings.step)
    moved = flow.positions - flow.positions[0]
    np.testing.assert_allclose(moved, np.broadcast_to(flight.displacement(flow.time)[:, None], moved.shape), atol=1e-5)
    slower = gns.simulate(scene, model=Braked(settings, 0.1))
    assert compare(flow, slower).figures[1]["front"][-1] < compare(flow, slower).figures[0]["front"][-1] - 0.01
    assert slower.view(tmp_path / "view.html", other=flow).stat().st_size > 0


def test_it_is_scored_calibrated_and_predicts_a_band(settings: ModelSettings, dataset: Path) -> None:
    model = Braked(settings)
    scores = evaluate(model, flows_of(dataset, "valid", settings))
    scene = flows_of(dataset, "test", settings)[0].scene
    prediction = gns.predict(scene, model=model, calibration=calibrated(scores))
    assert prediction.half_width == pytest.approx(calibrated(scores).front["0.95"] * prediction.extent)
    assert prediction.warning == "the training range of this network is unknown"
    refused(gns.predict, scene, model=model, said="calibration: expected a calibration, from gns.score.calibrated")


def test_a_law_without_weights_is_a_network_too(settings: ModelSettings, dataset: Path) -> None:
    flows = flows_of(str(dataset), "test", settings)
    assert evaluate(Braked(settings, learned=False), flows) == evaluate(Braked(settings), flows)
    scaled, problem = ModelSettings(cell=0.01, body_length=0.1), problem_of(2, "friction_deg")
    point, front = torch.tensor(problem.initial), FrontSettings().operator(problem.scene)
    models = [Braked(scaled, learned=learned) for learned in (False, True)]
    torch.testing.assert_close(*(GnsForward(model, problem, front).predict(point) for model in models))


class OfGraph(nn.Module):
    """With another forward."""

    settings = ModelSettings()

    def forward(self, x: Tensor, edge_index: Tensor, edge_attr: Tensor) -> Tensor:
        return x


class Positions(Braked):
    """Returns the positions alone."""

    def forward(self, state: State, conditions: Conditions) -> Any:
        return super().forward(state, conditions).positions


class Forgetful(Braked):
    """Returns one displacement in place of the last three."""

    def forward(self, state: State, conditions: Conditions) -> State:
        after = super().forward(state, conditions)
        return replace(after, displacements=after.displacements[-1:])


@pytest.mark.parametrize(
    ("model", "said"),
    [
        (print, "model: expected a torch.nn.Module with settings and forward(state, conditions)"),
        (nn.ReLU(), "ReLU.settings: expected gns.settings.ModelSettings, got None"),
        (OfGraph(), "OfGraph.forward: expected forward(state, conditions), got forward(x: "),
        (Positions(ModelSettings()), "forward: expected a State of shapes"),
        (Forgetful(ModelSettings()), "forward: expected a State of shapes"),
    ],
)
def test_what_is_no_model_is_named_in_a_line(model: Any, said: str) -> None:
    refused(gns.simulate, scene_of(Mass(lower=(0.1, 0.4), size=(0.1, 0.1)), duration=0.1), model=model, said=said)


class Counted(torch.autograd.Function):
    """The identity; how many threads torch has in both passes."""

    found: list[int] = []  # noqa: RUF012

    @staticmethod
    def forward(_: Any, x: Tensor) -> Tensor:
        Counted.found.append(torch.get_num_threads())
        return x.clone()

    @staticmethod
    def backward(_: Any, gradient: Tensor) -> Tensor:
        Counted.found.append(torch.get_num_threads())
        return gradient


@pytest.fixture
def two_threads() -> Iterator[None]:
    """Two threads of torch."""
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    Counted.found.clear()
    yield
    torch.set_num_threads(before)


@pytest.mark.usefixtures("two_threads")
def test_one_thread_forth_and_back_and_then_as_before() -> None:
    x = torch.ones(3, requires_grad=True)
    outside, once, twice = Counted.apply(x), on_threads(1, Counted.apply, x), on_threads(1, Counted.apply, x)
    assert torch.get_num_threads() == 2
    (outside + once + twice).sum().backward()
    assert torch.get_num_threads() == 2
    assert Counted.found[:3] == [2, 1, 1]
    assert sorted(Counted.found[3:])[:2] == [1, 1]

    def failing(_: Tensor) -> Tensor:
        raise KeyError

    with pytest.raises(KeyError):
        on_threads(1, failing, x)
    assert torch.get_num_threads() == 2


@pytest.mark.usefixtures("two_threads")
def test_rollouts_and_their_gradients_run_on_one_thread() -> None:
    class Watched(Braked):
        def forward(self, state: State, conditions: Conditions) -> State:
            after = super().forward(state, conditions)
            return replace(after, positions=Counted.apply(after.positions))

    settings = ModelSettings(cell=0.01, body_length=0.1)
    problem = problem_of(2, "friction_deg")
    forward = GnsForward(Watched(settings, 0.2), problem, FrontSettings().operator(problem.scene))
    Counted.found.clear()
    point = torch.tensor(problem.initial, requires_grad=True)
    forward.predict(point).sum().backward()
    gns.simulate(problem.scene, model=Watched(settings))
    assert len(Counted.found) > 3
    assert set(Counted.found) == {1}
    assert torch.get_num_threads() == 2
    Counted.found.clear()
    gns.simulate(problem.scene, model=Watched(settings), threads=2)
    assert set(Counted.found) == {2}
    refused(gns.simulate, problem.scene, model=Watched(settings), threads=0, said="threads: expected a whole number")
