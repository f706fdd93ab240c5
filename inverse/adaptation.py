"""Adapts a model to the problem at hand: MPM flows throughout the prior box correct the model's rollouts.

A shipped model interpolates between flows of many kinds. An inversion needs one kind, with few unknowns: about 64 runs
fill their box, and training the correction (`gns.network.correction`) for a minute lowers the error severalfold.
Parameters are points of a Sobol sequence between the prior bounds (Sobol, On the distribution of points in a cube, USSR
Comput. Math. Math. Phys. 7 (1967) 86-112), and each flow has its own jitter seed. Every fifth flow is held out for the
scores and the band. A power of two would not do: points of a Sobol sequence that are 2^k apart fill only one slice of
the box.
"""

import dataclasses
import math
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import qmc
from tqdm import tqdm

from datasets.definitions.definition import DEPOSITS, Definition, Split, Storage, Stream
from datasets.errors import InputError, require
from datasets.files import make_folder, read_json, write_json
from datasets.flow import measures
from datasets.flow.trajectory import Trajectory, trajectory_files
from datasets.processes import processors
from datasets.scene import Scene
from gns import card, checkpoint
from gns.library import model_path, shipped
from gns.score import Score, calibrated, evaluate, table
from gns.settings import SEED, ModelSettings, TrainingSettings
from gns.simulator import Simulator
from gns.surroundings.initial import check
from gns.surroundings.units import Units
from gns.training.loop import LAST, fit
from gns.training.samples import Flow, flows_of
from inverse.forward.gns import require_predicted
from inverse.parameters import Vector, with_kinds
from inverse.posterior.emulator import fitted
from inverse.problem import Problem, read_problem
from mpm.footprint import INVERSION
from mpm.generate import MOST_JOBS, generate, missing_entries

DATA, PROBLEM = "data", "problem.json"  # in the folder of a run: its flows, and the problem they belong to
HELD_OUT = 5  # one in so many flows is held out; odd, so that the held-out flows lie throughout the box
FEWEST = 7  # smallest number of flows, of which two are held out
TRAINING = TrainingSettings(
    correct=True, rollouts=3, learning_rate=1e-3, warmup=20, first=0.8, average=0.98, validations=1, validate_flows=24
)
"""Settings for the training of a correction with the flows of one problem."""
FEWEST_PER_COEFFICIENT = 10
"""Runs per coefficient of a linear trend from which the scatter of fronts is stated. An emulator of fewer runs takes
their curvature for scatter: with two unknowns and 8 runs it gives 2.5 % for any scatter from 0.3 to 2 %."""
EXPECTED_SCATTER = 0.01  # expected scatter of fronts from jitter to jitter, over the extent, before any run
ERRORS = ("front", "profile", "height", "thickness")  # that the command prints, before and after
KEPT = 8  # particles stored per cell of the model; a training sample uses one of them


def adapt(
    problem: Problem | Path | str,
    out: Path | str,
    *,
    runs: int = 64,
    minutes: float = 2.0,
    model: Path | str | None = None,
    jobs: int | None = None,
    seed: int = 0,
) -> Path:
    """Correct a model with the flows of `problem`, and return the file of its weights, `out`/best.safetensors.

    >>> from inverse import adapt
    >>> from validation import solve
    >>> result = solve("friction-tall-42", "out/loop", model=adapt("friction-tall-42", "out/tall"))

    runs: MPM runs, of which a fifth is held out; minutes: training time; model: the model to start from, by default the
    shipped one; jobs: parallel processes, by default one per processor; seed: of the parameters, jitters and samples.
    The same call again resumes; with other `runs` or another model, the training begins anew. Raises InputError for a
    problem that no surrogate can learn or if `out` belongs to another problem, and WorkFailed if an MPM run fails."""
    asked, out = problem if isinstance(problem, Problem) else read_problem(problem), Path(out)
    weights = model_path(model or shipped(asked.scene))
    begun = checkpoint.load(weights)
    settings = begun.simulator.settings
    if asked.fields:
        raise InputError("expected numbers, a surrogate knows no fields", where=asked.name, key="unknowns")
    require_predicted(asked)
    check(asked.scene_at(asked.initial), settings)
    require(runs >= FEWEST, "--runs", f"at least {FEWEST} runs, of which two are held out", runs)
    require(SEED.hold(seed), "--seed", SEED.expected, seed)
    jobs = processors() if jobs is None else jobs
    require(1 <= jobs <= MOST_JOBS, "--jobs", f"at least 1 job and at most {MOST_JOBS} jobs", jobs)
    flows = definition(asked, runs, settings, seed=seed)
    entries = flows.entries(seed=seed)
    training = dataclasses.replace(TRAINING, minutes=minutes)
    if other := other_problem(out, asked):
        raise InputError(f"expected a new folder, or one of {asked.name}, it is of {other}", where=str(out))
    try:
        missing = len(missing_entries(entries, out / DATA))
    except InputError as error:
        expected = f"expected no flows but those of {asked.name}, seed {seed}, at most {runs} of them"
        raise InputError(f"{expected}; found {error.where}", where=str(out)) from None
    make_folder(out)
    write_json(out / PROBLEM, identity(asked))
    began = time.perf_counter()
    generate(flows, out / DATA, seed=seed, count=None, jobs=jobs, after=60.0 * minutes, beside=INVERSION)
    simulated = f"{missing} runs of the MPM in {time.perf_counter() - began:.0f} s"
    print(f"{simulated}; {minutes:g} minutes of training begin")
    held_out = flows_of(out / DATA, Split.VALID, settings)
    before = scored(begun.simulator, held_out, weights.stem)
    resume = (out / LAST).exists()
    fit([out / DATA], out, model=settings, training=training, begin=begun, resume=resume, anew=True, seed=seed)
    best = model_path(out)
    after = scored(checkpoint.load(best).simulator, held_out, best.stem)
    described = card.read(best)
    assert described is not None, "the training has written it"
    card.write(best, dataclasses.replace(described, scores=table(after)).keeping({DATA: calibrated(after)}))
    old, new = measures.amounts(before), measures.amounts(after)
    errors = [f"{name} {100.0 * old[name]:.1f} -> {100.0 * new[name]:.1f} %" for name in ERRORS]
    errors[-1] += f" on {len(held_out)} held-out flows{scatter(deposits(out, asked), asked)}"
    print(f"{simulated}, {minutes:g} minutes of training, {', '.join(errors)}")
    return best


def identity(problem: Problem) -> dict[str, Any]:
    """What identifies a problem's flows: the unknowns, and the scene with the unknowns at the middle of the box."""
    middle = problem.box.at(np.full(len(problem.names), 0.5))
    return {"unknowns": problem.names, "scene": problem.scene_at(middle, 0).to_json()}


def other_problem(run: Path, problem: Problem) -> str:
    """What the flows in the folder `run` are of, in words, where they are not of `problem`; else empty."""
    recorded, asked = read_json(run / PROBLEM), identity(problem)
    if recorded in (None, asked):
        return ""
    if recorded["unknowns"] != asked["unknowns"]:
        return f"another problem ({', '.join(recorded['unknowns'])})"
    middle = problem.box.at(np.full(len(problem.names), 0.5))
    same = with_kinds(Scene.from_json(recorded["scene"]), problem.kinds, middle).to_json() == asked["scene"]
    return "this problem with other bounds" if same else "another scene with the same unknowns"


def definition(problem: Problem, runs: int, settings: ModelSettings, *, seed: int) -> Definition:
    """The flows of a problem; a larger number of `runs` extends the flows of a smaller one."""
    box, length = problem.box, Units.of_model(problem.scene, settings).length
    sequence = qmc.Sobol(len(box.lower), rng=np.random.default_rng(seed))
    places = box.at(sequence.random_base2((runs - 1).bit_length()))

    def draw(stream: Stream, index: int) -> Scene:
        scene = problem.scene_at(places[index], int(stream.integers(2**31)))
        return dataclasses.replace(scene, frame_dt=Units.of_model(scene, settings).time * settings.step)

    return Definition(
        name="flow",
        size=runs,
        split=lambda index: Split.VALID if index % HELD_OUT == 1 else Split.TRAIN,
        draw=draw,
        storage=Storage(cell=length * settings.cell, kept=KEPT, deposit=True),
    )


def scored(simulator: Simulator, flows: Sequence[Flow], name: str) -> list[Score]:
    return [evaluate(simulator, [flow])[0] for flow in tqdm(flows, desc=f"{name}: held out", unit="flow", leave=False)]


def scatter(runs: Sequence[tuple[Vector, Trajectory]], problem: Problem) -> str:
    """In words, the scatter of the MPM's fronts from jitter to jitter, below which no model's error can fall; empty
    with too few runs to tell it."""
    if len(runs) < FEWEST_PER_COEFFICIENT * (1 + len(problem.numbers)):
        return ""
    points = problem.box.shares(np.stack([values for values, _ in runs]))
    ends = np.array([measures.ends(flow.positions[-1], flow.volumes) for _, flow in runs])
    extent = float(np.mean(ends[:, 1] - ends[:, 0]))
    emulator = fitted(points, ends[:, 1:] / extent, np.array([EXPECTED_SCATTER]))
    return f", whose fronts scatter by {100.0 * math.sqrt(emulator.scatter[0, 0]):.1f} %"


def deposits(model: Path | str, problem: Problem) -> list[tuple[Vector, Trajectory]]:
    """Parameters and deposits, with all particles, of the MPM runs that adapted a model to `problem`.
    model: its folder or its file. Empty if it was adapted to another problem. Raises InputError for a broken file."""
    run = Path(model) if Path(model).is_dir() else Path(model).parent
    if other := other_problem(run, problem):
        warnings.warn(f"{run}: its runs of the MPM are of {other}, and are not used", stacklevel=2)
    if other or not (run / PROBLEM).exists():
        return []
    flows = [Trajectory.load(path) for path in trajectory_files(run / DATA / DEPOSITS)]
    return [(np.array([kind.read(flow.scene) for kind in problem.kinds]), flow) for flow in flows]
