"""Pictures of the loop's tests are small."""

import pytest

from inverse import pictures


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "RESOLUTION", 40)
