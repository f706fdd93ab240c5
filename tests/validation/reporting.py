"""Small outcomes of a loop of every kind, made by hand: what reports are tested on."""

import math
from pathlib import Path

import numpy as np

from datasets import measures
from datasets.material import Material
from datasets.scene import Baffle, Domain, Mass, Scene
from datasets.trajectory import Trajectory
from inverse.forward.interface import Evaluation
from inverse.observations import deposit as observations
from inverse.observations.target import Target
from inverse.parameters.parameters import with_unknowns
from inverse.problem import Observable, ObservationSettings, Problem, TargetSettings, Unknown
from inverse.result import Combination, Identifiability, Minimum, Purpose, Result, Round, RunRecord, Verdict, named
from validation.loop.calibration import Calibration
from validation.loop.certainty import Certainty
from validation.loop.result import Answer, Solved
from validation.loop.search import Checked

SAND = Material(friction_deg=30.0, cohesion=200.0, tension_cutoff=50.0)
COLUMN = Scene(
    domain=Domain(size=(1.0, 0.5), cell=0.02),
    material=SAND,
    masses=tuple(Mass(lower=(0.0, 0.04 * layer), size=(0.3, 0.04), velocity=(0.1, 0.0)) for layer in range(10)),
    duration=0.1,
    frame_dt=0.05,
)
CHUTE = Scene(
    domain=Domain(size=(2.0, 1.0, 1.0), cell=0.05),
    material=SAND,
    masses=(Mass(lower=(0.1, 0.0, 0.15), size=(0.3, 0.2, 0.7), velocity=(2.0, 0.0, 0.0)),),
    baffles=tuple(Baffle(lower=(0.5, 0.0, z), size=(0.15, 0.2, 0.15)) for z in (0.05, 0.75)),
    duration=0.1,
    frame_dt=0.05,
)
FRICTION = Unknown(name="friction_deg", initial=30.0, lower=12.0, upper=52.0)
COHESION = Unknown(name="cohesion", initial=200.0, lower=30.0, upper=3000.0)
VELOCITIES = [Unknown(name=f"masses[{i}].velocity_x", initial=0.0, lower=-1.0, upper=3.0) for i in range(10)]
ANGLES = [Unknown(name=f"masses[{i}].friction_deg", initial=30.0, lower=16.0, upper=45.0) for i in range(4)]
Z = [
    Unknown(name="baffles[0].z", initial=0.125, lower=0.08, upper=0.42),
    Unknown(name="baffles[1].z", initial=0.825, lower=0.58, upper=0.92),
]
XZ = [Unknown(name=f"baffles[{i}].x", initial=0.575, lower=0.5, upper=0.85) for i in range(2)] + Z
KINDS: dict[str, tuple[Scene, list[Unknown], Observable]] = {
    "front": (COLUMN, [FRICTION], Observable.FRONT),
    "runout": (COLUMN, [FRICTION], Observable.RUNOUT),
    "profile": (COLUMN, [FRICTION, COHESION], Observable.PROFILE),
    "layers": (COLUMN, VELOCITIES, Observable.DEPOSIT),
    "angles": (COLUMN, ANGLES, Observable.DEPOSIT),
    "toe": (CHUTE, Z, Observable.TOE),
    "design": (CHUTE, XZ, Observable.PASSED),
}


def flow(scene: Scene, length: float) -> Trajectory:
    """A wedge of 600 points that has run `length` [m]."""
    rng = np.random.default_rng(round(1e4 * length))
    across = rng.random((600, scene.dimension))
    along = 1.0 - np.sqrt(1.0 - across[:, 0])
    end = across * np.array(scene.domain.size)
    end[:, 0], end[:, 1] = 0.05 + length * along, 0.2 * (1.0 - along) * across[:, 1]
    frames = np.stack([0.5 * end, 0.8 * end, end]).astype(np.float32)
    return Trajectory(
        positions=frames,
        time=np.array([0.0, 0.05, 0.1]),
        velocity0=np.zeros_like(frames[0]),
        friction=np.full(600, SAND.friction, np.float32),
        scene=scene,
    )


def make(
    kind: str,
    folder: Path,
    *,
    verdict: Verdict = Verdict.CONFIRMED,
    known: bool = True,
    certain: bool = True,
    told: bool = True,
) -> Solved:
    """An outcome; its runs lie in `folder`.

    known: the target's deposit and the truth; certain: there is an ensemble; told: all combinations are known.
    """
    scene, unknowns, observable = KINDS[kind]
    least = kind == "design"
    line = 1.0 if observable is Observable.PASSED else None
    reach = 0.6 if scene is COLUMN else 1.2
    settings = TargetSettings(hidden=True) if not least else TargetSettings(least=True)
    problem = Problem(
        name=kind,
        folder=folder,
        scene=scene,
        unknowns=tuple(unknowns),
        observation=ObservationSettings(kind=observable, line=line),
        target=settings,
    )
    observation = observations.build(problem.observation, scene)
    wanted = flow(scene, reach).positions[-1]
    values = np.zeros(1) if least else observation.exact(wanted)
    middle = problem.initial
    truth = dict(
        zip(problem.names, (middle + 0.03 * np.array([u.upper - u.lower for u in unknowns])).tolist(), strict=True)
    )
    target = Target(
        values=values,
        edge=math.nan if least else measures.front(wanted),
        deposit=wanted if known and not least else None,
        truth=truth if known and not least else None,
    )
    points = [middle, middle * 1.02, middle * 1.04]
    checked, records = [], []
    for number, point in enumerate(points, 1):
        trajectory = flow(with_unknowns(scene, problem.names, point), reach + 0.03 / number)
        deposit, file = trajectory.positions[-1], f"mpm/{number:02d}.npz"
        trajectory.save(folder / file)
        seen = observation.exact(deposit)
        loss = observations.loss(seen, values, observation.components)
        run = Checked(
            unknowns=point,
            trajectory=trajectory,
            observation=seen,
            front=measures.front(deposit),
            front_error=target.front_error(observation, deposit),
            loss=loss,
        )
        checked.append(run)
        records.append(
            RunRecord(
                purpose=Purpose.CHECK,
                unknowns=named(problem, point),
                observation=seen,
                front=run.front,
                front_error_pct=100.0 * run.front_error,
                loss=loss,
                seconds=0.5,
                file=file,
            )
        )
    rounds = []
    for number, point in enumerate(points):
        evaluations = [
            Evaluation(
                unknowns=point * factor,
                observation=checked[number].observation,
                loss=1e-3 / (1 + number) / factor,
                gradient=None,
                forward_s=0.5,
                backward_s=1.5,
            )
            for factor in (1.0, 1.01, 1.02)
        ]
        rounds.append(Round(number=number, evaluations=evaluations))
    widths = {unknown.name: 0.1 * (unknown.upper - unknown.lower) for unknown in unknowns}
    worth = certainty(problem, checked, widths, told=told) if certain else None
    result = Result(
        problem=problem,
        target=target,
        verdict=verdict,
        answer=points[-1],
        certainty=widths if certain else None,
        surrogate=checked[-1].observation,
        mpm=checked[-1].observation,
        front_error_pct=100.0 * checked[-1].front_error,
        loss_surrogate=1e-5,
        loss_mpm=checked[-1].loss,
        rounds=rounds,
        other_minima=[] if told else [Minimum(unknowns=middle, loss=1e-4)],
        identifiability=worth.identifiability if worth else None,
        mpm_runs=records,
        mpm_seconds=1.5,
        total_seconds=20.0,
    )
    return Solved(
        result=result,
        answer=Answer(unknowns=points[-1], runs=checked[-1:]),
        proposed=checked[0],
        begun=checked[1] if least else None,
        certainty=worth,
        surrogate_deposit=flow(scene, reach + 0.1).positions[-1][::3],
    )


def certainty(problem: Problem, runs: list[Checked], widths: dict[str, float], *, told: bool) -> Certainty:
    """What an ensemble might say."""
    calibrations = {
        name: Calibration(estimate=1.0, half_width=width, slope=-0.0123, scatter=0.002)
        for name, width in widths.items()
    }
    count = len(widths)
    combinations = []
    for number in range(count):
        direction = np.zeros(count)
        direction[number], direction[number - 1] = 0.8, -0.6 if count > 1 else 0.8
        last = number == count - 1
        combinations.append(
            Combination(
                weights=dict(zip(widths, direction.tolist(), strict=True)),
                singular_value=100.0 / (number + 1),
                half_width=0.9 if last and not told else 0.02 * (number + 1),
            )
        )
    halves = {name: 0.5 * width for name, width in widths.items()}
    identifiability = Identifiability(combinations=combinations, half_a_cell=halves, scatter=halves, noise=halves)
    return Certainty(
        calibrations=calibrations,
        misfit=0.001,
        front_misfit=0.001,
        runs=runs,
        centre=runs[-1].unknowns,
        identifiability=None if problem.target.least else identifiability,
    )
