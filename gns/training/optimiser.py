"""The optimiser of a training: Muon for matrices, Adam for the rest.

Muon (Jordan et al. 2024, Muon: an optimizer for hidden layers) gives every matrix a step whose singular values are all
about one: the momentum, orthogonalised by Newton and Schulz's iteration. Its length is matched to Adam's (Liu et al.
2025, arXiv 2502.16982, section 2.2), so that both share a learning rate.
"""

from collections.abc import Mapping

import torch
from torch import Tensor, nn

STATES = {"Muon": ("momentum_buffer",), "Adam": ("step", "exp_avg", "exp_avg_sq")}
"""What each of them remembers of a parameter."""


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

    def tensors(self) -> dict[str, Tensor]:
        """What `load_tensors` needs to go on to the bit, by PART/PARAMETER/NAME; zeros before the first step."""
        found = {}
        for part in self.parts:
            for number, weight in enumerate(weight for group in part.param_groups for weight in group["params"]):
                for name in STATES[type(part).__name__]:
                    zero = torch.zeros(()) if name == "step" else torch.zeros_like(weight)
                    found[f"{type(part).__name__}/{number}/{name}"] = part.state.get(weight, {}).get(name, zero)
        return found

    def load_tensors(self, tensors: Mapping[str, Tensor]) -> None:
        """Go on from there."""
        for part in self.parts:
            state: dict[int, dict[str, Tensor]] = {}
            for key, value in tensors.items():
                kind, number, name = key.split("/")
                if kind == type(part).__name__:
                    state.setdefault(int(number), {})[name] = value
            part.load_state_dict({"state": state, "param_groups": part.state_dict()["param_groups"]})
