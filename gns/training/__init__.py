"""Training: samples of trajectories, losses, the loop that lowers them; `dataset` serves a user's own network."""

from typing import TYPE_CHECKING

from datasets import lazily

if TYPE_CHECKING:
    from gns.training.graphs import dataset

__all__ = ["dataset"]

__getattr__, __dir__ = lazily("gns.training", {"dataset": "gns.training.graphs"})
