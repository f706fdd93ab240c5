"""The learned surrogate as a function of white numbers, with its gradient: the flow that leads a search for fields.

A field enters its initial state as it enters the MPM's scene: a thickness moves particles up and down in proportion and
scales their volumes; the friction of a terrain is given at the posts of its raster.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datasets.errors import InputError
from datasets.geometry.ground import elevation, ground_raster
from datasets.scene.grid_field import FRICTION, THICKNESS, VELOCITIES, Floats
from datasets.scene.particles import mass_counts
from gns import checkpoint
from gns.library import model_path, shipped
from gns.simulator import StepModel
from gns.surroundings.initial import InitialState
from inverse.fields.flow import WhiteFlow
from inverse.forward.gns import PREDICTIONS, Band, GnsForward, band_of, priced, unfamiliar
from inverse.observations import Observation
from inverse.observations.target import Target
from inverse.parameters import in_order
from inverse.parameters.field import UnknownField
from inverse.parameters.kind import tangent_of, thrown
from inverse.problem import Problem
from inverse.settings import Surrogate

Enter = Callable[[InitialState, Tensor], InitialState]
"""An initial state and the values [K] of a field -> the state with these values, differentiable in them."""
UP = 1


class SurrogateFlow(WhiteFlow):
    """Rollouts at white numbers. Raises InputError for a scene that no surrogate supports."""

    def __init__(self, problem: Problem, observation: Observation, model: StepModel, band: Band) -> None:
        # The scene must not contain a twin's truth.
        problem = replace(problem, scene=problem.scene_at(problem.initial))
        super().__init__(problem, observation)
        self.forward = GnsForward(model, problem, observation, band)
        self.begun = lru_cache(maxsize=64)(self.begin)

    @property
    def reverses_combinations(self) -> bool:
        return True

    def begin(self, seed: int) -> tuple[InitialState, list[Enter]]:
        """The initial state of a jitter seed at the medians of the prior, and how each field enters it."""
        initial = self.forward.begin(replace(self.problem.scene, seed=seed))
        return initial, [entering(unknown, initial) for unknown in self.problem.fields]

    def started(self, values: Tensor, fields: Sequence[Tensor], seed: int) -> InitialState:
        """The initial state with numbers [U] and the values [K] of each field, differentiable in them."""
        initial, entries = self.begun(seed)
        for index in in_order(self.problem.kinds):
            kind = self.problem.kinds[index]
            assert kind.input is not None, "an input of the surrogate"
            initial = kind.input(kind, initial, values[index])
        for enter, field in zip(entries, fields, strict=True):
            initial = enter(initial, field)
        return initial

    def predicted(self, values: Tensor, fields: Sequence[Tensor], seed: int) -> Tensor:
        """The observed numbers [M] of a rollout."""
        start = self.started(values, fields, seed)
        self.runs += 1
        self.bar.update()
        return self.forward.observed(self.forward.unrolled([start]), start)

    def observe(self, points: Sequence[Floats], seeds: Sequence[int]) -> Floats:
        with torch.no_grad():
            rows = [self.predicted(*self.tensors(point), seed) for point, seed in zip(points, seeds, strict=True)]
        return np.stack([row.numpy() for row in rows])

    def jacobian(self, white: Floats, combinations: Floats, seeds: Sequence[int]) -> Floats:
        jacobian = np.zeros((len(combinations), self.size))
        for seed in seeds:
            values, fields = self.tensors(white)
            leaves = [leaf.requires_grad_() for leaf in (values, *fields)]
            numbers = self.predicted(values, fields, seed)
            kept = {"retain_graph": True, "materialize_grads": True}
            for row, combination in enumerate(torch.from_numpy(combinations)):
                slopes = torch.autograd.grad(numbers, leaves, combination, **kept)
                by_numbers, *by_nodes = (slope.numpy() for slope in slopes)
                jacobian[row] += self.pulled_back(by_nodes, by_numbers, white) / len(seeds)
                self.bar.update()
            self.reverses += len(combinations)
        return jacobian

    def tensors(self, white: Floats) -> tuple[Tensor, list[Tensor]]:
        return torch.from_numpy(self.values(white)), [torch.from_numpy(field) for field in self.fields(white)]

    def errors(self, white: Floats) -> Floats:
        """Columns of the covariance of its errors from its band, shape [columns, M]."""
        return self.forward.errors(self.values(white))


def entering(unknown: UnknownField, initial: InitialState) -> Enter:
    """The function that puts a field into an initial state, which has the median of the field's prior."""
    settings, scene, kept = unknown.settings, initial.scene, initial.indices
    if settings.solid is not None:
        return entering_bed(unknown, initial)
    members = unknown.of(np.repeat(np.arange(len(scene.masses), dtype=np.int32), mass_counts(scene)))
    rows, here = np.cumsum(members) - 1, torch.from_numpy(members[kept])
    weights = torch.from_numpy(unknown.weights(unknown.places(scene)).tocsr()[rows[kept]].toarray())
    positions = initial.state.positions
    if settings.quantity == THICKNESS:
        plan = positions.numpy()[:, ::2].astype(np.float64)
        ground = torch.from_numpy(elevation(scene.solids, scene.domain, plan)).to(positions.dtype)
        median = torch.from_numpy(unknown.median)

        def enter(initial: InitialState, values: Tensor) -> InitialState:
            stretch = torch.where(here, (weights @ values) / (weights @ median), 1.0).to(positions.dtype)
            points = initial.state.positions
            up = ground + (points[:, UP] - ground) * stretch
            raised = torch.cat((points[:, :UP], up.unsqueeze(1), points[:, UP + 1 :]), dim=1)
            initial = replace(initial, state=replace(initial.state, positions=raised))
            return initial.with_conditions(volume=initial.conditions.volume * stretch)

    elif settings.quantity == FRICTION:
        materials = [scene.material_of(mass) for mass in scene.masses]

        def enter(initial: InitialState, values: Tensor) -> InitialState:
            friction = initial.conditions.friction
            for index, material in enumerate(materials):
                tangent = tangent_of(material, weights @ values).to(friction.dtype)
                friction = torch.where(here & torch.from_numpy(initial.mass == index), tangent, friction)
            return initial.with_conditions(friction=friction)

    else:

        def enter(initial: InitialState, values: Tensor) -> InitialState:
            return thrown(initial, here, VELOCITIES.index(settings.quantity), weights @ values)

    return enter


def entering_bed(unknown: UnknownField, initial: InitialState) -> Enter:
    """The function that puts the friction of a terrain into the raster of the ground."""
    ground = initial.conditions.ground
    assert ground is not None, "a terrain in 3D"
    top = ground_raster(initial.scene, ground.spacing)[2]
    axes = np.meshgrid(*(ground.spacing * np.arange(count) for count in top.shape), indexing="ij")
    shares = torch.from_numpy(unknown.on_bed(initial.scene, np.stack(axes, axis=-1).reshape(-1, 2)))
    mask: NDArray[np.bool_] = top == unknown.settings.solid

    def enter(initial: InitialState, values: Tensor) -> InitialState:
        ground = initial.conditions.ground
        assert ground is not None, "a terrain in 3D"
        friction = (shares @ values).reshape(top.shape).to(ground.friction.dtype)
        merged = torch.where(torch.from_numpy(mask), friction, ground.friction)
        return initial.with_conditions(ground=replace(ground, friction=merged))

    return enter


def leading(problem: Problem, target: Target, model: Path | None = None) -> tuple[WhiteFlow | None, str]:
    """The flow that leads the search for the fields of `problem`, or None, and the reason in words.
    model: weights, by default the shipped ones. Raises InputError if the problem demands an unsuitable surrogate."""
    asked, observation, scene = problem.surrogate, target.observation, problem.scene_at(problem.initial)
    if asked is Surrogate.NONE:
        return None, "the problem asks for none"
    if asked is Surrogate.COARSE:
        scene = problem.scene
        # Flows on larger cells scatter more, and cost a sixteenth.
        optimiser = replace(problem.optimiser, seeds=2 * problem.optimiser.seeds)
        coarse = replace(problem, scene=scene.with_cell(2.0 * scene.domain.cell), optimiser=optimiser)
        return WhiteFlow(coarse, observation), "it is the MPM on cells twice as large"
    weights = model_path(model or shipped(scene))
    lacks, simulator = "", checkpoint.load(weights).simulator
    if without := [number.name for number in problem.numbers if number.kind.input is None]:
        lacks = f"{', '.join(without)} is no input of it"
    if not (observation.of_positions or all(part.observation.dense for part in observation.parts)):
        lacks = f"it does not predict {observation.label}"
    reason = lacks or unfamiliar(weights, simulator.settings, scene)
    # Outside its training range it leads only if the problem demands it.
    if reason and (asked is Surrogate.AUTO or lacks):
        if asked is Surrogate.GNS:
            raise InputError(f"expected auto or none, {reason}", key="surrogate")
        return None, reason
    flow = SurrogateFlow(problem, observation, simulator, band_of(weights, scene))
    dear, price = priced(scene, partial(flow.observe, [np.zeros(flow.size)], [scene.seed]))
    if asked is Surrogate.AUTO and model is None and not dear:
        return None, f"{price}, a {PREDICTIONS:g}th of it or more"
    return flow, f"{price}; {reason}" if reason else price
