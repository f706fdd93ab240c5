"""Seconds of a step of the GNS beside the textbook's network, over sizes, and of a whole second."""

import copy
import dataclasses
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from pathlib import Path

import torch
from torch import nn
from torch.nn import functional
from tqdm import tqdm

from datasets.library import read_scene
from gns.inference import WEIGHTS, models
from gns.initial import InitialState, initial_state
from gns.model import checkpoint
from gns.model.settings import ModelSettings
from gns.model.simulator import Simulator
from gns.model.state import Conditions, State
from gns.unroll import step_activation_bytes, unroll
from inverse.forward.gns import MEMORY_GIB
from validation.bench.speed.columns import column
from validation.bench.speed.textbook import Textbook, neighbours
from validation.report.memory import extra
from validation.report.timing import Spread, seconds_of, spread, turns

SIZES = {2: (500, 1_000, 3_000, 10_000, 30_000), 3: (1_000, 4_000, 13_000)}
"""Nodes, by dimension."""
QUICK_SIZES = {2: (500, 1_000), 3: (1_000,)}
BATCH = 2
"""Samples of a training step."""
SHORTEST = 0.1
"""What takes less is repeated until it took this long [s]."""
ONCE = 1.0
"""What takes longer [s] is measured once, without a warm-up."""
WARM_UP = 200
"""Nodes of the first step of each network."""
MOST_BYTES = 6.0e9
"""What would take more memory is left out."""
LONGEST = 5.0
"""A step of the textbook's that would take longer [s] is left out."""
PAPER_WIDTH, PAPER_LAYERS = 128, 10
SCENE = "column-tall-42"
PAPER = ModelSettings(cell=0.005, radius=0.015, frames_per_step=1, history=5)
"""The resolution of the paper's code: all 3,200 particles, steps of 2.5 ms, the smaller radius of its inputs."""
LONG_ROLLOUT = 4.0
"""A rollout that takes longer [s] is run once."""


class Kind(StrEnum):
    """Which network."""

    OURS = "ours"
    TEXTBOOK = "textbook"
    PAPER = f"{PAPER_WIDTH} x {PAPER_LAYERS}"


class Measure(StrEnum):
    """What is timed."""

    FORWARD = "forward"
    GRADIENT = "forward and backward"
    TRAINING = f"training step of {BATCH} samples"


@dataclass(frozen=True, kw_only=True)
class Family:
    """One of our models and the textbook's networks of its resolution."""

    name: str
    settings: ModelSettings
    networks: Mapping[Kind, nn.Module]

    def parameters(self, kind: Kind) -> int:
        """Weights of a network."""
        return sum(each.numel() for each in self.networks[kind].parameters())

    @property
    def others(self) -> list[Kind]:
        """The networks that ours is compared with."""
        return [kind for kind in self.networks if kind is not Kind.OURS]


@dataclass(frozen=True, kw_only=True)
class StepCase:
    """One measurement: a network, what is done with it, the nodes of its column."""

    family: str
    kind: Kind
    measure: Measure
    nodes: int


@dataclass(frozen=True, kw_only=True)
class StepCost:
    """Seconds and memory of a case; none where it was left out."""

    seconds: tuple[float, ...] = ()
    """Of a step, in each round."""
    peak: int | None = None
    """Memory above what was held before [bytes], where the system can tell; by it larger cases are left out."""
    left_out: str = ""
    """The expected cost, extrapolated from the next smaller case, of a case that was not run."""

    @property
    def spread(self) -> Spread:
        """Of the seconds of a case that was run."""
        return spread(self.seconds)


Costs = Mapping[StepCase, StepCost]


def family(name: str, simulator: Simulator) -> Family:
    """A model and the textbook's networks: of its own width, layers and hidden layers, and of the paper's."""
    settings = simulator.settings

    def textbook(width: int, layers: int, hidden_layers: int) -> Textbook:
        return Textbook(
            dimension=settings.dimension,
            radius=settings.radius,
            history=settings.history,
            width=width,
            layers=layers,
            hidden_layers=hidden_layers,
        )

    networks: dict[Kind, nn.Module] = {
        Kind.OURS: simulator,
        Kind.TEXTBOOK: textbook(settings.width, settings.layers, settings.mlp_layers),
        Kind.PAPER: textbook(PAPER_WIDTH, PAPER_LAYERS, 2),
    }
    return Family(name=name, settings=settings, networks=networks)


def families(folder: Path = WEIGHTS) -> list[Family]:
    """Every model in `folder`; with the paper's network only where resolution and history are new."""
    found, known = [], set()
    for path in models(folder):
        each = family(path.stem, checkpoint.load(path).simulator)
        key = (each.settings.dimension, each.settings.radius, each.settings.particle_volume, each.settings.history)
        networks = {kind: net for kind, net in each.networks.items() if kind is not Kind.PAPER or key not in known}
        found.append(dataclasses.replace(each, networks=networks))
        known.add(key)
    return found


def step(network: nn.Module, state: State, conditions: Conditions, measure: Measure) -> Callable[[], None]:
    """What is timed: one step from `state`.

    The gradient is that of a step in the middle of a rollout, whose state depends on the unknown too; the weights are
    frozen. A training step changes all weights, by Adam.
    """
    if measure is Measure.TRAINING:
        trained = copy.deepcopy(network).requires_grad_(True)
        optimiser = torch.optim.Adam(trained.parameters(), lr=1.0e-9)

        def train() -> None:
            moved = trained(state, conditions).positions - state.positions
            optimiser.zero_grad()
            functional.mse_loss(moved, torch.zeros_like(moved)).backward()  # type: ignore[no-untyped-call]
            optimiser.step()

        return train
    frozen = network.requires_grad_(False)

    def forward() -> None:
        with torch.no_grad():
            frozen(state, conditions)

    def gradient() -> None:
        inside = State(
            positions=state.positions.clone().requires_grad_(),
            displacements=state.displacements.clone().requires_grad_(),
        )
        unknown = dataclasses.replace(conditions, friction=conditions.friction.clone().requires_grad_())
        frozen(inside, unknown).positions[:, 0].mean().backward()

    return forward if measure is Measure.FORWARD else gradient


def step_of(each: Family, case: StepCase) -> Callable[[], None]:
    """The step of a case, on its column."""
    samples = BATCH if case.measure is Measure.TRAINING else 1
    return step(each.networks[case.kind], *column(each.settings, case.nodes, samples=samples), case.measure)


def mean_seconds(action: Callable[[], None]) -> float:
    """Seconds of `action`, the mean of as many as last `SHORTEST`."""
    began, count = time.perf_counter(), 0
    while True:
        action()
        count += 1
        elapsed = time.perf_counter() - began
        if elapsed >= SHORTEST:
            return elapsed / count


def edges(settings: ModelSettings, nodes: int) -> int:
    """Directed edges of the graph of a column."""
    return len(neighbours(column(settings, nodes)[0].positions, settings.radius)[0])


def measured(
    models: Sequence[Family], rounds: int, sizes: Mapping[int, Sequence[int]] = SIZES
) -> dict[StepCase, StepCost]:
    """All cases, those of up to `ONCE` seconds in turn in `rounds` rounds.

    A case that is expected to take more than `MOST_BYTES`, or of the textbook's more than `LONGEST` [s], is left out.
    """
    costs: dict[StepCase, StepCost] = {}
    again: dict[StepCase, Callable[[], float]] = {}
    variants = [(each, kind, measure) for each in models for kind in each.networks for measure in Measure]
    for each, kind, measure in tqdm(variants, desc="first round", unit="column", dynamic_ncols=True):
        # What is compiled at the first call is no part of a step.
        step_of(each, StepCase(family=each.name, kind=kind, measure=measure, nodes=WARM_UP))()
        last: tuple[int, StepCost] | None = None
        for nodes in sizes[each.settings.dimension]:
            case = StepCase(family=each.name, kind=kind, measure=measure, nodes=nodes)
            limit = math.inf if kind is Kind.OURS else LONGEST
            expected = too_costly(nodes / last[0], last[1], limit) if last else ""
            if expected:
                costs[case] = StepCost(left_out=expected)
                continue
            action = step_of(each, case)
            began = time.perf_counter()
            peak = extra(action)
            costs[case] = StepCost(seconds=(time.perf_counter() - began,), peak=peak)
            last = (nodes, costs[case])
            if costs[case].seconds[0] <= ONCE:
                again[case] = partial(mean_seconds, action)
    for case, seconds in turns(again, rounds, "seconds per step").items():
        costs[case] = dataclasses.replace(costs[case], seconds=tuple(seconds))
    return costs


def too_costly(factor: float, smaller: StepCost, longest: float) -> str:
    """The expected cost of a case `factor` times as large as `smaller` where it is too much; else empty."""
    peak, seconds = factor * (smaller.peak or 0), factor * smaller.seconds[0]
    if peak > MOST_BYTES:
        return f"~{peak / 1.0e9:.0f} GB"
    return f"~{seconds:.0f} s" if seconds > longest else ""


def ratio(these: StepCost, those: StepCost) -> Spread:
    """Seconds of these over those: round by round, or over the others' median where these were measured once."""
    if len(these.seconds) == len(those.seconds):
        return spread(a / b for a, b in zip(these.seconds, those.seconds, strict=True))
    return spread(a / those.spread.median for a in these.seconds)


@dataclass(frozen=True, kw_only=True)
class RolloutCost:
    """One second of the paper's tall column."""

    name: str
    nodes: int
    steps: int
    run: bool
    """Whether all steps were run; else it is one step's seconds times the steps."""
    forward: Spread
    """[s]."""
    gradient: Spread
    """Forward and backward [s]."""


def initial(settings: ModelSettings) -> InitialState:
    """The tall column at rest, at a model's resolution."""
    return initial_state(read_scene(SCENE), settings)


def rollout_cost(name: str, simulator: Simulator, rounds: int) -> RolloutCost:
    """Of one of our models, every step run."""
    start = initial(simulator.settings)
    simulator.requires_grad_(False)
    kept = int(MEMORY_GIB * 2**30 / step_activation_bytes(simulator, start.state, start.conditions))

    def forward() -> None:
        with torch.no_grad():
            unroll(simulator, start.state, start.conditions, start.steps)

    def gradient() -> None:
        friction = start.conditions.friction.clone().requires_grad_()
        conditions = dataclasses.replace(start.conditions, friction=friction)
        moved = unroll(simulator, start.state, conditions, start.steps, kept_steps=min(kept, start.steps))
        moved[-1, :, 0].mean().backward()  # type: ignore[no-untyped-call]
        assert friction.grad is not None
        assert math.isfinite(float(friction.grad.sum()))

    first = seconds_of(forward)
    gradient()
    work = {"forward": partial(seconds_of, forward), "gradient": partial(seconds_of, gradient)}
    found = turns(work, 1 if first > LONG_ROLLOUT else rounds, f"one second, {name}")
    return RolloutCost(
        name=name,
        nodes=len(start.indices),
        steps=start.steps,
        run=True,
        forward=spread(found["forward"]),
        gradient=spread(found["gradient"]),
    )


def extrapolated_cost(name: str, network: nn.Module, settings: ModelSettings) -> RolloutCost:
    """Of the textbook's network: seconds of a step times the steps.

    The gradient is checkpointed at every step, as the paper's: a step is run forward, and later once more with its
    backward pass.
    """
    start = initial(settings)
    state, conditions = start.state.over(start.conditions.units.length), start.conditions.in_model_units()
    forward = step(network, state, conditions, Measure.FORWARD)
    gradient = step(network, state, conditions, Measure.GRADIENT)
    forward()
    one = mean_seconds(forward)
    gradient()
    both = mean_seconds(gradient)
    return RolloutCost(
        name=name,
        nodes=len(start.indices),
        steps=start.steps,
        run=False,
        forward=spread([start.steps * one]),
        gradient=spread([start.steps * (one + both)]),
    )


def rollout_costs(models: Sequence[Family], rounds: int) -> list[RolloutCost]:
    """Our 2D models, the textbook's networks of their size, and the paper's network at the paper's resolution."""
    found = []
    for each in models:
        simulator = each.networks[Kind.OURS]
        if each.settings.dimension == 2 and isinstance(simulator, Simulator):
            found.append(rollout_cost(each.name, simulator, rounds))
            textbook = f"textbook of the size of {each.name}"
            found.append(extrapolated_cost(textbook, each.networks[Kind.TEXTBOOK], each.settings))
    paper = Textbook(dimension=2, radius=PAPER.radius, history=PAPER.history)
    return [*found, extrapolated_cost(f"textbook as in the paper, {Kind.PAPER}", paper, PAPER)]
