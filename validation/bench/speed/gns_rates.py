"""Seconds and memory of a step of the graph network simulator, beside the textbook's network, over sizes."""

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

import gns
from gns.model import checkpoint
from gns.model.settings import ModelSettings
from gns.model.simulator import Normalisation, Simulator
from gns.model.state import Conditions, State
from validation.bench.speed.columns import dam
from validation.bench.speed.textbook import Textbook, neighbours
from validation.report.memory import extra
from validation.report.timing import Spread, turns

WEIGHTS = Path(gns.__file__).parent / "weights"
SIZES = {2: (500, 1_000, 3_000, 10_000, 30_000), 3: (1_000, 4_000, 13_000)}
"""Points, by dimension."""
BATCH = 2
"""Samples of a training step."""
LEAST = 0.1
"""What takes less is repeated until it took this long [s]."""
ONCE = 1.0
"""What takes longer [s] is measured once, without a warm-up."""
WARM_UP = 200
"""Points of the first step of each network."""
MOST_BYTES = 6.0e9
"""What would take more memory is left out."""
PAPER_WIDTH, PAPER_LAYERS = 128, 10
UNTRAINED = Normalisation(displacement=3.0e-3, acceleration=7.0e-4, friction_mean=0.6, friction_std=0.2)


class Kind(StrEnum):
    """Whose network."""

    OURS = "ours"
    TEXTBOOK = "textbook"
    PAPER = f"{PAPER_WIDTH} x {PAPER_LAYERS}"


class Measure(StrEnum):
    """What is done with it."""

    FORWARD = "forward"
    GRADIENT = "gradient"
    TRAINING = "training"


@dataclass(frozen=True, kw_only=True)
class Family:
    """One of our models and the textbook's networks of its resolution."""

    name: str
    settings: ModelSettings
    networks: Mapping[Kind, nn.Module]

    def parameters(self, kind: Kind) -> int:
        """Weights of a network."""
        return sum(each.numel() for each in self.networks[kind].parameters())


@dataclass(frozen=True, kw_only=True)
class Case:
    """A line of a table and its column."""

    family: str
    kind: Kind
    measure: Measure
    points: int


@dataclass(frozen=True, kw_only=True)
class Cost:
    """What a case takes."""

    seconds: tuple[float, ...]
    """Of a step, in each round."""
    peak: int | None
    """Memory above what was held before [bytes], where the system can tell."""

    @property
    def spread(self) -> Spread:
        """Of the seconds."""
        return Spread.of(self.seconds)


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """Why a case was not run, judged by the next smaller one."""

    reason: str


Costs = Mapping[Case, Cost | LeftOut]


def family(name: str, simulator: Simulator) -> Family:
    """A model and the textbook's networks: of its own width, layers and hidden layers, and of the paper's."""
    settings = simulator.settings

    def textbook(width: int, layers: int, hidden: int) -> Textbook:
        return Textbook(
            dimension=settings.dimension,
            radius=settings.radius,
            history=settings.history,
            width=width,
            layers=layers,
            hidden=hidden,
        )

    return Family(
        name=name,
        settings=settings,
        networks={
            Kind.OURS: simulator,
            Kind.TEXTBOOK: textbook(settings.width, settings.layers, settings.mlp_layers),
            Kind.PAPER: textbook(PAPER_WIDTH, PAPER_LAYERS, 2),
        },
    )


def families(folder: Path = WEIGHTS) -> list[Family]:
    """Every model that ships, and one of 3D with random weights where none ships."""
    files = sorted(folder.glob("*.pt"), key=lambda path: path.stem)
    found = [family(path.stem, checkpoint.load(path).simulator) for path in files]
    if not any(each.settings.dimension == 3 for each in found):
        untrained = Simulator(ModelSettings(dimension=3), UNTRAINED).eval()
        found.append(family("default settings in 3D, untrained", untrained))
    return once(found)


def once(several: Sequence[Family]) -> list[Family]:
    """The families, with the paper's network only where it meets other points or other neighbours than before."""
    kept, met = [], set()
    for each in several:
        place = (each.settings.dimension, each.settings.radius, each.settings.particle_volume, each.settings.history)
        networks = {
            kind: network for kind, network in each.networks.items() if kind is not Kind.PAPER or place not in met
        }
        kept.append(dataclasses.replace(each, networks=networks))
        met.add(place)
    return kept


def work(network: nn.Module, state: State, conditions: Conditions, measure: Measure) -> Callable[[], None]:
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
    if measure is Measure.FORWARD:

        def forward() -> None:
            with torch.no_grad():
                frozen(state, conditions)

        return forward

    def gradient() -> None:
        inside = State(
            positions=state.positions.clone().requires_grad_(),
            displacements=state.displacements.clone().requires_grad_(),
        )
        unknown = dataclasses.replace(conditions, friction=conditions.friction.clone().requires_grad_())
        frozen(inside, unknown).positions[:, 0].mean().backward()

    return gradient


def case_work(each: Family, case: Case) -> Callable[[], None]:
    """The work of a case, on its dam."""
    samples = BATCH if case.measure is Measure.TRAINING else 1
    return work(each.networks[case.kind], *dam(each.settings, case.points, samples=samples), case.measure)


def timed(action: Callable[[], None]) -> float:
    """Seconds of `action`, the mean of as many as it takes to last."""
    begin, count = time.perf_counter(), 0
    while True:
        action()
        count += 1
        spent = time.perf_counter() - begin
        if spent >= LEAST:
            return spent / count


def edges(settings: ModelSettings, points: int) -> int:
    """Messages that are passed on a dam in each layer."""
    return len(neighbours(dam(settings, points)[0].positions, settings.radius)[0])


def measured(
    several: Sequence[Family], rounds: int, longest: float, sizes: Mapping[int, Sequence[int]] = SIZES
) -> dict[Case, Cost | LeftOut]:
    """All cases, those of up to `ONCE` seconds in turn in `rounds` rounds.

    A case that would take more than `MOST_BYTES`, or of the textbook's more than `longest` [s], judged by the next
    smaller one, is left out.
    """
    costs: dict[Case, Cost | LeftOut] = {}
    again: dict[Case, Callable[[], float]] = {}
    columns = [(each, kind, measure) for each in several for kind in each.networks for measure in Measure]
    with tqdm(columns, desc="first round", unit="column", dynamic_ncols=True) as bar:
        for each, kind, measure in bar:
            case = Case(family=each.name, kind=kind, measure=measure, points=WARM_UP)
            # What is compiled at the first call is no part of a step.
            case_work(each, case)()
            last: tuple[int, Cost] | None = None
            for points in sizes[each.settings.dimension]:
                case = dataclasses.replace(case, points=points)
                limit = math.inf if kind is Kind.OURS else longest
                reason = too_much(points / last[0], last[1], limit) if last else ""
                if reason:
                    costs[case] = LeftOut(reason=reason)
                    continue
                action = case_work(each, case)
                begin = time.perf_counter()
                peak = extra(action)
                costs[case] = cost = Cost(seconds=(time.perf_counter() - begin,), peak=peak)
                last = (points, cost)
                if cost.seconds[0] <= ONCE:
                    again[case] = partial(timed, action)
    for case, seconds in turns(again, rounds, "seconds per step").items():
        first = costs[case]
        assert isinstance(first, Cost)
        costs[case] = dataclasses.replace(first, seconds=tuple(seconds))
    return costs


def too_much(factor: float, smaller: Cost, longest: float) -> str:
    """Why a case `factor` times as large as `smaller` is left out; empty if it is not."""
    peak, seconds = factor * (smaller.peak or 0), factor * smaller.seconds[0]
    if peak > MOST_BYTES:
        return f"~{peak / 1.0e9:.0f} GB"
    return f"~{seconds:.0f} s" if seconds > longest else ""


def ratio(these: Cost, those: Cost) -> Spread:
    """Seconds of these over those: round by round, or over the others' median where these were measured once."""
    if len(these.seconds) == len(those.seconds):
        return Spread.of(a / b for a, b in zip(these.seconds, those.seconds, strict=True))
    return Spread.of(a / those.spread.middle for a in these.seconds)
