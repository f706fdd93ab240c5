"""Training: samples of trajectories, the losses, the loop that lowers them; `dataset`, for a network of one's own."""

from typing import TYPE_CHECKING

from datasets import lazily

if TYPE_CHECKING:
    from gns.training.graphs import dataset

__all__ = ["dataset"]

__getattr__, __dir__ = lazily("gns.training", {"dataset": "gns.training.graphs"})
