"""The network: encoder, processor, decoder (Sanchez-Gonzalez et al. 2020), with a background grid beside the messages.

    x = encoder(features)
    x = processor(x)            rounds of: grid context, then message-passing steps
    a, c = decoder(x)           normalised acceleration of each node, and coefficients of known forces

A message-passing step carries information over one cutoff radius, while a step of the model spans many. Therefore
latents are scattered to a coarse grid around the material, convolved there, and interpolated back to the nodes of the
graph: a receptive field as wide as the flow at little extra cost (the idea of CoRGI, arXiv 2511.22938).
"""

import math
from collections import OrderedDict

import torch
from torch import Tensor, nn
from torch.nn import functional

from gns.network.features import CONSTANTS, EDGES, Inputs
from gns.network.graph import Graph, mean_envelope_sum
from gns.network.messages import messages
from gns.settings import ModelSettings
from gns.surroundings.grid import CHANNELS, Stencil
from gns.surroundings.state import columns


def mlp(inputs: int, outputs: int, settings: ModelSettings) -> nn.Sequential:
    """A multilayer perceptron of `mlp_layers` hidden layers of `width`, with SiLU between."""
    modules: list[nn.Module] = []
    for _ in range(settings.mlp_layers):
        modules += [nn.Linear(inputs, settings.width), nn.SiLU()]
        inputs = settings.width
    return nn.Sequential(*modules, nn.Linear(inputs, outputs))


class Interaction(nn.Module):
    """m [N, C] from node latents x [N, C] and a graph, by the messages of Sanchez-Gonzalez et al. 2020, made cheaper.
    Their message is a network of [x_i, x_j, e_ij]. Its first layer splits into W_i x_i + W_j x_j + W_e e_ij, two of
    which are per node; its last layer is linear and follows the sum over the neighbours, in the update of the node.
    Only the sum in `gns.network.messages` is left per edge; edges carry no latents."""

    def __init__(self, settings: ModelSettings) -> None:
        super().__init__()
        width = settings.width
        self.from_receiver = nn.Linear(width, width)
        self.from_sender = nn.Linear(width, width, bias=False)
        # Model files call its weight `from_offset.weight`.
        self.from_offset = nn.Linear(columns(EDGES, settings), width, bias=False)

    def forward(self, x: Tensor, graph: Graph) -> Tensor:
        return messages(self.from_receiver(x), self.from_sender(x), self.from_offset.weight.T, graph)


class MessagePassingStep(nn.Module):
    """One step: x_i <- x_i + mlp(y_i, sum of the messages to i), where y_i = (1 + g_i) norm(x_i) + b_i. Scale g and
    shift b are linear in the constant features of a particle (FiLM: Perez et al., AAAI 2018)."""

    def __init__(self, settings: ModelSettings) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(settings.width)
        self.interaction = Interaction(settings)
        self.update = mlp(2 * settings.width, settings.width, settings)
        self.film = nn.Linear(columns(CONSTANTS, settings), 2 * settings.width)
        nn.init.zeros_(self.film.weight)
        nn.init.zeros_(self.film.bias)
        self.scale = 1.0 / mean_envelope_sum(settings.radius, settings.particle_volume, settings.dimension)

    def forward(self, x: Tensor, constant: Tensor, graph: Graph) -> Tensor:
        """Latents [N, C] to latents [N, C]; constant: [N, M]."""
        normal = self.norm(x)
        scale, shift = self.film(constant).chunk(2, dim=1)
        normal = torch.addcmul(normal + shift, normal, scale)
        total = torch.cat((normal, self.scale * self.interaction(normal, graph)), dim=1)
        return x + torch.as_tensor(self.update(total))


class Convolution(nn.Conv2d):
    """Kernels of 3 nodes along each axis, `dilation` nodes apart, channels last, zero-padded. In 3D it works by planes
    that also carry the channels of their neighbours: on a CPU torch's own takes five times as long."""

    def __init__(self, channels: int, dimension: int, dilation: int) -> None:
        super().__init__(3 ** (dimension - 2) * channels, channels, 3, padding=dilation, dilation=dilation)

    def forward(self, field: Tensor) -> Tensor:
        """[B, X, Y, C] to the same shape, in 3D [B, X, Y, Z, C]."""
        if field.dim() == 4:
            return super().forward(field.movedim(-1, 1)).movedim(1, -1)
        width, count = self.dilation[0], field.shape[1]
        padded = functional.pad(field, (0, 0, 0, 0, 0, 0, width, width))
        beside = torch.cat([padded[:, index * width : index * width + count] for index in range(3)], dim=-1)
        return super().forward(beside.flatten(0, 1).movedim(-1, 1)).movedim(1, -1).reshape(field.shape)


class GridContext(nn.Module):
    """Increment of the graph nodes' latents [N, C] by convolutions on the grid."""

    def __init__(self, settings: ModelSettings) -> None:
        super().__init__()
        count = settings.grid_channels
        self.to_grid = nn.Linear(settings.width, count)
        self.mix = nn.Linear(count + columns(CHANNELS, settings), count)
        self.layers = nn.ModuleList(Convolution(count, settings.dimension, 2**i) for i in range(settings.grid_layers))
        self.from_grid = nn.Linear(count, settings.width)

    def forward(self, x: Tensor, given: Inputs) -> Tensor:
        """Scatter, convolve, interpolate; x: latents [N, C]."""
        stencil = given.stencil
        inputs = torch.cat((stencil.scatter(self.to_grid(x) * given.fraction), given.nodes), dim=1)
        field = masked(functional.silu(self.mix(inputs)).view(stencil.samples, *stencil.shape, -1), stencil)
        for layer in self.layers:
            field = masked(field + functional.silu(layer(field)), stencil)
        return torch.as_tensor(self.from_grid(stencil.gather(field.reshape(-1, field.shape[-1]))))


def masked(field: Tensor, stencil: Stencil) -> Tensor:
    """The field, zero where a sample alone would have no nodes: a result does not depend on the other samples."""
    return field if stencil.own is None else field * stencil.own


class Processor(nn.Module):
    """Rounds of a grid context, each followed by an equal share of the message-passing steps."""

    def __init__(self, settings: ModelSettings) -> None:
        super().__init__()
        self.contexts = nn.ModuleList(GridContext(settings) for _ in range(settings.rounds))
        self.steps = nn.ModuleList(MessagePassingStep(settings) for _ in range(settings.layers))

    def forward(self, x: Tensor, given: Inputs) -> Tensor:
        per_round = len(self.steps) // len(self.contexts)
        for index, context in enumerate(self.contexts):
            x = x + context(x, given)
            for step in self.steps[index * per_round : (index + 1) * per_round]:
                x = step(x, given.constant, given.graph)
        return x


class Network(nn.Module):
    """Features of the nodes to normalised accelerations and the coefficients of known forces."""

    def __init__(self, features: int, known: int, settings: ModelSettings) -> None:
        """features: columns F of the nodes; known: number K of known forces."""
        super().__init__()
        self.half_precision = False
        """Whether products before the decoder are in bfloat16, as in training if that is faster."""
        # Model files call its weights `encoder.mlp.0.weight` and so on.
        self.encoder = nn.Sequential(OrderedDict(mlp=mlp(features, settings.width, settings)))
        self.processor = Processor(settings)
        decoder = mlp(settings.width, settings.dimension + known, settings)
        self.decoder = nn.Sequential(OrderedDict(norm=nn.LayerNorm(settings.width), mlp=decoder))
        last = decoder[-1]
        assert isinstance(last, nn.Linear)
        # An untrained model is free flight: torch's weights, of standard deviation (3 width)^(-1/2), scaled to 1e-3.
        # Drawing others would load torch's compiler wherever a model is loaded.
        nn.init.zeros_(last.bias)
        with torch.no_grad():
            last.weight.mul_(1.0e-3 * math.sqrt(3.0 * settings.width))

    def forward(self, given: Inputs) -> Tensor:
        """Features of the particles to a and c [N, D + K]."""
        features = given.features
        # A weight is converted anew in each step, so that gradients of a rollout's steps sum in single precision.
        with torch.autocast(features.device.type, torch.bfloat16, enabled=self.half_precision, cache_enabled=False):
            x = self.encoder(features).to(features.dtype)
            x = self.processor(x, given)
        return torch.as_tensor(self.decoder(x))
