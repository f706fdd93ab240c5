"""The result of an inversion, and its form in `result.json`."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.command_line import invocation
from datasets.scene import Scene
from datasets.scene.particles import particle_volumes
from datasets.schema import changed
from inverse.answer import UNIFORM, Answer, Combination, MpmRun, Verdict, peak_memory_mib, plain
from inverse.fields.posterior import FieldPosterior
from inverse.observations import Values
from inverse.observations.target import Target
from inverse.parameters import Vector, changed_material
from inverse.posterior.answers import half_widths
from inverse.posterior.posterior import Posterior
from inverse.problem import Problem


@dataclass(frozen=True, kw_only=True)
class Result:
    """The result of an inversion.

    >>> result = solve("friction-tall-42")
    >>> result.verdict, result.unknowns, result.interval
    (<Verdict.CONFIRMED: 'confirmed'>, {'friction_deg': 41.6...}, {'friction_deg': [40.7..., 42.5...]})
    """

    problem: Problem
    target: Target
    verdict: Verdict
    answers: tuple[Answer, ...]
    """Every separate answer that the observation allows; confirmed answers first, then by weight."""
    forward: str
    """The forward model that gives the final prediction: "surrogate" or "MPM"."""
    predicted: Values
    """Its prediction of the observation at the first answer, shape [m]; a surrogate's deposit has its own particles."""
    deposit: NDArray[np.floating]
    """Its deposit at the first answer [m], shape [N, D]."""
    iterations: Sequence[dict[str, Any]] = ()
    """Steps of the search, in the form of `result.json`: loss evaluations, waves of runs or Gauss-Newton steps."""
    mpm_runs: tuple[MpmRun, ...] = ()
    posterior: Posterior | None = None
    """Posterior of the unknown numbers over the whole box."""
    further: dict[str, float] = field(default_factory=dict)
    """If the answer is ambiguous: the most decisive measurements of a deposit, with their information."""
    without: dict[str, dict[str, float]] = field(default_factory=dict)
    """Half-widths by name without each of several observations, and with all (`ALL_DATA`), from the same runs."""
    fields: tuple[FieldPosterior, ...] = ()
    notes: tuple[str, ...] = ()
    """Notes on the uncertainty, in sentences."""
    remark: str = ""
    """An error that the intervals do not include, and why."""
    surrogate: dict[str, Any] | None = None
    """Whether a learned surrogate was used, and why."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Duration [s] of each part of the work, and `total`."""
    record: dict[str, Any] = field(default_factory=dict)
    """Further keys of `result.json`."""
    command: str = field(default_factory=invocation)
    """The command line that produced the result; empty if there was none."""

    @property
    def answer(self) -> Vector:
        """The first answer, shape [U]."""
        return self.answers[0].parameters

    @property
    def unknowns(self) -> dict[str, float]:
        """Name -> median of the first answer's part of the posterior; for a field, its mean over the body."""
        means = {unknown.name: unknown.average(unknown.arrays["mean"]) for unknown in self.fields}
        return self.problem.named(self.answer) | means

    @property
    def certainty(self) -> dict[str, float]:
        """Half of each interval."""
        return {name: 0.5 * (high - low) for name, (low, high) in self.interval.items()}

    @property
    def interval(self) -> dict[str, list[float]]:
        """Name -> ends of the 95 % interval, within the bounds; for a field, the means of both ends over the body."""
        ends = ("lower", "upper")
        of_fields = {unknown.name: [unknown.average(unknown.arrays[end]) for end in ends] for unknown in self.fields}
        return self.problem.named(self.answers[0].interval.T) | of_fields

    @property
    def inside(self) -> list[str]:
        """The numbers whose true value is known and lies within their interval."""
        truth, names = self.target.truth, self.problem.names
        if not truth:
            return []
        held = self.answers[0].holds(np.array([truth[name] for name in names]))
        return [name for name, within in zip(names, held, strict=True) if within]

    @property
    def run_count(self) -> int:
        """Number of MPM runs: search, checks, other cells, coarse surrogate and the twin's own flow."""
        runs = len(self.mpm_runs) + self.record.get("coarse_runs", 0) + self.problem.target.twin
        return int(self.record.get("flows", runs))

    @property
    def error_pct(self) -> dict[str, float]:
        """Known relative errors: of each number in a twin experiment, and of the front if the MPM ran at the answer."""
        truth, values = self.target.truth or {}, self.problem.named(self.answer)
        errors = {name: 100.0 * abs(values[name] - true) / abs(true) for name, true in truth.items() if true != 0.0}
        if self.answers[0].checks and self.answers[0].near and math.isfinite(self.target.front):
            off = [self.target.front_error(check.trajectory) for check in self.answers[0].checks]
            errors["front"] = 100.0 * abs(float(np.mean(off)))
        return errors

    @property
    def scores(self) -> dict[str, dict[str, float]]:
        """Observation name -> scores of how well the deposit at the first answer covers its area [-]."""
        checks, count = self.answers[0].checks, len(self.deposit)
        volumes = checks[0].trajectory.volumes if checks else particle_volumes(self.problem.scene, count)
        parts = self.target.observation.parts
        by_part = {part.name: part.observation.scores(self.deposit, volumes) for part in parts}
        return {name: scores for name, scores in by_part.items() if scores}

    @property
    def remarks(self) -> list[str]:
        """Caveats on the flow that checks the first answer (`mpm.output.outcome.caveats`), whether it drains, where it
        lies if that is not at the answer, and which error the intervals do not include."""
        answer = self.answers[0]
        if not answer.checks:
            return []
        summary, checked = answer.checks[0].trajectory.summary, answer.checks[0].parameters
        at = zip(self.problem.numbers, checked.tolist(), strict=True)
        place = ", ".join(f"{number.name} = {number.kind.text(value)}" for number, value in at)
        far = [] if answer.near else [f"they are at {place}"]
        return [*far, *summary.get("remarks", []), *filter(None, [summary.get("drainage"), self.remark])]

    @property
    def scene(self) -> Scene:
        return self.problem.scene_at(self.answer, fields=[unknown.arrays["mean"] for unknown in self.fields])

    @property
    def samples(self) -> NDArray[np.float64]:
        """Samples of the posterior, in the units of the parameters' names, shape [S, U]."""
        assert self.posterior is not None, "an optimiser has no samples"
        return self.problem.box.at(self.posterior.samples.points)

    @cached_property
    def combinations(self) -> list[Combination]:
        """The principal directions of the posterior, best constrained first, in fractions of the ranges."""
        if self.posterior is None:
            return []
        samples = self.posterior.samples
        _, vectors = np.linalg.eigh(samples.covariance)
        widths = half_widths(samples.points @ vectors, samples.weights, samples.mean @ vectors)
        prior = np.full(len(vectors), UNIFORM)
        if self.problem.prior is not None:
            stated = self.problem.prior.filling @ vectors
            prior = half_widths(stated, np.full(len(stated), 1.0 / len(stated)), stated.mean(axis=0))
        upright = (vector * np.sign(vector[np.argmax(np.abs(vector))]) for vector in vectors.T)
        return [
            Combination(weights=self.problem.named(vector), half_width=float(width), prior=float(before))
            for width, before, vector in zip(widths, prior, upright, strict=True)
        ]

    def as_json(self) -> dict[str, Any]:
        problem, target, fit = self.problem, self.target, self.answers[0].fit
        key, whole = "mpm" if self.forward == "MPM" else "surrogate", target.observation
        numbers = {"target": target.values, key: self.predicted}
        observation: dict[str, Any] = {name: plain(whole.scale * values) for name, values in numbers.items()}
        if len(whole.parts) > 1:
            rows = [(part.name, part.observation.unit, part.numbers.start, part.numbers.stop) for part in whole.parts]
            observation["parts"] = [dict(zip(("name", "unit", "first", "end"), row, strict=True)) for row in rows]
            observation["deviation"] = np.asarray(whole.scale).tolist()
        if math.isfinite(target.front):
            observation["front"] = target.front
        if scores := self.scores:
            observation["scores"] = scores
        if target.profile is not None:
            observation["profile"] = {"x": target.profile.x.tolist(), "height": target.profile.height.tolist()}
        same = len(self.predicted) == len(target.values)
        answers, scene = [], problem.scene
        for answer in self.answers:
            shown = {"unknowns": answer.parameters, "interval": answer.interval.T, "half_widths": answer.half_widths}
            misfit = target.misfit(answer.observation) if answer.checks else None
            named = {name: problem.named(numbers) for name, numbers in shown.items()}
            answers.append(named | {"weight": answer.weight, "misfit": misfit})
        keys: dict[str, Any] = {
            "problem": problem.name,
            "solids": [[solid.name, solid.kind] for solid in scene.solids],
            "angle": {name: found[1].angle for name in problem.names if (found := changed_material(scene, name))},
            "verdict": self.verdict.value,
            "unknowns": self.unknowns,
            "interval": self.interval,
            "certainty": self.certainty,
            "answers": answers,
            "truth": target.truth,
            "error_pct": self.error_pct,
            "observation": observation,
            "loss": {key: target.misfit(self.predicted) if same else self.iterations[-1].get("loss")},
            "mpm_runs": [run.as_json(problem, target) for run in self.mpm_runs],
            "run_count": self.run_count,
            "iterations": list(self.iterations),
            "surrogate": self.surrogate,
            "remarks": self.remarks,
            "seconds": self.seconds,
            "peak_memory_mib": peak_memory_mib(),
        }
        if fit is not None:
            names = ("residual", "inside", "ratio", "allowed", "noise", "scatter", "cells", "outliers", "probability")
            keys |= {"check": {name: getattr(fit, name) for name in names}, "discrepancy": fit.applied}
        if self.posterior is not None:
            samples, columns = self.posterior.samples, ("weights", "half_width", "identifiable")
            keys["combinations"] = [{name: getattr(mixed, name) for name in columns} for mixed in self.combinations]
            sampling = {"difference": samples.difference, "acceptance": samples.acceptance}
            keys["sampling"] = sampling | {"log_evidence": samples.evidence}
        if problem.prior is not None:
            keys["prior"] = {number.name: changed(number.prior) for number in problem.numbers if number.prior}
            keys["correlations"] = [changed(correlation) for correlation in problem.correlations]
        if self.without:
            keys["without"] = self.without
        if self.fields:
            keys["fields"] = [unknown.as_json() for unknown in self.fields]
        return keys | self.record
