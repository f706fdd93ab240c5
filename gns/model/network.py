"""Encoder, processor, decoder (Sanchez-Gonzalez et al. 2020), with a background grid beside the messages.

x = encoder(features)
x = processor(x)            rounds of: grid context, then message-passing steps
h = decoder(x)
a, c = decoder.last(h)      normalised acceleration of each node, and shares of known ones
"""

import torch
from torch import Tensor, nn

from gns.model.context import GridContext
from gns.model.graph import Graph, mean_envelope_sum
from gns.model.grid import Stencil
from gns.model.interaction import Interaction
from gns.model.settings import ModelSettings


def mlp(inputs: int, outputs: int, settings: ModelSettings) -> nn.Sequential:
    """A multilayer perceptron of `mlp_layers` hidden layers of `width`, with SiLU between."""
    modules: list[nn.Module] = []
    for _ in range(settings.mlp_layers):
        modules += [nn.Linear(inputs, settings.width), nn.SiLU()]
        inputs = settings.width
    return nn.Sequential(*modules, nn.Linear(inputs, outputs))


class Encoder(nn.Module):
    """Node features [N, F] to node latents [N, C]."""

    def __init__(self, features: int, settings: ModelSettings) -> None:
        super().__init__()
        self.mlp = mlp(features, settings.width, settings)

    def forward(self, features: Tensor) -> Tensor:
        """[N, F] to [N, C]."""
        return torch.as_tensor(self.mlp(features))


class MessagePassingStep(nn.Module):
    """One step: x_i <- x_i + mlp(y_i, sum of the messages to i), where y_i = (1 + g_i) norm(x_i) + b_i.

    Scale g and shift b are linear in what is constant for a particle (FiLM: Perez et al., visual reasoning with a
    general conditioning layer, AAAI 2018).
    """

    def __init__(self, settings: ModelSettings, constant: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(settings.width)
        self.interaction = Interaction(settings.width, settings.dimension)
        self.update = mlp(2 * settings.width, settings.width, settings)
        self.film = nn.Linear(constant, 2 * settings.width)
        nn.init.zeros_(self.film.weight)
        nn.init.zeros_(self.film.bias)
        self.scale = 1.0 / mean_envelope_sum(settings.radius, settings.particle_volume, settings.dimension)

    def forward(self, x: Tensor, constant: Tensor, graph: Graph) -> Tensor:
        """Latents [N, C] to latents [N, C]; constant: [N, M]."""
        normal = self.norm(x)
        scale, shift = self.film(constant).chunk(2, dim=1)
        normal = torch.addcmul(normal + shift, normal, scale)
        messages = self.scale * self.interaction(normal, graph)
        return x + torch.as_tensor(self.update(torch.cat((normal, messages), dim=1)))


class Processor(nn.Module):
    """Rounds of a grid context, each followed by an equal share of the message-passing steps."""

    def __init__(self, settings: ModelSettings, constant: int) -> None:
        super().__init__()
        self.contexts = nn.ModuleList(GridContext(settings) for _ in range(settings.rounds))
        self.steps = nn.ModuleList(MessagePassingStep(settings, constant) for _ in range(settings.layers))

    def forward(
        self, x: Tensor, constant: Tensor, graph: Graph, stencil: Stencil, fraction: Tensor, nodes: Tensor
    ) -> Tensor:
        """Latents [N, C] to latents [N, C]; for the other arguments see `Network`."""
        per_round = len(self.steps) // len(self.contexts)
        for index, context in enumerate(self.contexts):
            x = x + context(x, stencil, fraction, nodes)
            for step in self.steps[index * per_round : (index + 1) * per_round]:
                x = step(x, constant, graph)
        return x


class Decoder(nn.Module):
    """Node latents [N, C] to h, the inputs of its `last` layer [N, H], and these to a and c [N, D + K]."""

    def __init__(self, known: int, settings: ModelSettings) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(settings.width)
        self.mlp = mlp(settings.width, settings.dimension + known, settings)
        # An untrained model is free flight.
        nn.init.normal_(self.last.weight, std=1.0e-3)
        nn.init.zeros_(self.last.bias)

    @property
    def last(self) -> nn.Linear:
        """The last layer, in which the accelerations are linear."""
        layer = self.mlp[-1]
        assert isinstance(layer, nn.Linear)
        return layer

    def forward(self, x: Tensor) -> Tensor:
        """Latents [N, C] to the inputs of the last layer [N, H]."""
        return torch.as_tensor(self.mlp[:-1](self.norm(x)))


class Network(nn.Module):
    """Features of the nodes to the inputs of the decoder's last layer."""

    def __init__(self, features: int, constant: int, known: int, settings: ModelSettings) -> None:
        super().__init__()
        self.encoder = Encoder(features, settings)
        self.processor = Processor(settings, constant)
        self.decoder = Decoder(known, settings)

    def forward(
        self, features: Tensor, constant: Tensor, graph: Graph, stencil: Stencil, fraction: Tensor, nodes: Tensor
    ) -> Tensor:
        """Features [N, F] to the inputs of the decoder's last layer [N, H].

        constant: [N, M]; stencil, fraction, nodes: see `gns.model.context.GridContext`.
        """
        x = self.encoder(features)
        x = self.processor(x, constant, graph, stencil, fraction, nodes)
        return torch.as_tensor(self.decoder(x))
