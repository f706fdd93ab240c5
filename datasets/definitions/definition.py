"""Definition: what a dataset consists of, scene by scene, before anything is simulated.

A `family` has kinds of scenes in rounds: every second round has variants of the scenes of the one before, which differ
in a parameter alone: that is what an inversion asks for.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from datasets.definitions.held_out import is_held_out
from datasets.errors import InputError, require
from datasets.scene import Scene

TRIES = 200
"""Draws of a scene that is valid and not held out, before it is an error."""

DEPOSITS = "deposits"
"""Folder of a dataset for the last frames of all particles."""

Stream = np.random.Generator
Kind = Callable[[Stream], Scene]


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
    """What is stored of a trajectory that is computed more finely than it is learned."""

    cell: float
    """Edge of the cells in which particles are chosen at random [m]."""
    kept: int
    """Particles that stay of each such cell; they get the volume of all (`datasets.definitions.training.thin`)."""
    deposit: bool = False
    """Whether simulations last to the end of their scenes, and their last frames, with all particles, are stored in
    `DEPOSITS` too: what an inversion compares with its target."""


@dataclass(frozen=True, kw_only=True)
class Definition:
    """A family of scenes, numbered from 0, and how they are divided."""

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
    """Where given, simulations end when their deposits rest, unless it says otherwise, and some of their particles are
    stored; else all are."""

    def entries(self, *, seed: int, count: int | None = None) -> tuple[Entry, ...]:
        """The first `count` scenes of the dataset of `seed`, all of them where `count` is None.

        Scene `index` draws from the stream `[seed, stream(index)]`: a smaller count is a prefix of a larger one, and no
        scene depends on another.
        """
        count = self.size if count is None else count
        require(1 <= count <= self.size, "count", f"1 to {self.size} trajectories of {self.name}", count)
        require(seed >= 0, "seed", "an integer of at least 0", seed)
        scenes = (self.draw(np.random.default_rng([seed, self.stream(index)]), index) for index in range(count))
        return tuple(
            Entry(split=self.split(index), name=f"{self.name}-{index:04d}", scene=scene)
            for index, scene in enumerate(scenes)
        )


def family(
    name: str, *, kinds: tuple[Kind, ...], variant: Callable[[Stream, Scene], Scene], size: int, storage: Storage
) -> Definition:
    """A scene of each of the `kinds`, then a `variant` of each of these, and so on; drawn again where held out.

    A scene and its variant share a random stream and a split. Of ten scenes of a kind eight are for training, one for
    validation, one for the test.
    """
    count = len(kinds)

    def draw(stream: Stream, index: int) -> Scene:
        kind = kinds[index % count]
        scene = drawn(lambda: kind(stream), kind.__name__)
        if index // count % 2 == 0:
            return scene
        return drawn(lambda: variant(stream, scene), f"variant of {kind.__name__}")

    return Definition(
        name=name,
        size=size,
        split=lambda index: {1: Split.VALID, 2: Split.TEST}.get(index // (2 * count) % 10, Split.TRAIN),
        draw=draw,
        stream=lambda index: index // (2 * count) * count + index % count,
        storage=storage,
    )


def drawn(attempt: Callable[[], Scene], name: str) -> Scene:
    """The first scene that is valid and not held out. Raises RuntimeError where there is none in `TRIES`."""
    for _ in range(TRIES):
        try:
            scene = attempt()
        except InputError:
            continue
        if not is_held_out(scene):
            return scene
    raise RuntimeError(f"no scene of {name} in {TRIES} draws")


def log_uniform(stream: Stream, low: float, high: float) -> float:
    """A number uniform in its logarithm."""
    return float(np.exp(stream.uniform(np.log(low), np.log(high))))


def usually(stream: Stream, usual: Mapping[float, float], low: float, high: float) -> float:
    """A number between two, but that of the first of `usual` whose key, a share of all draws, is above the chance."""
    chance = stream.random()
    given = next((value for share, value in usual.items() if chance < share), None)
    return float(stream.uniform(low, high)) if given is None else given


def flow(stream: Stream, **keys: Any) -> Scene:
    """The scene of these keys with frames 0.02 s apart, long steps and, drawn last, a seed for its initial jitter."""
    return Scene(frame_dt=0.02, step_fraction=0.9, seed=int(stream.integers(2**31)), **keys)
