"""The baseline that needs no gradient: Optuna proposes, the forward predicts. Every prediction is kept."""

import time
from collections.abc import Sequence
from importlib.util import find_spec

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, FloatDistribution
from optuna.samplers import BaseSampler, CmaEsSampler, TPESampler
from optuna.trial import TrialState
from tqdm import tqdm

from datasets.errors import InputError
from inverse.forward.interface import Evaluation, Forward
from inverse.observations.deposit import Values, loss
from inverse.problem import OptimiserSettings, Problem, Sampler


def explore(
    forward: Forward, target: Values, problem: Problem, *, components: int = 1, at_once: int = 1
) -> list[Evaluation]:
    """Every prediction, in order, beginning at the problem's start; the answer is the one of least loss.

    It ends below the optimiser's `stop_below` or after `max_trials` predictions, `at_once` of which are asked for
    together. components: of the observation, see `inverse.observations.deposit.loss`.
    """
    settings = problem.optimiser
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(sampler=sampler(settings, at_once, problem.initial.tolist(), problem.names))
    study.enqueue_trial(dict(zip(problem.names, problem.initial.tolist(), strict=True)))
    ranges: dict[str, BaseDistribution] = {
        name: FloatDistribution(*bounds) for name, bounds in zip(problem.names, problem.bounds, strict=True)
    }
    records: list[Evaluation] = []
    with tqdm(total=settings.max_trials, desc=settings.sampler, unit="run", leave=False, disable=None) as bar:
        while len(records) < settings.max_trials:
            count = min(at_once, settings.max_trials - len(records))
            trials = [study.ask(ranges) for _ in range(count)]
            points = [np.array([trial.params[name] for name in problem.names]) for trial in trials]
            start = time.perf_counter()
            observations = forward.observe(points)
            share = (time.perf_counter() - start) / count
            for trial, point, observation in zip(trials, points, observations, strict=True):
                value = loss(observation, target, components)
                if np.isfinite(value):
                    study.tell(trial, value)
                else:
                    study.tell(trial, state=TrialState.FAIL)
                records.append(
                    Evaluation(
                        unknowns=point,
                        observation=observation,
                        loss=value,
                        gradient=None,
                        forward_s=share,
                        backward_s=0.0,
                    )
                )
            bar.update(count)
            least = min(record.loss for record in records)
            bar.set_postfix_str(f"loss {least:.2e}")
            if least < settings.stop_below:
                break
    return records


def sampler(settings: OptimiserSettings, at_once: int, initial: Sequence[float], names: Sequence[str]) -> BaseSampler:
    """What proposes the next points. Raises InputError."""
    if settings.sampler is Sampler.TPE:
        # Points that are asked for together must not be the same one.
        return TPESampler(seed=settings.seed, constant_liar=at_once > 1)
    if find_spec("cmaes") is None:
        raise InputError("expected tpe, cma-es wants the package cmaes", key="optimiser.sampler")
    return CmaEsSampler(seed=settings.seed, x0=dict(zip(names, initial, strict=True)))
