"""The last layer by least squares."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from datasets import command_line
from datasets.training.samples import Flow
from gns import refit
from gns.inference import members
from gns.model import checkpoint
from gns.model.simulator import Simulator
from gns.refit import NormalEquations, best_ridge, changed, equations, jacobian
from gns.training.batch import batched
from gns.training.flows import flows_of, stretch
from gns.unroll import unroll
from tests.gns.conftest import Cloud


def flows(dataset: Path, simulator: Simulator, split: str = "train") -> list[Flow]:
    return list(flows_of(dataset, split, simulator.settings))


def of_model(simulator: Simulator, flow: Flow) -> Flow:
    """The flow that a model makes of the same start, of the particles that it follows."""
    settings, steps = simulator.settings, len(flow.positions) - 1
    sample = stretch(flow, settings, now=0, steps=steps, rng=np.random.default_rng(0))
    batch = batched([sample], step=settings.step, history=settings.history)
    with torch.no_grad():
        positions = unroll(simulator, batch.state, batch.conditions(settings.cell), steps)
    return Flow(
        name="model",
        positions=positions.numpy(),
        velocity0=sample.velocity0,
        friction=sample.friction,
        cohesion=sample.cohesion,
        volume=np.asarray(sample.volume, np.float64),
        surroundings=flow.surroundings,
        step=flow.step,
    )


@pytest.mark.parametrize("axis", [0, 1])
def test_accelerations_are_linear_in_the_last_layer(lively: Simulator, cloud: Cloud, axis: int) -> None:
    state, conditions = cloud(velocity=(0.3, -0.2))
    last = lively.network.decoder.last
    by = 0.1 * np.random.default_rng(3).standard_normal(last.out_features * (last.in_features + 1))
    with torch.no_grad():
        hidden, forces = lively.hidden(state, conditions)
        before = lively.contact(hidden, forces)[:, axis]
        predicted = before + jacobian(lively, hidden, forces, axis) @ torch.from_numpy(by).float()
        found = changed(lively, by).contact(hidden, forces)[:, axis]
        torch.testing.assert_close(found, predicted, rtol=1e-4, atol=1e-7)
    assert (predicted - before).abs().max() > 1e-5


def test_the_layer_of_the_model_that_made_the_flows_is_found(lively: Simulator, dataset: Path) -> None:
    # Static friction is not linear in the accelerations.
    lively.settings = dataclasses.replace(lively.settings, rest_speed=0.0)
    last = lively.network.decoder.last
    size = last.out_features * (last.in_features + 1)
    truth = changed(lively, 0.05 * np.random.default_rng(5).standard_normal(size))
    made = [[of_model(truth, flow) for flow in flows(dataset, lively)]]
    (sums,) = equations(lively, made)
    before = sums.residual(np.zeros(size))
    assert before > 1e-6
    found = changed(lively, sums.solution(1.0e-6))
    # Not to nothing: its states were those of the wrong layer, a few steps after those of the flow.
    assert equations(found, made)[0].residual(np.zeros(size)) < 0.3 * before


def test_parts_add_up(lively: Simulator, dataset: Path) -> None:
    made = [flows(dataset, lively)]
    (whole,), parts = equations(lively, made), equations(lively, made, parts=2)
    total = parts[0] + parts[1]
    assert min(part.count for part in parts) > 0.4 * whole.count
    # Which particles of a cell are followed is drawn in another order.
    assert total.count == pytest.approx(whole.count, rel=0.02)
    assert total.square == pytest.approx(whole.square, rel=0.1)
    assert np.trace(total.matrix) == pytest.approx(np.trace(whole.matrix), rel=0.1)
    together = np.dot(total.vector, whole.vector) / (np.linalg.norm(total.vector) * np.linalg.norm(whole.vector))
    assert together > 0.99


def test_large_residuals_count_linearly() -> None:
    sums = NormalEquations.of_size(1)
    sums.add(torch.ones(10, 1), torch.tensor([0.0] * 9 + [100.0]), 1.0)
    # The weighted mean of nine zeros and of 100 with a weight of 1 / 100.
    assert sums.solution(0.0)[0] == pytest.approx(1.0 / 9.01, rel=1e-5)
    assert sums.residual(np.zeros(1)) == pytest.approx((100.0 / 10) ** 0.5, rel=1e-5)


def test_the_ridge_is_the_best_on_other_flows() -> None:
    rng = np.random.default_rng(0)

    def sums(count: int) -> NormalEquations:
        found, rows = NormalEquations.of_size(20), torch.from_numpy(rng.standard_normal((count, 20))).float()
        found.add(rows, rows[:, 0] + torch.from_numpy(rng.standard_normal(count)).float(), 100.0)
        return found

    # Of many observations nothing has to be held back, of as few as there are unknowns most.
    assert best_ridge(sums(200_000), sums(100_000)) <= 1.0e-2
    assert best_ridge(sums(21), sums(100_000)) >= 0.1


def test_the_command(lively: Simulator, dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model, out = tmp_path / "model.safetensors", tmp_path / "new" / "model.safetensors"
    checkpoint.save(model, lively, {"command": "train", "log": {"updates": 3}})
    arguments = [str(model), str(dataset), "--out", str(out), "--members", "2"]
    assert command_line.run(refit.refit, "python -m gns.refit", arguments) == 0
    said = capsys.readouterr().out
    found = checkpoint.load(out)
    assert found.provenance["log"] == {"updates": 3}
    for split in ("train", "valid"):
        before, after = found.provenance["refit"]["residuals"][split]
        assert f"{split}: residual acceleration {before:.4f} g before, {after:.4f} g after" in said
    before, after = found.provenance["refit"]["residuals"]["train"]
    assert after < before
    ensemble = [found, *map(checkpoint.load, members(out))]
    assert len(ensemble) == 3
    for each in ensemble:
        state = each.simulator.state_dict()
        moved = {name for name, value in lively.state_dict().items() if not torch.equal(value, state[name])}
        assert moved == {"network.decoder.mlp.2.weight", "network.decoder.mlp.2.bias"}
    first, second = (each.simulator.network.decoder.last.weight for each in ensemble[1:])
    assert not torch.equal(first, second)


def test_what_it_cannot_use(
    lively: Simulator, dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = tmp_path / "model.safetensors"
    checkpoint.save(model, lively, {})
    for arguments, said in (
        ((model, dataset, "--out", tmp_path / "new.pt"), "expected a name that ends in .safetensors"),
        ((model, "--out", tmp_path / "new.safetensors"), "expected at least one dataset"),
        ((model, dataset, "--out", tmp_path / "new.safetensors", "--members", 1), "--members: expected none, or two"),
        ((model, dataset, "--out", tmp_path / "new.safetensors", "--members", 9), "at most one member per training"),
        ((model, tmp_path, "--out", tmp_path / "new.safetensors"), "expected trajectories in train/*.npz"),
    ):
        assert command_line.run(refit.refit, "python -m gns.refit", list(map(str, arguments))) == 2
        error = capsys.readouterr().err
        assert said in error
        assert len(error.splitlines()) == 1
    assert not (tmp_path / "new.safetensors").exists()


def test_flows_too_short_to_follow(
    lively: Simulator,
    dataset: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    model, out = tmp_path / "model.safetensors", tmp_path / "new.safetensors"
    checkpoint.save(model, lively, {})
    monkeypatch.setattr(refit, "STEPS", 1000)
    assert command_line.run(refit.refit, "python -m gns.refit", [str(model), str(dataset), "--out", str(out)]) == 2
    assert "expected moving flows of more than 1000 steps in train" in capsys.readouterr().err
    assert not out.exists()
