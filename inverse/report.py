"""`report.md`: conclusion, answers, comparison with the target, uncertainty, how the answers were found, cost."""

import shlex
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from datasets.flow.measures import rms
from datasets.markdown import markdown_table
from inverse.answer import Answer, Combination, Purpose, Verdict, peak_memory_mib, unidentified
from inverse.fields.posterior import IDENTIFIED, FieldPosterior
from inverse.noise import CONFIDENCE
from inverse.observations.target import ALL_DATA
from inverse.parameters import Parameter, changed_material
from inverse.residuals import other_units, outlying, places_of, residuals
from inverse.result import Result

NAMED = 4  # with more unknowns the conclusion gives the range of their half-widths, and tables omit them
MAIN = 0.3  # a combination names those of its `NAMED` heaviest parameters with this share of the largest weight or more
SUGGESTED = 3  # number of measurements, and of identifiable combinations, that the conclusion names
DECISIVE = 0.2  # least information [nat] of a measurement in the conclusion: the noise of few runs can feign less
LARGER, FINEST = 1.5, 8.0
"""Error of the cells over the noise above which the report advises finer cells, and up to which it gives their size."""


def markdown(result: Result, folder: Path, pictures: Collection[str]) -> str:
    """The text of the report in `folder`; pictures: names of the picture files beside it."""

    def shown(name: str, text: str) -> str:
        return f"![{text}]({name})" if name in pictures else ""

    made = [f"`{result.command}`"] if result.command else []
    if any(run.file for run in result.mpm_runs):
        made.append(f"In a browser: `python -m validation.view {shlex.quote(str(folder))}`")
    parts = [f"# {result.problem.name}: {result.verdict}", "\n".join(f"- {line}" for line in conclusion(result))]
    parts += ["; ".join(made), question(result), shown("unknowns.png", "unknowns")]
    if len(result.answers) > 1:
        parts += ["## Every separate answer", every_answer(result)]
    for field in result.fields:
        parts += [f"## {field.name}", field_table(field), shown(f"{field.stem}.png", field.name)]
    parts += ["## Comparison with the target", comparison(result), shown("deposit.png", "deposits")]
    if fits := residuals(result):
        listed, picture = markdown_table([row for fit in fits for row in fit.rows]), "the fit over time or place"
        first = result.answers[0].fit
        said = outlying(fits, len(first.outliers) if first else 0)
        parts += ["## The fit, number by number", said, listed, shown("fit.png", picture)]
    if result.without:
        parts += ["## Which data matter", data_that_matter(result)]
    if notes := uncertainty(result):
        parts += ["## Uncertainty", *notes]
    parts.append(shown("posterior.png", "prior and posterior"))
    if result.further:
        gains = [{"measurement": name, "information [nat]": f"{gain:.2f}"} for name, gain in result.further.items()]
        parts += ["## What a further measurement would decide", markdown_table(gains)]
    parts += ["## How it was found", search_table(result), "## Cost", cost(result)]
    return "\n\n".join(part for part in parts if part) + "\n"


def conclusion(result: Result) -> list[str]:
    """The main sentences: verdict, parameters, identifiability, decisive measurements, truth and fit, cost."""
    runs = f"{result.run_count} MPM runs, " if result.forward == "MPM" else ""
    where = "At the answer" if result.answers[0].near else "In the runs that check the answer"
    sentences = [first_found(result), verdict(result), numbers(result), angles(result)]
    sentences += [f"`{field.name}`: {identified(field)}" for field in result.fields]
    sentences += [equifinality(result), quality(result), *(f"{where}: {remark}." for remark in result.remarks)]
    return [line for line in (*sentences, f"Cost: {runs}{result.seconds['total']:.1f} s in all.") if line]


def first_found(result: Result) -> str:
    """The surrogate's answers before any MPM run, and their misfit in the MPM."""
    said, root = result.surrogate or {}, result.target.observation.root_text
    if "answers" not in said:
        return ""
    texts, more = [], len(result.problem.numbers) - NAMED
    others = f" and {more} more" if more > 0 else ""
    for answer in said["answers"]:
        text = named(result, answer["unknowns"].values(), answer["interval"].values())
        off = root(answer["mpm_error"]["misfit"] ** 0.5)
        texts.append(f"{text}{others}; the MPM there differs from the observation by {off}")
    return f"The surrogate found {'; or '.join(texts)} ({said['predictions']} predictions in {said['seconds']:.1f} s)."


def verdict(result: Result) -> str:
    first, runs = result.answers[0], len(result.answers[0].checks)
    if runs == 0:
        return "**Unconfirmed**: no run of the MPM checks this answer; `python -m validation.loop` makes such runs."
    which = f"the mean of {runs} MPM runs near the answer, interpolated to it,"
    if runs == 1:
        which = f"the MPM run {'at' if first.checks[0].purpose is Purpose.CHECK else 'nearest to'} the answer"
    count = len(result.answers)
    many = f"{count} separate answers" if count > 1 else "the MPM confirms a whole range of parameters"
    words = {
        Verdict.CONFIRMED: "The MPM confirms",
        Verdict.AMBIGUOUS: f"Ambiguous: {many}",
        Verdict.UNCONFIRMED: "The MPM does not confirm",
        Verdict.UNREACHABLE: "No parameters within the bounds give the target, not even in the MPM",
    }[result.verdict]
    return f"**{words}**: {which} is {distance(result, first)}."


def distance(result: Result, answer: Answer) -> str:
    fit, text = answer.fit, result.target.observation.root_text
    assert fit is not None, "the MPM was asked"
    sources = {"noise": fit.noise, "scatter of flows": fit.scatter, "cells": fit.cells}
    given = ", ".join(f"{name} {text(value)}" for name, value in sources.items() if value > 0.0)
    many = f" (root mean square of {fit.numbers} numbers)" if fit.numbers > 1 else ""
    where = "within" if fit.inside else "outside of"
    return (
        f"{text(fit.residual)} from the observation{many}, {where} the {100.0 * CONFIDENCE:g} % predictive interval of "
        f"± {text(fit.allowed)} ({given})"
    )


def numbers(result: Result) -> str:
    every = result.problem.numbers
    if not every:
        return ""
    widths = result.answers[0].half_widths
    if len(every) > NAMED:
        order = np.argsort(widths / result.problem.box.range)
        low, high = (f"{every[at].kind.text(widths[at])} (`{every[at].name}`)" for at in order[[0, -1]])
        return f"{len(every)} parameters, with 95 % half-widths from {low} to {high}."
    texts = []
    for answer in result.answers:
        share = f" ({100.0 * answer.weight:.0f} % of the posterior)" if len(result.answers) > 1 else ""
        texts.append(named(result, answer.parameters.tolist(), answer.interval.T.tolist()) + share)
    return f"{'; or '.join(texts)} (95 %)."


def angles(result: Result) -> str:
    """The friction angles of the answer, as measured in a triaxial test and on a slope."""
    if len(result.problem.numbers) > NAMED:
        return ""
    scene, parts = result.scene, []
    for number in result.problem.numbers:
        if number.quantity == "friction_deg" and (changed := changed_material(scene, number.name)):
            both = f"φ = {changed[1].phi_deg:.2f} deg (triaxial), {changed[1].slope_deg:.2f} deg on a slope"
            parts.append(f"`{number.name}` means {both}")
    return sentence(parts)


def with_intervals(result: Result, values: Iterable[float], intervals: Iterable[Sequence[float]]) -> dict[str, str]:
    """The numbers with their intervals, by name."""
    every = zip(result.problem.numbers, values, intervals, strict=True)
    return {f"`{number.name}`": f"{number.kind.text(value)} ({within(number, ends)})" for number, value, ends in every}


def named(result: Result, values: Iterable[float], intervals: Iterable[Sequence[float]]) -> str:
    """The first `NAMED` numbers with their intervals, as text."""
    return ", ".join([f"{name} = {text}" for name, text in with_intervals(result, values, intervals).items()][:NAMED])


def within(number: Parameter, ends: Sequence[float]) -> str:
    return " to ".join(number.kind.text(float(end)) for end in ends)


def equifinality(result: Result) -> str:
    """The parameters that the observation does not constrain, and the measurements that would."""
    if result.posterior is None:
        return ""
    parts = [advice] if (advice := finer(result)) else []
    if names := unidentified(result.problem, result.answers[0]):
        listed, alone = ", ".join(f"`{name}`" for name in names), [[name] for name in names]
        known = [mixed for mixed in result.combinations if mixed.identifiable and heavy(mixed) not in alone]
        constrained = "; ".join(map(mix, known[:SUGGESTED]))
        parts.append(f"Not identifiable: {listed}; constrained: {constrained or 'nothing'}")
    if result.further:
        best = ", ".join([name for name, gain in result.further.items() if gain >= DECISIVE][:SUGGESTED])
        parts.append(f"most would be decided by {best}" if best else "no other measurement would decide much")
    return sentence(parts)


def quality(result: Result) -> str:
    """Errors against the truth, if it is known, and whether the model fits."""
    parts, truth = [], result.target.truth
    if truth:
        every, unknowns = result.problem.numbers, result.unknowns
        worst = max(every, key=lambda number: abs(unknowns[number.name] - truth[number.name]) / number.range)
        error = worst.kind.text(unknowns[worst.name] - truth[worst.name])
        which = "" if len(every) == 1 else f" (`{worst.name}`)"
        inside = f"{len(result.inside)} of {len(truth)} true values within their intervals"
        if len(truth) == 1:
            inside = f"the true value lies {'within' if result.inside else 'outside of'} the interval"
        parts.append(f"error against the truth: {error}{which}, {inside}")
    fit = result.answers[0].fit
    if fit is not None and fit.applied > 1.0:
        times = f"{fit.applied:.2g} times"
        wider = f"noise and scatter count {times}" if fit.spared else f"the intervals are {times} as wide"
        parts.append(f"the fit is {times} worse than noise, scatter and cells explain, so {wider}")
    if fit is not None and fit.outliers:
        names = [name for part in result.target.observation.parts for name in places_of(part)]
        listed = ", ".join(f"{names[index]} ({off:+.1f})" for index, off in fit.outliers.items())
        parts.append(f"outliers, in standard deviations from what all other numbers predict: {listed}")
    return sentence([*parts, *other_units(result)])


def sentence(parts: Sequence[str]) -> str:
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}." if text else ""


def question(result: Result) -> str:
    """The problem: priors of fields, observations, and a table of the unknown numbers with bounds and values."""
    fields = []
    for field in result.fields:
        settings, nodes = field.unknown.settings, " x ".join(map(str, field.unknown.grid.nodes))
        prior = f"{settings.mean:g} ± {settings.deviation:g} {field.unknown.unit}".rstrip()
        zones = f"in {nodes} zones, prior {prior}, independent"
        where = f"on {nodes} nodes, prior {prior}, correlation length {settings.length} m"
        fields.append(f"Unknown: `{field.name}` {where if settings.zones is None else zones}.")
    counted = Counter(observation.name or observation.kind for observation in result.problem.observations)
    what = ", ".join(name if count == 1 else f"{name} ({count})" for name, count in counted.items())
    if len(result.problem.observations) == 1:
        what = result.target.observation.label
    observed = " ".join([*fields, f"Observed: {what}."])
    truth, intervals, rows = result.target.truth, result.answers[0].interval.T, []
    for index, number in enumerate(result.problem.numbers):
        text, value, (low, high) = number.kind.text, float(result.answer[index]), number.bounds
        row = {"unknown": f"`{number.name}`", "between": f"{low:g}, {high:g}"}
        if result.problem.prior is not None:
            row["prior"] = "uniform" if number.prior is None else number.prior.text
        row |= {"start": text(number.start), "found": f"**{text(value)}**", "95 %": within(number, intervals[index])}
        if truth:
            row |= {"truth": text(truth[number.name]), "error": text(value - truth[number.name])}
            row["truth inside"] = "yes" if number.name in result.inside else "**no**"
        rows.append(row)
    if (origin := result.problem.scene.domain.origin) is not None:
        place = ", ".join(f"{coordinate:.10g}" for coordinate in origin)
        observed += f" Lengths below count from the lower corner of the box, at {place} m on the map."
    return observed + (f"\n\n{markdown_table(rows)}" if rows else "")


def every_answer(result: Result) -> str:
    rows = []
    for answer in result.answers:
        row = with_intervals(result, answer.parameters.tolist(), answer.interval.T.tolist())
        there = "not asked" if answer.fit is None else distance(result, answer)
        rows.append(row | {"share of the posterior": f"{100.0 * answer.weight:.0f} %", "the MPM there": there})
    return markdown_table(rows)


def comparison(result: Result) -> str:
    target, rows, runs = result.target, [], len(result.answers[0].checks)
    numbers = (target.values, result.predicted, target.deviation)
    measured, shown, deviation = (target.observation.scale * values for values in numbers)
    which = f"{result.forward}, at the answer" + (f", {runs} runs" if runs > 1 else "")
    for part in target.observation.parts:
        span, text, root = part.numbers, part.observation.text, part.observation.root_text
        off = rms(shown[span] - measured[span]) if len(shown) == len(measured) else np.nan
        row = {"observation": part.name, "target": text(measured[span]), which: text(shown[span])}
        row |= {"noise": root(rms(deviation[span])), "residual (root mean square)": root(off)}
        row |= {name.replace("_", " "): f"{score:.3f}" for name, score in result.scores.get(part.name, {}).items()}
        rows.append(row)
    return markdown_table(rows)


def data_that_matter(result: Result) -> str:
    """Half-widths of the numbers without each observation, from the same runs."""
    whole, rows = result.without[ALL_DATA], []
    for name, widths in result.without.items():
        row = {"left out": "nothing" if name == ALL_DATA else name}
        for number in result.problem.numbers[:NAMED]:
            width, share = widths[number.name], widths[number.name] / max(whole[number.name], 1e-300)
            row[f"± `{number.name}` (95 %)"] = f"{number.kind.text(width)} ({share:.2g} times)"
        rows.append(row)
    said = "Half-widths without each observation, from the same runs, with an emulator over the whole box."
    fit = result.answers[0].fit
    if fit is not None and fit.applied > 1.0:
        said += f" Every row keeps the factor {fit.applied:.2g} that the misfit of all data together gives."
    return f"{said}\n\n{markdown_table(rows)}"


def identified(field: FieldPosterior) -> str:
    inside, box = field.unknown.inside, field.identified_box()
    if box is None:
        return f"The observation removes less than {100.0 * IDENTIFIED:.0f} % of the prior variance of every value."
    share = float(field.identified[inside].mean())
    axes = field.unknown.axes
    between = ", ".join(f"{name} from {low:.3g} to {high:.3g} m" for name, (low, high) in zip(axes, box, strict=False))
    where = f"all of them at {between}"
    if field.unknown.zones is not None:
        numbers = field.unknown.zones.numbers[field.identified]
        where = f"of the zones {', '.join(f'{number:g}' for number in numbers)}"
    rest = "; the prior determines the other values more than the observation does" if share < 1.0 else ""
    return (
        f"The observation removes more than {100.0 * IDENTIFIED:.0f} % of the prior variance for {100.0 * share:.0f} % "
        f"of the values, {where}{rest}."
    )


def field_table(field: FieldPosterior) -> str:
    """Widths and, for a twin, errors: for all values, the identified ones and the others."""
    unit, inside, rows = field.unknown.unit, field.unknown.inside, []
    unit = f" [{unit}]" if unit else ""
    for name, where in (("all", inside), ("identified", field.identified), ("others", inside & ~field.identified)):
        if not where.any():
            continue
        before, after = (field.arrays[name][where].mean() for name in ("prior_deviation", "deviation"))
        row = {"": name, "values": str(int(where.sum()))}
        row |= {f"deviation, prior{unit}": f"{before:.3g}", f"posterior{unit}": f"{after:.3g}"}
        if field.truth is not None:
            row[f"error of the prior's mean{unit}"] = f"{field.error(where, field.unknown.settings.mean):.3g}"
            row[f"of the found field{unit}"] = f"{field.error(where):.3g}"
            row["truth within 95 %"] = f"{100.0 * (field.covered(where) or 0.0):.0f} %"
        rows.append(row)
    return markdown_table(rows)


def uncertainty(result: Result) -> list[str]:
    """What the intervals include, and how well combinations of the numbers are known."""
    parts, rough = list(result.notes), result.target.roughness
    if rough > 1.0:
        times = f"{rough:.2g} times the stated noise"
        parts.append(f"The measured heights scatter about their neighbours by {times}, which is used instead.")
    if len(result.combinations) > 1:
        words = {True: "**Identifiable**", False: "**Not identifiable**"}
        parts.append("\n".join(f"- {words[row.identifiable]}: {mix(row, ',')}." for row in result.combinations))
    return parts


def finer(result: Result) -> str:
    """The cell size whose error would equal the noise, and its cost; empty unless the scene's cells err more. The error
    is proportional to the cell minus the target's, 0 in nature; work to (1 / cell)^(dimension + 1)."""
    fit, cell, target_cell = result.answers[0].fit, result.problem.scene.domain.cell, result.target.cell or 0.0
    if fit is None or not 0.0 < LARGER * fit.noise < fit.cells or target_cell >= cell:
        return ""
    if (share := fit.cells / fit.noise) > FINEST:
        return f"finer cells first: the error of the cells is {share:.2g} times the noise, and falls with the cell size"
    enough = target_cell + (cell - target_cell) / share
    times = (cell / enough) ** (result.problem.scene.dimension + 1)
    seconds = float(np.mean([check.seconds for check in result.answers[0].checks]))
    price = f", {times * seconds:.2g} s instead of {seconds:.2g} s per run" if seconds > 0.0 else ""
    return (
        f"finer cells first: the error of the cells is {share:.2g} times the noise; both would be equal on cells of "
        f"{enough:.2g} m ({times:.2g} times the work{price})"
    )


def heavy(combination: Combination) -> list[str]:
    """The parameters that make up most of a combination."""
    weights = combination.weights
    heaviest = sorted(weights, key=lambda name: -abs(weights[name]))[:NAMED]
    return [name for name in weights if name in heaviest and abs(weights[name]) >= MAIN * abs(weights[heaviest[0]])]


def mix(combination: Combination, comma: str = "") -> str:
    """A combination in words: which parameters increase, which decrease with them, and its half-width."""
    weights, names = combination.weights, heavy(combination)
    up = " and ".join(f"`{name}`" for name in names if weights[name] > 0.0)
    down = " and ".join(f"`{name}`" for name in names if weights[name] <= 0.0)
    together = " up or down together" if len(names) > 1 else ""
    text = f"{up} up while {down} down" if down else f"{up}{together}"
    return f"{text}{comma} to ± {100.0 * combination.half_width:.2g} % of the range"


def search_table(result: Result) -> str:
    rows = []
    for record in result.iterations:
        row: dict[str, Any] = {}
        for key, value in record.items():
            if isinstance(value, dict) and key in ("unknowns", "mean", "deviation") and len(value) <= NAMED:
                row |= {f"{'' if key == 'unknowns' else key + ', '}`{name}`": number for name, number in value.items()}
            elif isinstance(value, bool):
                row[key.replace("_", " ")] = "yes" if value else "no"
            elif isinstance(value, int | float):
                row[key.replace("_", " ")] = value
        rows.append(row)
    reason = f"Surrogate: {result.surrogate['reason']}.\n\n" if result.surrogate else ""
    return reason + markdown_table(rows, disable_numparse=False, floatfmt=".4g")


def cost(result: Result) -> str:
    every = [run.purpose for run in result.mpm_runs]
    runs = {"MPM runs": result.run_count} if every else {}
    runs |= {f"for {purpose}": every.count(purpose) for purpose in Purpose if purpose in every}
    runs |= {"for the twin": 1} if result.problem.target.twin and every else {}
    counts = {key.replace("_", " "): value for key, value in result.record.items() if isinstance(value, int)}
    seconds = {f"{key.replace('_', ' ')} [s]": f"{value:.2f}" for key, value in result.seconds.items()}
    seconds["peak memory"] = f"{peak_memory_mib():.0f} MiB"
    return markdown_table([{key: str(value) for key, value in (runs | counts | seconds).items()}])


def summary(result: Result) -> str:
    """The conclusion of the report, for the terminal."""
    lines = "".join(f"\n  {line}" for line in conclusion(result)).replace("**", "").replace("`", "")
    return f"{result.problem.name}: {result.verdict}{lines}"
