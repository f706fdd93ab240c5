"""A signal waits for the end of an update, unless it is meant."""

import signal

import pytest

from gns.training.stopping import Stop


def test_a_signal_is_recorded_and_the_work_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter((0.0, 1.0, 5.0))
    monkeypatch.setattr("gns.training.stopping.time.monotonic", lambda: next(times))
    before = signal.getsignal(signal.SIGTERM)
    with Stop().watching() as stop:
        assert not stop.requested
        signal.raise_signal(signal.SIGTERM)
        assert stop.requested
        # The same one, handed on.
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGTERM) is before


def test_what_is_saved_is_broken_off_at_once() -> None:
    with Stop().watching() as stop:
        with pytest.raises(KeyboardInterrupt), stop.at_once():
            signal.raise_signal(signal.SIGTERM)
        # Asked before it began: it does not begin.
        with pytest.raises(KeyboardInterrupt), stop.at_once():
            pytest.fail("began")
