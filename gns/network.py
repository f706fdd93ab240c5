"""The network: encoder, processor, decoder (Sanchez-Gonzalez et al. 2020).

x = encoder(features)
x = processor(x)            `gns.processor`: grid context and message passing
a, c = decoder(x)           normalised acceleration of each node, and shares of known forces
"""

import math
from collections import OrderedDict

import torch
from torch import Tensor, nn

from gns.features import Inputs
from gns.processor import Processor, mlp
from gns.settings import ModelSettings


class Decoder(nn.Module):
    """Node latents [N, C] to a and c [N, D + K]."""

    def __init__(self, known: int, settings: ModelSettings) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(settings.width)
        self.mlp = mlp(settings.width, settings.dimension + known, settings)
        last = self.mlp[-1]
        assert isinstance(last, nn.Linear)
        # An untrained model is free flight: a standard deviation of 1e-3, from that of torch's own, (3 width)^(-1/2).
        # To draw others would load torch's compiler wherever a model is loaded.
        nn.init.zeros_(last.bias)
        with torch.no_grad():
            last.weight.mul_(1.0e-3 * math.sqrt(3.0 * settings.width))

    def forward(self, x: Tensor) -> Tensor:
        """[N, C] to [N, D + K]."""
        return torch.as_tensor(self.mlp(self.norm(x)))


class Network(nn.Module):
    """Features of the nodes to normalised accelerations and the shares of known forces."""

    def __init__(self, features: int, known: int, settings: ModelSettings) -> None:
        """features: columns F of the nodes; known: number K of known forces."""
        super().__init__()
        self.half_precision = False
        """Whether products before the decoder are in bfloat16, as a training has them where that is faster."""
        # Its weights are `encoder.mlp.0.weight` and so on in the files of models.
        self.encoder = nn.Sequential(OrderedDict(mlp=mlp(features, settings.width, settings)))
        self.processor = Processor(settings)
        self.decoder = Decoder(known, settings)

    def forward(self, given: Inputs) -> Tensor:
        """Features of the particles to a and c [N, D + K]."""
        features = given.features
        # Gradients of the steps of a rollout are summed in single precision: a weight is converted anew in each step.
        with torch.autocast(features.device.type, torch.bfloat16, enabled=self.half_precision, cache_enabled=False):
            x = self.encoder(features).to(features.dtype)
            x = self.processor(x, given)
        return torch.as_tensor(self.decoder(x))
