"""A run learns, goes on to the bit where it was, and keeps as much as fits."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from datasets.command_line import WorkFailed
from datasets.errors import InputError
from datasets.training.samples import load_flows
from gns.model import interaction
from gns.model.interaction import message_sum
from gns.model.settings import ModelSettings
from gns.model.simulator import Simulator
from gns.training import run_file
from gns.training.objective import Curriculum, statistics
from gns.training.update import Run, TrainingSettings
from tests.gns.conftest import NORMALISATION


@pytest.fixture
def curriculum(dataset: Path, settings: ModelSettings) -> Curriculum:
    """The flows with a formula."""
    return Curriculum([load_flows(dataset, "train", step=settings.step, dimension=2, spacing=settings.cell)], settings)


def begin(settings: ModelSettings, **flags: float) -> Run:
    """A run at its beginning, always the same."""
    torch.manual_seed(0)
    return Run(Simulator(settings, NORMALISATION), TrainingSettings(warmup=5, learning_rate=1e-2), seed=0, **flags)


def test_the_loss_falls(dataset: Path, settings: ModelSettings, curriculum: Curriculum) -> None:
    torch.manual_seed(0)
    flows = load_flows(dataset, "train", step=settings.step, dimension=2, spacing=settings.cell)
    run = Run(Simulator(settings, statistics([flows])), TrainingSettings(warmup=5), seed=0)
    losses = [run.update(curriculum, steps=2, rate=1e-2) for _ in range(60)]
    assert np.mean(losses[-10:]) < 0.5 * np.mean(losses[:5])


def test_a_run_goes_on_to_the_bit(settings: ModelSettings, curriculum: Curriculum, tmp_path: Path) -> None:
    # Through single steps there is noise, another random stream.
    schedule = [1, 1, 2, 2, 1, 2]
    unbroken, broken = begin(settings), begin(settings)
    for number, steps in enumerate(schedule):
        unbroken.update(curriculum, steps=steps, rate=unbroken.learning_rate(number / 6))
    for number, steps in enumerate(schedule):
        if number == 3:
            broken.save(tmp_path / "last.safetensors")
            broken = begin(settings)
            # What others draw in the meantime is nothing to it.
            torch.rand(7)
            broken.resume(tmp_path / "last.safetensors")
        broken.update(curriculum, steps=steps, rate=broken.learning_rate(number / 6))
    assert broken.position == unbroken.position
    for part in ("simulator", "average"):
        states = [getattr(run, part).state_dict() for run in (unbroken, broken)]
        assert all(torch.equal(states[0][name], states[1][name]) for name in states[0])
    first, second = (run.optimiser.tensors() for run in (unbroken, broken))
    names = [key.partition("/")[0] + key[key.rindex("/") :] for key in first]
    assert set(names) == {"Muon/momentum_buffer", "Adam/exp_avg", "Adam/exp_avg_sq", "Adam/step"}
    assert all(torch.equal(first[key], second[key]) for key in first)
    assert all(float(value.abs().sum()) > 0.0 for key, value in first.items() if key.endswith("step"))


def test_the_rate_rises_and_falls(settings: ModelSettings) -> None:
    run = begin(settings)
    assert run.learning_rate(0.0) == pytest.approx(1e-2 / 5)
    run.position.updates = 100
    assert run.learning_rate(0.0) == pytest.approx(1e-2)
    assert run.learning_rate(1.0) == pytest.approx(1e-5)


def test_what_fits_into_the_memory_is_kept_and_the_rest_makes_no_difference(
    settings: ModelSettings, curriculum: Curriculum
) -> None:
    batch = curriculum.batch(2, 4, np.random.default_rng(0))
    particles = batch.targets.shape[1]
    gradients = []
    for kept in (0, 2, 4):
        run = begin(settings)
        run.kept_steps(batch)
        assert run.position.particle_bytes > 0.0
        run.memory_gib = (kept + 0.5) * run.position.particle_bytes * particles / 2**30
        assert run.kept_steps(batch) == kept
        run.model(batch, kept).backward()
        gradients.append([parameter.grad for parameter in run.simulator.parameters()])
    for others in gradients[1:]:
        assert all(torch.equal(one, other) for one, other in zip(gradients[0], others, strict=True))


def test_a_gradient_that_is_not_finite_ends_the_run_before_it_spoils_the_weights(
    settings: ModelSettings, curriculum: Curriculum
) -> None:
    run = begin(settings)
    weights = next(run.simulator.parameters())
    with torch.no_grad():
        weights[0, 0] = torch.nan
    before = {name: value.clone() for name, value in run.simulator.state_dict().items()}
    with pytest.raises(WorkFailed, match="gradient of update 1 is not finite"):
        run.update(curriculum, steps=1, rate=1e-3)
    for name, value in run.simulator.state_dict().items():
        assert torch.equal(value.nan_to_num(), before[name].nan_to_num())


def test_a_run_of_another_model_or_seed_is_not_resumed(settings: ModelSettings, tmp_path: Path) -> None:
    begin(settings).save(tmp_path / "last.safetensors")
    with pytest.raises(InputError, match="settings that the run was begun with"):
        begin(dataclasses.replace(settings, width=8)).resume(tmp_path / "last.safetensors")
    with pytest.raises(InputError, match="seed: expected the seed of the run, 0"):
        Run(Simulator(settings, NORMALISATION), TrainingSettings(), seed=1).resume(tmp_path / "last.safetensors")
    described, parts = run_file.read(tmp_path / "last.safetensors")
    part = tmp_path / "part.safetensors"
    for key in ("seed", "position"):
        run_file.write(part, {name: value for name, value in described.items() if name != key}, parts)
        with pytest.raises(InputError, match=f"{key}: expected a whole run, the key is missing"):
            begin(settings).resume(part)
    run_file.write(part, described, {name: value for name, value in parts.items() if name != "average"})
    with pytest.raises(InputError, match=r"average/.*: expected a whole run, there is no such tensor"):
        begin(settings).resume(part)


def test_a_run_of_wrong_numbers_is_not_resumed(settings: ModelSettings, tmp_path: Path) -> None:
    run, path = begin(settings), tmp_path / "last.safetensors"
    name = next(iter(run.parts()["optimiser"]))
    for change, message in (
        ({name: torch.full_like(run.parts()["optimiser"][name], torch.nan)}, "expected finite numbers"),
        ({name: torch.zeros(3)}, "expected shape"),
        ({"Adam/0/other": torch.zeros(3)}, "expected no such tensor"),
    ):
        run.save(path)
        described, parts = run_file.read(path)
        run_file.write(path, described, {**parts, "optimiser": parts["optimiser"] | change})
        with pytest.raises(InputError, match=message):
            begin(settings).resume(path)
    run_file.write(path, {**described, "position": {"updates": -1}}, parts)
    with pytest.raises(InputError, match="updates: expected a number of at least 0"):
        begin(settings).resume(path)


def test_mixed_precision_trains_by_the_products_of_a_gpu(
    settings: ModelSettings, curriculum: Curriculum, monkeypatch: pytest.MonkeyPatch
) -> None:
    # On a CPU, by the form for other devices: the fused kernels have no other precision.
    monkeypatch.setattr(interaction, "fused_message_sum", message_sum)
    batch = curriculum.batch(2, 3, np.random.default_rng(0))
    losses, gradients = [], []
    for mixed in (False, True):
        run = begin(settings, mixed=mixed)
        # One step keeps its activations, the others are computed again: in the same precision.
        loss = run.model(batch, 1)
        loss.backward()
        losses.append(loss)
        gradients.append(torch.cat([weight.grad.flatten() for weight in run.simulator.parameters()]))
    assert losses[1].dtype == gradients[1].dtype == torch.float32
    assert 0.0 < abs(losses[1] - losses[0]) < 1e-2 * losses[0]
    assert (gradients[1] - gradients[0]).norm() < 0.05 * gradients[0].norm()
