"""Families of kinds of scenes in rounds: every second round has variants of the scenes of the one before.

A variant differs in a parameter alone: that is what an inversion asks for.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from datasets.definitions.definition import Split
from datasets.definitions.held_out import is_held_out
from datasets.errors import InputError
from datasets.scene import Scene

TRIES = 200
"""Draws of a scene that is valid and not held out, before it is an error."""

Stream = np.random.Generator


@dataclass(frozen=True, kw_only=True)
class Rounds:
    """Which scene of a definition is of which kind, a variant, and in which split."""

    kinds: tuple[Callable[[Stream], Scene], ...]
    """One scene of each makes a round."""
    variant: Callable[[Stream, Scene], Scene]
    """A scene -> the scene with a parameter changed."""

    def is_variant(self, index: int) -> bool:
        """Whether a scene is a variant of the one a round before it."""
        return index // len(self.kinds) % 2 == 1

    def stream(self, index: int) -> int:
        """The random stream of a scene, which it shares with its variant."""
        block, position = divmod(index, 2 * len(self.kinds))
        return block * len(self.kinds) + position % len(self.kinds)

    def split(self, index: int) -> Split:
        """Of ten scenes of a kind eight are for training, one for validation, one for the test."""
        return {1: Split.VALID, 2: Split.TEST}.get(index // (2 * len(self.kinds)) % 10, Split.TRAIN)

    def draw(self, stream: Stream, index: int) -> Scene:
        """A scene of each kind, then a variant of each of these, and so on; drawn again where invalid or held out."""
        kind = self.kinds[index % len(self.kinds)]
        scene = drawn(lambda: kind(stream), kind.__name__)
        if not self.is_variant(index):
            return scene
        return drawn(lambda: self.variant(stream, scene), f"variant of {kind.__name__}")


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
