"""One inversion by one forward model: minimise the misfit, then report what was found."""

import sys
import time
from functools import partial
from pathlib import Path

import numpy as np

from datasets.errors import InputError
from datasets.files import make_folder
from gns import card, checkpoint
from gns.library import model_path, shipped
from inverse.forward.band import band_of
from inverse.forward.gns import GnsForward
from inverse.forward.interface import Differentiable, Evaluation, Forward
from inverse.forward.mpm import MpmForward
from inverse.found import Answer, Verdict, plain
from inverse.jacobian import Evaluate, automatic, central, observed
from inverse.observations import Values
from inverse.optimise import minimise
from inverse.parameters import Vector
from inverse.problem import Problem
from inverse.result import Result
from inverse.secants import lowest, sample
from inverse.settings import ForwardModel, Gradient, Method, Surrogate
from inverse.surrogate import inverted
from inverse.target import Target, read_each, read_target
from mpm import simulate, simulate_many

COMMAND = "python -m inverse"


def invert(
    problem: Problem,
    *,
    forward: ForwardModel | None = None,
    gradient: Gradient | None = None,
    model: Path | None = None,
    out: Path | str | None = None,
) -> Result:
    """Find the parameters of `problem` by one forward model; `validation.solve` asks the MPM for its word.

    >>> from inverse import invert, read_problem
    >>> result = invert(read_problem("friction-tall-42"))
    >>> result.unknowns, result.certainty

    forward: the surrogate where absent, unless the problem asks for none; gradient: reverse mode, the surrogate's only
    one, or central differences, the MPM's where absent; model: weights, those that ship where absent; out: folder for
    `result.json`, `report.md` and pictures. Fields are found by the MPM's adjoint, with their posterior. Raises
    InputError for a combination that there is none of, WorkFailed where a run blows up.
    """
    read_each(problem)
    if out is not None:
        make_folder(Path(out))
    if problem.fields:
        if forward is ForwardModel.GNS or gradient is Gradient.FD:
            raise InputError("expected the MPM and its adjoint, which fields are found by", where="--forward")
        # Imported here: other inversions have no use for the adjoint's kernels.
        from inverse.field_inversion import of_fields

        result = of_fields(problem)
    else:
        target = read_target(problem, simulate)
        chosen = forward_model(problem, target, forward, gradient, model)
        if isinstance(chosen, GnsForward):
            result = of_surrogate(problem, target, chosen)
        else:
            result = of_mpm(problem, target, chosen, gradient)
    if out is not None:
        result.save(out)
    return result


def forward_model(
    problem: Problem,
    target: Target,
    forward: ForwardModel | None,
    gradient: Gradient | None,
    model: Path | None,
) -> GnsForward | MpmForward:
    """What predicts the observation. Raises InputError."""
    if forward is ForwardModel.MPM or (forward is None and problem.surrogate is Surrogate.NONE):
        if gradient is not Gradient.AD:
            return MpmForward(problem, target.observation, simulate_many)
        # Imported here: other inversions have no use for its kernels.
        from inverse.forward.adjoint import AdjointForward

        return AdjointForward(problem, target.observation, simulate_many)
    unsupported = [each.name for each in problem.numbers if not each.kind.predicted]
    if unsupported or not target.observation.of_positions:
        what = ", ".join(unsupported) or "forces"
        raise InputError(f"expected mpm, no surrogate predicts {what}", where="--forward gns")
    if gradient is Gradient.FD:
        raise InputError("expected ad, the surrogate's own gradient", where="--gradient fd")
    weights, scene = model_path(model or shipped(problem.scene.dimension)), problem.scene_at(problem.initial)
    if warning := card.warning(weights, scene):
        print(warning, file=sys.stderr)
    return GnsForward(checkpoint.load(weights).simulator, problem, target.observation, band=band_of(weights, scene))


def of_surrogate(problem: Problem, target: Target, forward: GnsForward) -> Result:
    """Every answer of the surrogate by its gradient, its band as noise, which nothing has checked."""
    began, box = time.perf_counter(), problem.box
    found = inverted(forward, problem, target, target.observation.prior_scatter(target.values))
    answers = tuple(
        Answer(
            parameters=box.lower + box.range * each.point, half_widths=box.range * each.half_widths, weight=each.weight
        )
        for each in found.answers
    )
    misfits = [target.observation.misfit(each, found.target.values) for each in found.numbers]
    first = answers[0].parameters
    (predicted,) = forward.observe([first])
    total = time.perf_counter() - began
    return Result(
        problem=problem,
        target=target,
        verdict=Verdict.UNCONFIRMED,
        answers=answers,
        forward="surrogate",
        predicted=predicted,
        deposit=forward.deposit(first),
        iterations=[
            {"unknowns": problem.named(box.lower + box.range * point), "loss": misfit}
            for point, misfit in zip(found.points, misfits, strict=True)
        ],
        posterior=found.posterior,
        seconds={"per_iteration": total / len(misfits), "mpm": 0.0, "total": total},
        record={
            "loss": {
                "surrogate": target.observation.misfit(predicted, found.target.values),
                "initial": misfits[0],
            }
        },
        command=COMMAND,
    )


def of_mpm(problem: Problem, target: Target, forward: MpmForward, gradient: Gradient | None = None) -> Result:
    """The minimum of the misfit of the MPM alone, which nothing has checked."""
    began = time.perf_counter()
    records = search(problem, target, forward, gradient)
    total, found = time.perf_counter() - began, lowest(records)
    seconds = {key: float(np.mean([getattr(e, f"{key}_s") for e in records])) for key in ("forward", "backward")}
    return Result(
        problem=problem,
        target=target,
        verdict=Verdict.UNCONFIRMED,
        answers=(Answer(parameters=found.parameters),),
        forward="MPM",
        predicted=found.observation,
        deposit=forward.deposit(found.parameters),
        iterations=[as_json(problem, each) for each in records],
        seconds=seconds | {"per_iteration": sum(seconds.values()), "mpm": total, "total": total},
        record={"loss": {"mpm": found.loss, "initial": records[0].loss}},
        command=COMMAND,
    )


def as_json(problem: Problem, evaluation: Evaluation) -> dict[str, object]:
    """An evaluation as `result.json` has it."""
    gradient = evaluation.gradient
    return {
        "unknowns": problem.named(evaluation.parameters),
        "observation": plain(evaluation.observation),
        "loss": evaluation.loss,
        "gradient": None if gradient is None else problem.named(gradient),
        "seconds": {"forward": evaluation.forward_s, "backward": evaluation.backward_s},
    }


def one_observed(forward: Forward, values: Values, components: int, at: Vector) -> Evaluation:
    """The misfit at one vector of parameters [U], without a gradient."""
    return observed(forward, values, [at], components=components)[0]


def search(problem: Problem, target: Target, forward: MpmForward, gradient: Gradient | None = None) -> list[Evaluation]:
    """Every evaluation of `forward` on the way to the minimum of its misfit."""
    values, components = forward.select(target.values), target.observation.components
    settings, box, initial = problem.optimiser, problem.box, problem.initial
    spread: list[Evaluation] = []
    evaluate: Evaluate
    if settings.method is Method.SECANTS:
        spread = sample(forward, values, initial, box, components=components)
        evaluate = partial(one_observed, forward, values, components)
    elif gradient is Gradient.AD and isinstance(forward, Differentiable):
        jacobian = settings.method is Method.GAUSS_NEWTON
        evaluate = automatic(forward, values, components=components, with_jacobian=jacobian)
    else:
        evaluate = central(forward, values, problem.steps, components=components)
    return spread + minimise(evaluate, initial, box, settings, sample=spread)
