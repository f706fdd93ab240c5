"""The loop: the surrogate proposes, the MPM confirms or corrects, the surrogate learns from it and proposes again.

Here is a search's state, and the search for one unknown; for several, and for a design, see `validation.loop.least_squares`.
"""

import dataclasses
import itertools
import math
from dataclasses import dataclass, field

import numpy as np

from datasets import measures
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from inverse.forward.interface import SurrogateSource
from inverse.gradient import automatic
from inverse.observations.combined import Combined
from inverse.observations.deposit import Observation, Values, loss
from inverse.observations.measurements import CHANCE_CELLS, CHANCE_OF_A_SHARE
from inverse.observations.target import Target
from inverse.optimise import Bounds, best, minimise
from inverse.parameters.parameters import Vector, with_unknowns
from inverse.problem import Method, Observable, OptimiserSettings, Problem
from inverse.result import Minimum, Round
from validation.loop.agreement import Seen, meets
from validation.loop.correction import Corrected
from validation.loop.runs import KeptRuns

SETTLED = 0.02
"""A proposal this close to the best MPM run, as a fraction of the range, is left to the ensemble (0.8 degrees)."""
STUCK = 0.0025
"""A step shorter than this, far from the target, leads nowhere (0.1 degrees)."""
EVALUATIONS_PER_ROUND = 5
"""Gradients of the surrogate that a round may spend: it starts where the MPM has just been."""


@dataclass(frozen=True, kw_only=True)
class Checked:
    """An MPM run at proposed unknowns."""

    unknowns: Vector
    trajectory: Trajectory
    observation: Values
    """Exact [m], shape [M]."""
    front: float
    """[m]."""
    front_error: float
    """Relative, with its sign; nan where the target tells nothing of a front."""
    loss: float
    """[m^2]."""


@dataclass
class Search:
    """A search under way, and what it found."""

    problem: Problem
    target: Target
    observation: Observation
    source: SurrogateSource
    runs: KeptRuns
    bounds: Bounds
    rounds: list[Round] = field(default_factory=list)
    other_starts: list[Round] = field(default_factory=list)
    """Of the first inversion, those that did not end lowest."""
    other_minima: list[Minimum] = field(default_factory=list)
    checked: list[Checked] = field(default_factory=list)
    surveyed: list[Checked] = field(default_factory=list)
    """Runs of ensembles that were followed by another one, nearer to the answer."""
    reachable: bool = True
    """False once not even the MPM's own slope leads any nearer to the target."""

    def check(self, unknowns: Vector, seed: int | None = None) -> Checked:
        """Run the MPM at `unknowns`, with another jitter `seed` than the scene's if so asked."""
        (trajectory,) = self.runs([self.scene(unknowns, seed)])
        run = self.judge(unknowns, trajectory)
        self.checked.append(run)
        return run

    def scene(self, unknowns: Vector, seed: int | None = None) -> Scene:
        """The problem's scene at `unknowns`, with another jitter `seed` if so asked."""
        scene = with_unknowns(self.problem.scene, self.problem.names, unknowns)
        return scene if seed is None else dataclasses.replace(scene, seed=seed)

    def judge(self, unknowns: Vector, trajectory: Trajectory) -> Checked:
        """Hold an MPM run against the target."""
        deposit = trajectory.positions[-1]
        observation = self.observation.observe(trajectory)
        return Checked(
            unknowns=unknowns,
            trajectory=trajectory,
            observation=observation,
            front=measures.front(deposit),
            front_error=self.target.front_error(self.observation, deposit),
            loss=loss(observation, self.target.values, self.observation.components),
        )

    def fits(self, run: Checked) -> bool:
        """Whether `run` meets the target as closely as was asked."""
        seen = Seen(observation=run.observation, front_error=run.front_error, components=self.observation.components)
        return meets(self.problem, self.target, seen, chance=0.0, front_chance=0.0)

    def rounded(self, unknowns: Vector) -> Vector:
        """`unknowns` to a millionth of the range, inside the bounds: a kept run is found again by its scene."""
        digits = 6 - np.ceil(np.log10(self.bounds.range)).astype(int)
        return self.bounds.clip(
            np.array([round(float(value), int(places)) for value, places in zip(unknowns, digits, strict=True)])
        )

    def corrected(self) -> Corrected:
        """The surrogate, started by the nearest run and corrected by it and the runs around it."""
        anchor = self.nearest
        model = Corrected(self.source.start(anchor.trajectory), anchor.unknowns, anchor.observation)

        def apart(run: Checked) -> float:
            return float(np.linalg.norm((run.unknowns - anchor.unknowns) / self.bounds.range))

        others = sorted((run for run in self.checked if apart(run) > 0.0), key=apart)
        far = 1.5 * self.problem.loop.trust
        # At least as many as unknowns, wherever they lie: a slope across is better than the surrogate's.
        count = len(self.bounds.range)
        learned = [run for number, run in enumerate(others) if number < count or (apart(run) <= far and number < 3)]
        points, shown = [run.unknowns for run in learned], [run.observation for run in learned]
        model.learn(points, shown, self.scatter, self.bounds.range)
        return model

    @property
    def scatter(self) -> float:
        """What an observed number of the MPM is expected to scatter over jitter seeds [m; of a share -].

        Of several observations in standard deviations.
        """
        if isinstance(self.observation, Combined):
            return self.observation.by_chance
        if self.problem.observation.kind is Observable.PASSED:
            return CHANCE_OF_A_SHARE
        return CHANCE_CELLS * self.problem.scene.domain.cell

    @property
    def single(self) -> bool:
        """Whether one unknown is to be found from how far along x a deposit reaches: a search of its own."""
        lengths = (Observable.FRONT, Observable.RUNOUT, Observable.PROFILE)
        one = len(self.problem.unknowns) == 1 and self.problem.observation.kind in lengths
        return one and not self.problem.target.least

    @property
    def nearest(self) -> Checked:
        """The run with the least loss."""
        return min(self.checked, key=lambda run: run.loss)

    @property
    def budget(self) -> int:
        """MPM runs left."""
        return self.problem.loop.mpm_runs - len(self.checked)


def reserved(problem: Problem) -> int:
    """MPM runs that stay in the budget for the answer that the ensemble sharpens (`validation.loop`)."""
    return problem.loop.mpm_runs * 3 // 8


def search(state: Search, proposal: Vector) -> None:
    """Let the MPM correct the surrogate, whose answer was `proposal`, until what is left is scatter."""
    reach = state.problem.loop.trust * state.bounds.range
    while True:
        before = state.nearest if state.checked else None
        state.check(proposal)
        anchor = state.nearest
        if near(state, anchor) or state.budget <= reserved(state.problem):
            return
        if anchor is before:
            reach = reach / 2.0  # The step made it worse: believe the corrected surrogate less far.
        proposal = propose(state, state.corrected(), reach)
        step = np.max(np.abs(proposal - anchor.unknowns) / state.bounds.range)
        if not off_by_more_than_scatter(state, anchor):
            if step <= SETTLED:
                return
            continue
        if step > STUCK:
            continue
        if len(state.checked) > 1:
            # Of many numbers what is left may be the model's fault: the ensemble's slopes tell.
            state.reachable = len(anchor.observation) > 1
            return
        # So far it is the surrogate alone that knows no way on: look at the MPM a step away.
        proposal = anchor.unknowns + np.where(anchor.unknowns > state.bounds.middle, -reach, reach)


def near(state: Search, run: Checked) -> bool:
    """Whether a single observed number is met so well that the rest is scatter: the run's and the target's."""
    return len(run.observation) == 1 and math.sqrt(run.loss) <= 3.0 * state.scatter


def off_by_more_than_scatter(state: Search, run: Checked) -> bool:
    """Whether the front of `run` misses the target's by more than chance and a measured profile's noise explain."""
    known = state.target.covariance
    noise = 0.0 if known is None else 2.0 * math.sqrt(float(known[-1, -1]))
    most = state.problem.loop.confirm_within + (3.0 * state.scatter + noise) / state.target.edge
    return abs(run.front_error) > most


def propose(state: Search, corrected: Corrected, reach: Vector) -> Vector:
    """Where the corrected surrogate meets the target, no further than `reach` from the best MPM run."""
    anchor = state.nearest
    # A tenth of the scatter: closer is not worth a gradient.
    stop_below = (0.1 * state.scatter) ** 2
    settings = OptimiserSettings(method=Method.LBFGSB, max_iterations=EVALUATIONS_PER_ROUND, stop_below=stop_below)
    box = state.bounds.around(anchor.unknowns, reach)
    evaluate = automatic(corrected, corrected.surrogate.wanted(state.target.values))
    number = len(state.rounds)
    records = minimise(evaluate, anchor.unknowns, box, settings, f"corrected surrogate, round {number}")
    state.rounds.append(Round(number=number, evaluations=records))
    proposal = best(records).unknowns
    if len(proposal) == 1 and len(anchor.observation) == 1:
        proposal = np.array([inside_bracket(state, float(proposal[0]))])
    return proposal


def inside_bracket(state: Search, proposal: float) -> float:
    """One unknown and one number: where MPM runs lie on both sides of the target, the answer is between them.

    A proposal outside of the innermost such pair gives way to regula falsi in it.
    """
    points = sorted(
        (float(run.unknowns[0]), float((run.observation - state.target.values)[0])) for run in state.checked
    )
    pairs = [(a, b) for a, b in itertools.pairwise(points) if a[1] * b[1] < 0.0]
    if not pairs:
        return proposal
    anchor = float(state.nearest.unknowns[0])
    (low, below), (high, above) = min(pairs, key=lambda pair: abs(pair[0][0] - anchor) + abs(pair[1][0] - anchor))
    if low < proposal < high:
        return proposal
    return low + (high - low) * float(np.clip(below / (below - above), 0.1, 0.9))
