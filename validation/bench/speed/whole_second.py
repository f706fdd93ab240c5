"""The paper's tall column for its whole second: forward, and with the gradient with respect to the friction."""

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import nn

from datasets.library import read_scene
from gns.initial import InitialState, initial_state
from gns.model.settings import ModelSettings
from gns.model.simulator import Simulator
from gns.unroll import step_activation_bytes, unroll
from inverse.forward.gns import MEMORY_GIB
from validation.bench.speed.gns_rates import Family, Kind, Measure, timed, work
from validation.bench.speed.textbook import Textbook
from validation.report.memory import extra
from validation.report.timing import Spread, turns

SCENE = "column-tall-42"
PEERS = ModelSettings(cell=0.005, radius=0.015, frames_per_step=1, history=5)
"""The resolution of the paper's code: all 3,200 points, steps of 2.5 ms, the smaller radius of its inputs."""
ENOUGH = 4.0
"""A rollout that takes longer [s] is run once."""


@dataclass(frozen=True, kw_only=True)
class Second:
    """A line of the table."""

    name: str
    points: int
    steps: int
    run: bool
    """Whether all steps were run; else it is one step's seconds times the steps."""
    forward: Spread
    """[s]."""
    gradient: Spread
    """Forward and backward [s]."""
    peak: int | None
    """Of the gradient, above what was held before [bytes]."""


def rolled_out(name: str, simulator: Simulator, rounds: int) -> Second:
    """One of ours: every step is run."""
    problem = start(simulator.settings)
    simulator.requires_grad_(False)
    kept = int(MEMORY_GIB * 2**30 / step_activation_bytes(simulator, problem.state, problem.conditions))

    def forward() -> None:
        with torch.no_grad():
            unroll(simulator, problem.state, problem.conditions, problem.steps)

    def gradient() -> None:
        friction = problem.conditions.friction.clone().requires_grad_()
        conditions = dataclasses.replace(problem.conditions, friction=friction)
        moved = unroll(simulator, problem.state, conditions, problem.steps, kept_steps=min(kept, problem.steps))
        moved[-1, :, 0].mean().backward()  # type: ignore[no-untyped-call]
        assert friction.grad is not None
        assert math.isfinite(float(friction.grad.sum()))

    first = timed_once(forward)
    peak = extra(gradient)
    times = turns(
        {"forward": lambda: timed_once(forward), "gradient": lambda: timed_once(gradient)},
        1 if first > ENOUGH else rounds,
        f"a second, {name}",
    )
    return Second(
        name=name,
        points=len(problem.indices),
        steps=problem.steps,
        run=True,
        forward=Spread.of(times["forward"]),
        gradient=Spread.of(times["gradient"]),
        peak=peak,
    )


def multiplied(name: str, network: nn.Module, settings: ModelSettings) -> Second:
    """Of the textbook: seconds of a step times the steps.

    The gradient is checkpointed at every step, as the paper's: a step is run forward, and later once more with its
    backward pass.
    """
    problem = start(settings)
    forward, gradient = (
        work(network, problem.state, problem.conditions, measure) for measure in (Measure.FORWARD, Measure.GRADIENT)
    )
    forward()
    one = timed(forward)
    peak = extra(gradient)
    both = timed(gradient)
    return Second(
        name=name,
        points=len(problem.indices),
        steps=problem.steps,
        run=False,
        forward=Spread.of([problem.steps * one]),
        gradient=Spread.of([problem.steps * (one + both)]),
        peak=peak,
    )


def seconds(families: Sequence[Family], rounds: int) -> list[Second]:
    """Our 2D models, the textbook's networks of their size, and the paper's network at the paper's resolution."""
    flat = [each for each in families if each.settings.dimension == 2]
    found = []
    for each in flat:
        simulator = each.networks[Kind.OURS]
        assert isinstance(simulator, Simulator)
        found.append(rolled_out(each.name, simulator, rounds))
        found.append(multiplied(f"textbook of the size of {each.name}", each.networks[Kind.TEXTBOOK], each.settings))
    paper = Textbook(dimension=2, radius=PEERS.radius, history=PEERS.history)
    return [*found, multiplied("textbook as in the paper, 128 x 10", paper, PEERS)]


def start(settings: ModelSettings) -> InitialState:
    """The tall column at rest, at a model's resolution."""
    return initial_state(read_scene(SCENE), settings)


def timed_once(action: Callable[[], None]) -> float:
    """Seconds of `action`."""
    begin = time.perf_counter()
    action()
    return time.perf_counter() - begin
