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


def test_points_of_different_volumes_keep_the_volume_of_each_cell() -> None:
    stream = np.random.default_rng(0)
    positions, volumes = stream.random((300, 2)), stream.uniform(1.0, 5.0, 300)
    thinned = thin(positions, volumes, cell=0.1, kept=2, rng=np.random.default_rng(1))
    cells = np.floor(positions / 0.1).astype(int)
    for cell in np.unique(cells, axis=0):
        inside = (cells == cell).all(axis=1)
        kept = inside[thinned.indices]
        assert kept.sum() == min(2, inside.sum())
        assert thinned.volumes[kept].sum() == pytest.approx(volumes[inside].sum(), rel=1e-6)


def test_the_stream_chooses_the_points() -> None:
    positions = np.random.default_rng(0).random((400, 2))
    one, same, other = (thin(positions, 1.0, cell=0.1, kept=1, rng=np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(one.indices, same.indices)
    assert not np.array_equal(one.indices, other.indices)
    assert (np.diff(one.indices) > 0).all()
