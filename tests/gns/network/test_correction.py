"""The correction of a rollout's end: what it keeps, what it learns, and where it is left out."""

from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import torch

from datasets.flow import measures
from gns import checkpoint
from gns.network.correction import Correction, stretched
from gns.settings import ModelSettings, TrainingSettings
from gns.simulator import Simulator, unroll
from gns.surroundings.state import Conditions, State
from gns.training.losses import EndLoss
from gns.training.samples import Rollouts, flows_of, measured
from tests.gns.conftest import NORMALISATION, TINY, Cloud, rows, run_train


@pytest.fixture
def corrected(lively: Simulator) -> Simulator:
    """The tiny model in double precision, frozen, with a correction that matters."""
    torch.manual_seed(2)
    lively.correction = Correction(lively.settings)
    with torch.no_grad():
        lively.correction.network.decoder.mlp[-1].weight.normal_(std=0.1)
    return lively.double().eval().requires_grad_(False)


def test_the_end_is_moved_and_the_way_to_it_stretched(corrected: Simulator, cloud: Cloud) -> None:
    state, conditions = (part.to(dtype=torch.float64) for part in cloud(lower=(0.1, 0.0), velocity=(1.0, 0.0)))
    frames = unroll(corrected, state, conditions, 12)
    off = (frames - unroll(corrected, state, conditions, 12, corrected=False)).norm(dim=2)
    assert not off[0].any()
    assert off[-1].median() > 1e-4
    # In proportion to the motion so far, but where the floor or a wall stops it.
    free = (frames[-1, :, 1] > 1e-3) & (frames[-1, :, 0] > 1e-3)
    share = (off[1:, free] / off[-1, free]).median(dim=1).values
    assert (share.diff() >= -1e-12).all()
    assert 0.0 < share[0] < 0.3
    assert ((frames[1:] >= 0.0) & (frames[1:] <= conditions.size[0])).all()
    # Sand that has not moved stays.
    still = state.positions.expand(4, -1, -1)
    at_rest = still.clone().requires_grad_()
    torch.testing.assert_close(stretched(at_rest, torch.ones_like(state.positions), conditions), still)
    (slope,) = torch.autograd.grad(stretched(at_rest, torch.ones_like(state.positions), conditions).sum(), at_rest)
    assert slope.isfinite().all()


def test_samples_side_by_side_are_corrected_as_alone(corrected: Simulator, cloud: Cloud) -> None:
    flows = [cloud(lower=(0.1, 0.0), velocity=(speed, 0.0), seed=seed) for seed, speed in ((0, 1.0), (1, 0.3))]
    flows = [(state.to(dtype=torch.float64), conditions.to(dtype=torch.float64)) for state, conditions in flows]
    alone = torch.cat([unroll(corrected, *flow, 6) for flow in flows], dim=1)
    states, conditions = zip(*flows, strict=True)
    together = unroll(corrected, State.joined(states), Conditions.joined(conditions), 6)
    torch.testing.assert_close(together, alone, atol=1e-9, rtol=0.0)


def test_the_gradient_of_a_corrected_end_is_that_of_differences(corrected: Simulator, cloud: Cloud) -> None:
    state, conditions = (part.to(dtype=torch.float64) for part in cloud(lower=(0.3, 0.2), velocity=(0.5, 0.0)))

    def mean_x(friction: torch.Tensor) -> torch.Tensor:
        changed = replace(conditions, friction=conditions.friction + friction)
        return unroll(corrected, state, changed, 5)[-1, :, 0].mean()

    change, step = torch.zeros((), dtype=torch.float64, requires_grad=True), 1e-6
    (slope,) = torch.autograd.grad(mean_x(change), change)
    with torch.no_grad():
        differences = (mean_x(change + step) - mean_x(change - step)) / (2.0 * step)
    assert slope.item() == pytest.approx(differences.item(), rel=1e-4)


def test_ends_and_equal_shares_are_the_measured_ones() -> None:
    rng = np.random.default_rng(0)
    positions, volume = rng.random((300, 3)), rng.random(300) + 0.1
    figures = measured(torch.from_numpy(positions), torch.from_numpy(volume))
    assert figures.shape == (2, 2 + measures.SHARES)
    for axis, row in zip((0, 2), figures.numpy(), strict=True):
        line = positions[:, [axis]]
        rear, front = measures.ends(line, volume)
        np.testing.assert_allclose(row, [front, -rear, *measures.equal_shares(line, volume)], rtol=1e-12)


def test_a_correction_learns_and_is_left_out(dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # In free flight: the ends of what hardly moves would not be moved either.
    simulator = Simulator(ModelSettings(width=8, layers=1, rounds=1, grid_channels=4, grid_layers=1), NORMALISATION)
    checkpoint.save(tmp_path / "steps.safetensors", simulator, {})
    usual = ("--device", "cpu", "--unroll", "1", "--threads", "1")
    begin = ("--begin", str(tmp_path / "steps.safetensors"), *usual)
    more = ("--correct", "--validations", "2", "--learning-rate", "2e-2", "--warmup", "5", "--validate-flows", "1")
    assert run_train(dataset, tmp_path / "ends", *begin, *more, "--updates", "60") == 0
    before, *_, after = (float(row["score"]) for row in rows(tmp_path / "ends"))
    assert after < 0.8 * before
    ends = checkpoint.load(tmp_path / "ends" / "best.safetensors").simulator
    assert ends.correction is not None
    for name, weights in simulator.state_dict().items():
        torch.testing.assert_close(ends.state_dict()[name], weights)
    # The run goes on where it was, and another one that trains the steps begins without the correction.
    assert run_train(dataset, tmp_path / "ends", *begin, *more, "--updates", "64", "--resume") == 0
    begin = ("--begin", str(tmp_path / "ends" / "best.safetensors"), *usual)
    assert run_train(dataset, tmp_path / "again", *begin, "--updates", "1") == 0
    assert checkpoint.load(tmp_path / "again" / "best.safetensors").simulator.correction is None
    assert run_train(dataset, tmp_path / "none", *TINY, "--correct") == 2
    assert "--begin: expected a model to begin with" in capsys.readouterr().err


def test_ends_of_rollouts_are_kept(dataset: Path, corrected: Simulator, monkeypatch: pytest.MonkeyPatch) -> None:
    simulator = corrected.float()
    flows = flows_of(dataset, "train", simulator.settings)
    recorded = Mock(wraps=unroll)
    monkeypatch.setattr("gns.training.samples.unroll", recorded)
    rollouts = Rollouts([flows], simulator, TrainingSettings(batch=4, first=1.0))
    drawn = [rollouts.batch(1, np.random.default_rng(number)) for number in range(200)]
    assert recorded.call_count == 2 * len(flows)
    assert {call.args[3] for call in recorded.call_args_list} == {len(flows[0].positions) - 1}
    for ends in drawn[:5]:
        assert ends.targets.shape == (1, *ends.end.positions.shape)
        assert ends.whole.shape == (4, 1, 2 + measures.SHARES)
        assert EndLoss(simulator, rollouts, TrainingSettings(density_weight=1.0))(ends).isfinite()
