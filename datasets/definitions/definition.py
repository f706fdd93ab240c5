"""Definition: the contents of a dataset, scene by scene, before anything is simulated."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from datasets.errors import require
from datasets.scene import Scene

DEPOSITS = "deposits"
"""Folder of a dataset for the last frames of all particles."""

Stream = np.random.Generator


class Split(StrEnum):
    """The part of a dataset that a trajectory belongs to; also the name of its folder."""

    TRAIN = "train"
    VALID = "valid"
    TEST = "test"


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One trajectory of a dataset, to be simulated."""

    split: Split
    name: str
    """File name without its ending."""
    scene: Scene


@dataclass(frozen=True, kw_only=True)
class Storage:
    """The stored part of a trajectory that is computed more finely than it is learned."""

    cell: float
    """Edge of the cells in which particles are chosen at random [m]."""
    kept: int
    """Number of particles kept in each such cell; they get its total volume (`datasets.definitions.training.thin`)."""
    deposit: bool = False
    """Whether simulations last to the end of their scenes, and their last frames, with all particles, are stored in
    `DEPOSITS` too: what an inversion compares with its target."""


@dataclass(frozen=True, kw_only=True)
class Definition:
    """A family of scenes, numbered from 0, and their split."""

    name: str
    size: int
    """Number of scenes in the whole dataset."""
    split: Callable[[int], Split]
    """Number of a scene -> its split."""
    draw: Callable[[Stream, int], Scene]
    """Random stream and number of a scene -> the scene."""
    stream: Callable[[int], int] = int
    """Number of a scene -> number of its random stream; scenes that share one can be variants of each other."""
    storage: Storage | None = None
    """If given, simulations end at rest unless it says otherwise, and only some particles are stored; else all are."""
    kinds: tuple[str, ...] = ()
    """For a family, the names of its kinds of scenes, in their repeating order."""

    def entries(self, *, seed: int, count: int | None = None) -> tuple[Entry, ...]:
        """The first `count` scenes of the dataset of `seed`, or all. Scene `index` draws from the stream `[seed,
        stream(index)]`: a smaller count is a prefix of a larger one, and no scene depends on another."""
        count = self.size if count is None else count
        require(1 <= count <= self.size, "count", f"1 to {self.size} trajectories of {self.name}", count)
        require(seed >= 0, "seed", "an integer of at least 0", seed)
        draws = ((n, np.random.default_rng([seed, self.stream(n)])) for n in range(count))
        entries = (Entry(split=self.split(n), name=f"{self.name}-{n:04d}", scene=self.draw(rng, n)) for n, rng in draws)
        return tuple(entries)
