"""The log of a training: rows, and the removal of rows after the checkpoint that it continues from."""

from pathlib import Path

import pytest

from gns.training.log import Log


def test_a_log_goes_on_where_it_was_saved(tmp_path: Path) -> None:
    log = Log(tmp_path, size=0, updates=0, tensorboard=False)
    log.row({"updates": 3, "loss": 0.5})
    saved = log.size
    log.row({"updates": 6, "loss": 0.4})
    again = Log(tmp_path, size=saved, updates=3, tensorboard=False)
    again.row({"updates": 6, "loss": 0.3})
    assert (tmp_path / "log.csv").read_text() == "updates,loss\n3,0.5\n6,0.3\n"
    # A run from the start forgets the log of another.
    Log(tmp_path, size=0, updates=0, tensorboard=False)
    assert (tmp_path / "log.csv").read_text() == ""
    assert not (tmp_path / "tensorboard").exists()


def test_tensorboard_gets_every_update_and_every_validation(tmp_path: Path) -> None:
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    log = Log(tmp_path, size=0, updates=0, tensorboard=True)
    for updates in (1, 2):
        log.update(updates, {"loss": 1.0 / updates, "learning_rate": 1e-3})
    log.row({"minutes": 0.1, "updates": 2, "score": 0.25})
    log.close()
    events = accumulator.EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    assert set(events.Tags()["scalars"]) == {"training/loss", "training/learning_rate", "validation/score"}
    assert [(event.step, event.value) for event in events.Scalars("training/loss")] == [(1, 1.0), (2, 0.5)]
    assert events.Scalars("validation/score")[0].step == 2
