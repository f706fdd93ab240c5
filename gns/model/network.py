"""Encode, process, decode (Sanchez-Gonzalez et al. 2020), with a look at the background grid in each round."""

import torch
from torch import Tensor, nn

from gns.kernels.linear import Linear
from gns.kernels.messages import Interaction
from gns.model.context import Context
from gns.model.graph import Graph, mean_envelope_sum
from gns.model.grid import Stencil
from gns.model.settings import ModelSettings


def perceptron(inputs: int, outputs: int, settings: ModelSettings) -> nn.Sequential:
    """A network of `hidden_layers` hidden layers."""
    modules: list[nn.Module] = []
    for _ in range(settings.hidden_layers):
        modules += [Linear(inputs, settings.width), nn.SiLU()]
        inputs = settings.width
    return nn.Sequential(*modules, Linear(inputs, outputs))


class Layer(nn.Module):
    """One hop: x_i <- x_i + network(y_i, sum of the messages to i), where y_i = norm(x_i).

    With FiLM y_i = (1 + g_i) norm(x_i) + b_i, scale g and shift b linear in the material (Perez et al., FiLM: visual
    reasoning with a general conditioning layer, AAAI 2018).
    """

    def __init__(self, settings: ModelSettings, material: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(settings.width)
        self.interaction = Interaction(settings.width, settings.dimension)
        self.update = perceptron(2 * settings.width, settings.width, settings)
        self.film = Linear(material, 2 * settings.width) if settings.film else None
        if self.film is not None:
            nn.init.zeros_(self.film.weight)
            nn.init.zeros_(self.film.bias)
        self.scale = 1.0 / mean_envelope_sum(settings.radius, settings.point_volume, settings.dimension)

    def forward(self, x: Tensor, material: Tensor, graph: Graph) -> Tensor:
        """Latents [N, C] to latents [N, C]; material: [N, M]."""
        normal = self.norm(x)
        if self.film is not None:
            scale, shift = self.film(material).chunk(2, dim=1)
            normal = torch.addcmul(normal + shift, normal, scale)
        heard = self.scale * self.interaction(normal, graph)
        return x + torch.as_tensor(self.update(torch.cat((normal, heard), dim=1)))


class Network(nn.Module):
    """Features of the points to one normalised acceleration each."""

    def __init__(self, features: int, material: int, settings: ModelSettings) -> None:
        super().__init__()
        self.encoder = perceptron(features, settings.width, settings)
        self.contexts = nn.ModuleList(Context(settings) for _ in range(settings.rounds))
        self.layers = nn.ModuleList(Layer(settings, material) for _ in range(settings.layers))
        self.norm = nn.LayerNorm(settings.width)
        self.decoder = perceptron(settings.width, settings.dimension, settings)
        # An untrained model is free flight.
        last = self.decoder[-1]
        assert isinstance(last, Linear)
        nn.init.normal_(last.weight, std=1.0e-3)
        nn.init.zeros_(last.bias)

    def forward(
        self, features: Tensor, material: Tensor, graph: Graph, points: Stencil, share: Tensor, around: Tensor
    ) -> Tensor:
        """Features [N, F] to accelerations in units of their standard deviation [N, D].

        material: [N, M]; share and around: see `gns.model.context.Context`.
        """
        x = self.encoder(features)
        hops = len(self.layers) // len(self.contexts)
        for turn, context in enumerate(self.contexts):
            x = x + context(x, points, share, around)
            for layer in self.layers[turn * hops : (turn + 1) * hops]:
                x = layer(x, material, graph)
        return torch.as_tensor(self.decoder(self.norm(x)))
