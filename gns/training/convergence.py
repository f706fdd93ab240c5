"""Whether a training was long enough: its updates against a shipped model's, and whether its score still improved."""

from collections.abc import Mapping, Sequence
from typing import Any

SHORT = 0.25
"""Below this share of a shipped model's updates a training is called too short."""
FAR_TOO_SHORT = 0.05
"""Below this share no answer should rest on its model."""
STILL_FALLING = 0.01
"""Relative improvement of the score by the last validation that counts as falling."""


def total_updates(provenance: Mapping[str, Any]) -> int:
    """Updates of the weights in all: of a training and of those that it began with."""
    begin = provenance.get("begin")
    return int((provenance.get("log") or {}).get("updates", 0)) + (total_updates(begin) if begin else 0)


def summary(updates: int, reference: int, name: str, scores: Sequence[float] = ()) -> str:
    """A line on the length of a training.

    updates: made in all; reference: those of the shipped model `name`; scores: of the validations, in order.
    """
    share = updates / reference
    text = f"{updates} updates in all, {100.0 * share:.3g} % of those of {name} ({reference})"
    best = min(scores[:-1], default=0.0)
    falling = len(scores) > 1 and scores[-1] < (1.0 - STILL_FALLING) * best
    if falling:
        text += f"; the last validation improved the score by {100.0 * (1.0 - scores[-1] / best):.2g} %"
    if share < SHORT or falling:
        text += ": far too short, no answer should rest on this model" if share < FAR_TOO_SHORT else ": train longer"
    return text
