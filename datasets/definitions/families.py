"""Families of kinds of scenes in rounds: every second round has variants of the scenes of the one before.

A variant differs in a parameter alone: that is what an inversion asks for.
"""

from collections.abc import Callable

import numpy as np

from datasets.definitions.definition import Definition, Split, Storage
from datasets.definitions.held_out import is_held_out
from datasets.errors import InputError
from datasets.scene import Scene

TRIES = 200
"""Draws of a scene that is valid and not held out, before it is an error."""

Stream = np.random.Generator


def family(
    name: str,
    *,
    kinds: tuple[Callable[[Stream], Scene], ...],
    variant: Callable[[Stream, Scene], Scene],
    size: int,
    connectivity_radius: float,
    storage: Storage,
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
        connectivity_radius=connectivity_radius,
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


def jitter_seed(stream: Stream) -> int:
    """A seed for the initial jitter of one scene."""
    return int(stream.integers(2**31))
