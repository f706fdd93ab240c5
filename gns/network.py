"""Encode, process, decode (Sanchez-Gonzalez et al. 2020), with a look at the background grid in each round."""

import torch
from torch import Tensor, nn

from gns.context import Context
from gns.graph import Graph, mean_envelope_sum
from gns.grid import Stencil
from gns.messages import Interaction
from gns.settings import ModelSettings


def perceptron(inputs: int, outputs: int, settings: ModelSettings) -> nn.Sequential:
    """A network of `hidden_layers` hidden layers."""
    modules: list[nn.Module] = []
    for _ in range(settings.hidden_layers):
        modules += [nn.Linear(inputs, settings.width), nn.SiLU()]
        inputs = settings.width
    return nn.Sequential(*modules, nn.Linear(inputs, outputs))


class Layer(nn.Module):
    """One hop: x_i <- x_i + network(norm(x_i), sum of the messages to i)."""

    def __init__(self, settings: ModelSettings) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(settings.width)
        self.interaction = Interaction(settings.width, settings.dimension)
        self.update = perceptron(2 * settings.width, settings.width, settings)
        self.scale = 1.0 / mean_envelope_sum(settings.radius, settings.point_volume, settings.dimension)

    def forward(self, x: Tensor, graph: Graph) -> Tensor:
        """Latents [N, C] to latents [N, C]."""
        normal = self.norm(x)
        heard = self.scale * self.interaction(normal, graph.edge_index, graph.offsets, graph.envelope)
        return x + torch.as_tensor(self.update(torch.cat((normal, heard), dim=1)))


class Network(nn.Module):
    """Features of the points to one normalised acceleration each."""

    def __init__(self, features: int, settings: ModelSettings) -> None:
        super().__init__()
        self.encoder = perceptron(features, settings.width, settings)
        self.contexts = nn.ModuleList(Context(settings) for _ in range(settings.rounds))
        self.layers = nn.ModuleList(Layer(settings) for _ in range(settings.layers))
        self.norm = nn.LayerNorm(settings.width)
        self.decoder = perceptron(settings.width, settings.dimension, settings)
        # An untrained model is free flight.
        last = self.decoder[-1]
        assert isinstance(last, nn.Linear)
        nn.init.normal_(last.weight, std=1.0e-3)
        nn.init.zeros_(last.bias)

    def forward(self, features: Tensor, graph: Graph, points: Stencil, share: Tensor, around: Tensor) -> Tensor:
        """Features [N, F] to accelerations in units of their standard deviation [N, D].

        share and around: see `gns.context.Context`.
        """
        x = self.encoder(features)
        hops = len(self.layers) // len(self.contexts)
        for turn, context in enumerate(self.contexts):
            x = x + context(x, points, share, around)
            for layer in self.layers[turn * hops : (turn + 1) * hops]:
                x = layer(x, graph)
        return torch.as_tensor(self.decoder(self.norm(x)))
