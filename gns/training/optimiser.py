"""The optimiser of a training: Muon for matrices, Adam for the rest.

Muon (Jordan et al. 2024, Muon: an optimizer for hidden layers) gives every matrix a step whose singular values are all
about one: the momentum, orthogonalised by Newton and Schulz's iteration. Its length is matched to Adam's (Liu et al.
2025, arXiv 2502.16982, section 2.2), so that both share a learning rate.
"""

from collections.abc import Mapping
from typing import Any

import torch
from torch import nn


class Optimiser:
    """Muon and Adam over the parameters of a model."""

    def __init__(self, model: nn.Module, rate: float) -> None:
        matrices = [weight for weight in model.parameters() if weight.dim() == 2]
        others = [weight for weight in model.parameters() if weight.dim() != 2]
        self.parts: tuple[torch.optim.Optimizer, ...] = (
            torch.optim.Muon(matrices, lr=rate, weight_decay=0.0, adjust_lr_fn="match_rms_adamw"),
            torch.optim.Adam(others, lr=rate),
        )

    def zero_grad(self) -> None:
        """Forget the gradients."""
        for part in self.parts:
            part.zero_grad()

    def step(self, rate: float) -> None:
        """One step along the gradients at a learning rate."""
        for part in self.parts:
            for group in part.param_groups:
                group["lr"] = rate
            part.step()

    def state_dict(self) -> dict[str, Any]:
        """What `load_state_dict` needs to go on to the bit."""
        return {type(part).__name__: part.state_dict() for part in self.parts}

    def load_state_dict(self, content: Mapping[str, Any]) -> None:
        """Raises KeyError or ValueError where `content` is of another model."""
        for part in self.parts:
            part.load_state_dict(content[type(part).__name__])
