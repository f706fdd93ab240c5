"""One inversion with one forward model: its answers and their posterior, which no MPM run has checked."""

import sys
import time
from functools import partial
from pathlib import Path

from datasets.errors import InputError, require
from datasets.files import make_folder
from gns import card, checkpoint
from gns.library import model_path, shipped
from inverse.answer import Answer, Verdict
from inverse.forward.gns import GnsForward, band_of, require_predicted
from inverse.forward.mpm import MpmForward
from inverse.observations.observation import recording
from inverse.observations.target import Target
from inverse.problem import Problem, read_problem
from inverse.result import Result
from inverse.saving import save
from inverse.search.descent import ROUGH, inverted
from inverse.search.inference import left_out
from inverse.settings import ForwardModel, Surrogate
from inverse.target import read_target
from mpm import simulate, simulate_many


def invert(
    problem: Problem | str | Path,
    *,
    forward: ForwardModel | str | None = None,
    model: Path | None = None,
    out: Path | str | None = None,
) -> Result:
    """Find the parameters of a problem, or of the one in a file or of a shipped name, with one forward model;
    `validation.solve` checks the answer by the MPM.

    >>> from inverse import invert, read_problem
    >>> result = invert(read_problem("friction-tall-42"))
    >>> result.unknowns, result.interval

    forward: "gns", "mpm" or "adjoint", by default the surrogate, unless the problem says "none"; model: weights, by
    default the shipped ones; out: folder for `result.json`, `report.md` and pictures. Fields are found with the MPM's
    adjoint, together with their posterior. Raises InputError for an unsupported combination, and WorkFailed if a run
    blows up."""
    problem = problem if isinstance(problem, Problem) else read_problem(problem)
    names = [*map(str, ForwardModel)]
    require(forward is None or forward in names, "forward", f"one of {', '.join(names)}", repr(forward))
    forward = None if forward is None else ForwardModel(forward)
    _ = problem.operators
    if out is not None:
        make_folder(Path(out))
    if problem.fields:
        if forward is ForwardModel.GNS:
            raise InputError("expected the MPM with its adjoint, which inversions for fields use", where="--forward")
        # Imported here: other inversions do not need the adjoint's kernels.
        from inverse.fields.inversion import of_fields

        result = of_fields(problem, model)
    else:
        target = read_target(problem, partial(simulate, record=recording(problem.operators)))
        result = of_numbers(problem, target, forward_model(problem, target, forward, model))
    if out is not None:
        save(result, out)
    return result


def forward_model(
    problem: Problem, target: Target, forward: ForwardModel | None, model: Path | None
) -> GnsForward | MpmForward:
    if forward is ForwardModel.ADJOINT:
        # Imported here: other inversions do not need its kernels.
        from inverse.forward.adjoint import AdjointForward

        return AdjointForward(problem, target.observation, simulate_many)
    if forward is ForwardModel.MPM or (forward is None and problem.surrogate in (Surrogate.NONE, Surrogate.COARSE)):
        return MpmForward(problem, target.observation, simulate_many)
    require_predicted(problem)
    weights, scene = model_path(model or shipped(problem.scene)), problem.scene_at(problem.initial)
    if warning := card.warning(weights, scene):
        print(warning, file=sys.stderr)
    return GnsForward(checkpoint.load(weights).simulator, problem, target.observation, band=band_of(weights, scene))


def of_numbers(problem: Problem, target: Target, forward: GnsForward | MpmForward) -> Result:
    """Every answer of the forward model, whose errors count as noise."""
    began, box, by_mpm = time.perf_counter(), problem.box, isinstance(forward, MpmForward)
    scatter = target.observation.prior_scatter(target.values)
    inference = inverted(forward, problem, target, scatter, rough=1.0 if by_mpm else ROUGH)
    places = [(box.at(region.point), box.at(region.interval), region.weight) for region in inference.regions]
    answers = tuple(Answer(parameters=point, interval=ends, weight=weight) for point, ends, weight in places)
    loss = partial(target.observation.misfit, target=inference.target.values)
    steps = [{"unknowns": problem.named(box.at(run.point)), "loss": loss(run.numbers)} for run in inference.runs]
    (predicted,) = forward.observe([answers[0].parameters])
    deposit = forward.deposit(answers[0].parameters)
    total = time.perf_counter() - began
    losses = {"mpm" if by_mpm else "surrogate": loss(predicted), "initial": steps[0]["loss"]}
    return Result(
        problem=problem,
        target=target,
        verdict=Verdict.UNCONFIRMED,
        answers=answers,
        forward="MPM" if by_mpm else "surrogate",
        predicted=predicted,
        deposit=deposit,
        iterations=steps,
        posterior=inference.posterior,
        without=left_out(inference),
        seconds={"per_iteration": total / len(steps), "mpm": total if by_mpm else 0.0, "total": total},
        record={"loss": losses} | ({"flows": len(steps) + 2 + problem.target.twin} if by_mpm else {}),
    )
