"""Thinning keeps the volume, and different points each time."""

import numpy as np
import pytest

from datasets.training.thinning import thin


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("kept", [1, 2, 5])
def test_every_cell_keeps_its_volume(dimension: int, kept: int) -> None:
    positions = np.random.default_rng(0).uniform(-0.1, 0.3, (500, dimension))
    thinned = thin(positions, 2.0, cell=0.1, kept=kept, rng=np.random.default_rng(1))
    cells = np.floor(positions / 0.1).astype(int)
    stays = cells[thinned.indices]
    assert len(np.unique(thinned.indices)) == len(thinned.indices)
    for cell, count in zip(*np.unique(cells, axis=0, return_counts=True), strict=True):
        chosen = (stays == cell).all(axis=1)
        assert chosen.sum() == min(count, kept)
        assert thinned.volumes[chosen].sum() == pytest.approx(2.0 * count)
