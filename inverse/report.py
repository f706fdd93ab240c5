"""`report.md`: conclusion, what was found, comparison with the target, uncertainty, how it was found, cost."""

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context
from tabulate import tabulate

from datasets.files import write_text
from datasets.measures import rms
from inverse import pictures
from inverse.found import IDENTIFIED, Answer, Combination, FoundField, Purpose, Verdict, peak_memory_mib, unidentified
from inverse.noise import CONFIDENCE

if TYPE_CHECKING:
    from inverse.parameters import Parameter
    from inverse.result import Result

NAMED = 4
"""With more numbers than these the conclusion gives the range of their half-widths, tables leave them out."""
MAIN = 0.3
"""Share of the greatest weight from which on one of the `NAMED` heaviest parameters is named in a combination."""
SUGGESTED = 3
"""Measurements, and combinations that are identifiable, that the conclusion names."""


@rc_context(pictures.STYLE)  # type: ignore[arg-type]
def write(found: "Result", folder: Path, command: str) -> None:
    """Write `report.md` and its pictures into `folder`; command: what made it."""
    parts = [f"# {found.problem.name}: {found.verdict}", "\n".join(f"- {each}" for each in conclusion(found))]
    look = f"; in a browser: `python -m validation.view {folder}`" if any(each.file for each in found.mpm_runs) else ""
    parts += [f"`{command}`{look}", question(found)]
    pictures.save(pictures.deposits(found), folder / "deposit.png")
    if len(found.problem.numbers) > 2:
        pictures.draw_unknowns(folder / "unknowns.png", found)
        parts.append("![unknowns](unknowns.png)")
    if len(found.answers) > 1:
        parts += ["## Every separate answer", every_answer(found)]
    for each in found.fields:
        pictures.draw_field(folder / f"{each.stem}.png", each)
        parts += [f"## {each.name}", identified(each), field_table(each), f"![{each.name}]({each.stem}.png)"]
    parts += ["## Comparison with the target", comparison(found), "![deposits](deposit.png)"]
    if notes := uncertainty(found):
        parts += ["## Uncertainty", *notes]
    if found.posterior is not None:
        pictures.draw_posterior(folder / "posterior.png", found)
        parts.append("![prior and posterior](posterior.png)")
    if found.further:
        gains = [{"measurement": name, "information [nat]": f"{gain:.2f}"} for name, gain in found.further.items()]
        parts += [
            "## What a further measurement would decide",
            "Expected information of each about the parameters, beyond what was observed; 0.69 halves one interval.",
            table(gains),
        ]
    parts += ["## How it was found", search_table(found), "## Cost", cost(found)]
    write_text(folder / "report.md", "\n\n".join(part for part in parts if part) + "\n")


def conclusion(found: "Result") -> list[str]:
    """Five sentences: verdict, parameters, what is not identifiable and would decide, truth and fit, cost."""
    runs = f"{found.run_count} MPM runs, " if found.forward == "MPM" else ""
    sentences = [first_found(found), verdict(found), numbers(found), angles(found)]
    sentences += [f"`{each.name}`: {identified(each)}" for each in found.fields]
    sentences += [equifinality(found), quality(found), *(f"At the answer: {each}." for each in found.remarks)]
    return [each for each in (*sentences, f"Cost: {runs}{found.seconds['total']:.1f} s in all.") if each]


def first_found(found: "Result") -> str:
    """What the surrogate found before any run of the MPM, and what the MPM said of it."""
    said, root = found.surrogate or {}, found.target.observation.root_text
    if "answers" not in said:
        return ""
    texts, more = [], len(found.problem.numbers) - NAMED
    for answer in said["answers"]:
        text = named(found, answer["unknowns"].values(), answer["interval"].values())
        text += f" and {more} more" if more > 0 else ""
        texts.append(f"{text}, where the MPM is {root(answer['mpm_error']['misfit'] ** 0.5)} off the target")
    price = f"{said['predictions']} predictions in {said['seconds']:.1f} s"
    return f"The surrogate found {'; or '.join(texts)} ({price})."


def verdict(found: "Result") -> str:
    """The verdict, with the distance from the target and the predictive interval."""
    first, runs = found.answers[0], len(found.answers[0].checks)
    if runs == 0:
        return f"**Unconfirmed**: the {found.forward} alone answers, `python -m validation.loop` has the MPM's word."
    which = f"the mean of {runs} MPM runs at the answer"
    if runs == 1:
        at_answer = first.checks[0].purpose is Purpose.CHECK
        which = "an MPM run at the answer" if at_answer else "the MPM run nearest to the answer"
    count = len(found.answers)
    many = f"{count} separate answers" if count > 1 else "the MPM confirms a whole range of parameters"
    words = {
        Verdict.CONFIRMED: "The MPM confirms",
        Verdict.AMBIGUOUS: f"Ambiguous: {many}",
        Verdict.UNCONFIRMED: "The MPM does not confirm",
        Verdict.UNREACHABLE: "No parameters within the bounds give the target, not even in the MPM",
    }[found.verdict]
    return f"**{words}**: {which} is {distance(found, first)}."


def distance(found: "Result", answer: Answer) -> str:
    """Distance of the MPM at an answer from the target, beside the predictive interval."""
    fit, text = answer.fit, found.target.observation.root_text
    assert fit is not None, "the MPM was asked"
    sources = {"noise": fit.noise, "scatter of flows": fit.scatter, "cells": fit.cells}
    given = ", ".join(f"{name} {text(value)}" for name, value in sources.items() if value > 0.0)
    many = f" (root mean square of {fit.numbers} numbers)" if fit.numbers > 1 else ""
    where = "within" if fit.inside else "outside of"
    return (
        f"{text(fit.residual)} off the target{many}, {where} the {100.0 * CONFIDENCE:g} % predictive interval of "
        f"± {text(fit.allowed)} ({given})"
    )


def numbers(found: "Result") -> str:
    """The numbers with their half-widths, of every answer."""
    every = found.problem.numbers
    if not every:
        return ""
    widths = found.answers[0].half_widths
    if len(every) > NAMED:
        order = np.argsort(widths / found.problem.box.range)
        low, high = (f"{every[at].kind.text(widths[at])} (`{every[at].name}`)" for at in (order[0], order[-1]))
        return f"{len(every)} parameters, with 95 % half-widths from {low} to {high}."
    texts = []
    for answer in found.answers:
        share = f" ({100.0 * answer.weight:.0f} % of the posterior)" if len(found.answers) > 1 else ""
        texts.append(named(found, answer.parameters.tolist(), answer.interval.T.tolist()) + share)
    return f"{'; or '.join(texts)} (95 %)."


def angles(found: "Result") -> str:
    """The angles of friction that were found, as a triaxial test and as a slope would show them."""
    if len(found.problem.numbers) > NAMED:
        return ""
    scene, parts = found.scene, []
    for each in found.problem.numbers:
        if each.name.rsplit(".", 1)[-1] == "friction_deg":
            material = scene.material if each.mass is None else scene.material_of(scene.masses[each.mass])
            both = f"φ = {material.phi_deg:.2f} deg (triaxial), {material.slope_deg:.2f} deg on a slope"
            parts.append(f"`{each.name}` means {both}")
    return sentence(parts)


def named(found: "Result", values: Iterable[float], intervals: Iterable[Sequence[float]]) -> str:
    """The first numbers with their intervals."""
    both = zip(found.problem.numbers[:NAMED], values, intervals, strict=False)
    return ", ".join(f"`{each.name}` = {each.kind.text(value)} ({within(each, ends)})" for each, value, ends in both)


def within(number: "Parameter", ends: Sequence[float]) -> str:
    """An interval in words."""
    return " to ".join(number.kind.text(float(end)) for end in ends)


def equifinality(found: "Result") -> str:
    """What the observation does not constrain, and which measurement would."""
    if found.posterior is None:
        return ""
    parts = [advice] if (advice := finer(found)) else []
    if names := unidentified(found.problem, found.answers[0]):
        known = [mix(each) for each in found.combinations if each.identifiable]
        listed = ", ".join(f"`{name}`" for name in names)
        parts.append(f"Not identifiable: {listed}; constrained: {'; '.join(known[:SUGGESTED]) or 'nothing'}")
    if found.further:
        best = ", ".join([*found.further][:SUGGESTED])
        parts.append(f"most would be decided by {best}")
    return sentence(parts)


def quality(found: "Result") -> str:
    """Errors against the truth, where it is known, and whether the model fits."""
    parts, truth = [], found.target.truth
    if truth:
        every, unknowns = found.problem.numbers, found.unknowns
        worst = max(every, key=lambda each: abs(unknowns[each.name] - truth[each.name]) / each.range)
        error = worst.kind.text(unknowns[worst.name] - truth[worst.name])
        which = "" if len(every) == 1 else f" (`{worst.name}`)"
        inside = f"{len(found.inside)} of {len(truth)} within the interval"
        parts.append(f"error against the truth: {error}{which}, {inside}")
    fit = found.answers[0].fit
    if fit is not None and fit.applied > 1.0:
        times = f"{fit.applied:.2g} times"
        parts.append(f"the fit is {times} worse than noise, scatter and cells explain, the intervals {times} as wide")
    if off := outlying(found):
        parts.append(f"outliers: {', '.join(name for name, _ in off)}")
    return sentence(parts)


def sentence(parts: Sequence[str]) -> str:
    """Parts as a sentence; empty without any."""
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}." if text else ""


def question(found: "Result") -> str:
    """What was asked: the numbers in a table with their bounds and what was found, priors of fields, observations."""
    fields = []
    for field in found.fields:
        settings, nodes = field.unknown.settings, " x ".join(map(str, field.unknown.grid.nodes))
        prior = f"{settings.mean:g} ± {settings.deviation:g} {field.unknown.unit}"
        fields.append(
            f"Unknown: `{field.name}` on {nodes} nodes, prior {prior}, correlation length {settings.length} m."
        )
    counted = Counter(each.name or each.kind for each in found.problem.observations)
    what = ", ".join(name if count == 1 else f"{name} ({count})" for name, count in counted.items())
    if len(found.problem.observations) == 1:
        what = found.target.observation.label
    observed = " ".join([*fields, f"Observed: {what}."])
    truth, intervals, rows = found.target.truth, found.answers[0].interval.T, []
    for index, each in enumerate(found.problem.numbers):
        text, value, (low, high) = each.kind.text, float(found.answer[index]), each.bounds
        row = {"unknown": f"`{each.name}`", "between": f"{low:g}, {high:g}"}
        if found.problem.prior is not None:
            row["prior"] = "uniform" if each.prior is None else each.prior.text
        row["start"] = text(each.start)
        row["found"] = f"**{text(value)}**"
        row["95 %"] = within(each, intervals[index])
        if truth:
            row |= {"truth": text(truth[each.name]), "error": text(value - truth[each.name])}
            row["truth inside"] = "yes" if each.name in found.inside else "**no**"
        rows.append(row)
    return observed + (f"\n\n{table(rows)}" if rows else "")


def every_answer(found: "Result") -> str:
    """A line for each."""
    rows = []
    for each in found.answers:
        both = zip(found.problem.numbers, each.parameters.tolist(), each.interval.T, strict=True)
        row = {f"`{own.name}`": f"{own.kind.text(value)} ({within(own, ends)})" for own, value, ends in both}
        row["share of the posterior"] = f"{100.0 * each.weight:.0f} %"
        row["the MPM there"] = "not asked" if each.fit is None else distance(found, each)
        rows.append(row)
    return table(rows)


def comparison(found: "Result") -> str:
    """Each observation as it was measured and at the answer."""
    whole, target, shown = found.target.observation, found.target, found.predicted
    scale = whole.raw(np.ones(len(target.values)))
    same, rows, runs = len(shown) == len(target.values), [], len(found.answers[0].checks)
    which = f"{found.forward}, at the answer" + (f", {runs} runs" if runs > 1 else "")
    for part in whole.parts:
        own, text, root = part.numbers, part.observation.text, part.observation.root_text
        measured = whole.raw(target.values)[own]
        answer = whole.raw(shown)[own] if same else shown
        noise, residual = rms(target.deviation[own] * scale[own]), rms(answer - measured) if same else np.nan
        row = {"observation": part.name, "target": text(measured), which: text(answer)}
        row["noise"] = root(noise)
        row["residual (root mean square)"] = root(residual)
        rows.append(row)
    return table(rows)


def identified(field: FoundField) -> str:
    """Which part of a field the observation tells, in a sentence."""
    inside, box = field.unknown.inside, field.identified_box()
    if box is None:
        return f"The observation removes less than {100.0 * IDENTIFIED:.0f} % of the prior's variance of every value."
    share = float(field.identified[inside].mean())
    between = ", ".join(f"{name} from {low:.3g} to {high:.3g} m" for name, (low, high) in zip("xyz", box, strict=False))
    return (
        f"The observation removes more than {100.0 * IDENTIFIED:.0f} % of the prior's variance of "
        f"{100.0 * share:.0f} % of the values, all of them at {between}; of the others the prior says more than "
        "the observation."
    )


def field_table(field: FoundField) -> str:
    """Widths and, of a twin, errors: of all values and of those that are identified."""
    unit, inside, rows = field.unknown.unit, field.unknown.inside, []
    for name, where in (("all", inside), ("identified", field.identified), ("others", inside & ~field.identified)):
        if not where.any():
            continue
        row = {"": name, "values": str(int(where.sum()))}
        row[f"deviation, prior [{unit}]"] = f"{field.arrays['prior_deviation'][where].mean():.3g}"
        row[f"posterior [{unit}]"] = f"{field.arrays['deviation'][where].mean():.3g}"
        if field.truth is not None:
            row[f"error of the prior's mean [{unit}]"] = f"{field.error(where, field.unknown.settings.mean):.3g}"
            row[f"of the found field [{unit}]"] = f"{field.error(where):.3g}"
            row["truth within 95 %"] = f"{100.0 * (field.covered(where) or 0.0):.0f} %"
        rows.append(row)
    return table(rows)


def uncertainty(found: "Result") -> list[str]:
    """What the intervals are made of."""
    parts = list(found.notes)
    if found.target.roughness > 1.0:
        parts.append(
            f"The measured heights scatter about their neighbours by {found.target.roughness:.2g} times the stated "
            "noise: so much noise is counted."
        )
    if (fit := found.answers[0].fit) is not None:
        widths = "stay" if fit.applied == 1.0 else f"are {fit.applied:.2g} times as wide"
        against = f"{fit.ratio:.2g} times what noise, scatter and cells explain (p = {fit.probability:.2g})"
        parts.append(f"Residuals are {against}: **the intervals {widths}**.")
        if fit.outliers:
            listed = ", ".join(f"{name} ({off:+.1f})" for name, off in outlying(found))
            parts.append(f"**Outliers**, in standard deviations from what all other numbers predict: {listed}.")
    if len(found.combinations) > 1:
        words = {True: "**Identifiable**", False: "**Not identifiable**"}
        parts.append("\n".join(f"- {words[each.identifiable]}: {mix(each, ',')}." for each in found.combinations))
    return parts


def outlying(found: "Result") -> list[tuple[str, float]]:
    """Outliers of the first answer by observation and place in it, with their standardised residuals."""
    fit, parts = found.answers[0].fit, found.target.observation.parts
    names = [f"{part.name} {n + 1}" for part in parts for n in range(len(found.target.values[part.numbers]))]
    return [] if fit is None else [(names[index], off) for index, off in fit.outliers.items()]


def finer(found: "Result") -> str:
    """The cells whose error would be the noise's, where that of the scene's is larger, and their price.

    The error is that of the cell beyond the target's, 0 in nature; work grows by the power dimension + 1 of 1 / cell.
    """
    fit, cell, own = found.answers[0].fit, found.problem.scene.domain.cell, found.target.cell or 0.0
    if fit is None or not 0.0 < fit.noise < fit.cells or own >= cell:
        return ""
    share = fit.cells / fit.noise
    enough = own + (cell - own) / share
    times = (cell / enough) ** (found.problem.scene.dimension + 1)
    seconds = float(np.mean([each.seconds for each in found.answers[0].checks]))
    price = f", {times * seconds:.2g} s instead of {seconds:.2g} s a run" if seconds > 0.0 else ""
    return (
        f"finer cells first: the error of the cells is {share:.2g} times the noise, as large as it on cells of "
        f"{enough:.2g} m ({times:.2g} times the work{price})"
    )


def mix(combination: Combination, comma: str = "") -> str:
    """A combination in words: which parameters go up, which go down with them, and how well it is known."""
    weights = combination.weights
    heaviest = sorted(weights, key=lambda name: -abs(weights[name]))[:NAMED]
    heavy = [name for name in weights if name in heaviest and abs(weights[name]) >= MAIN * abs(weights[heaviest[0]])]
    up = " and ".join(f"`{name}`" for name in heavy if weights[name] > 0.0)
    down = " and ".join(f"`{name}`" for name in heavy if weights[name] <= 0.0)
    together = " up or down together" if len(heavy) > 1 else ""
    text = f"{up} up while {down} down" if down else f"{up}{together}"
    return f"{text}{comma} to ± {100.0 * combination.half_width:.2g} % of the range"


def search_table(found: "Result") -> str:
    """Every iteration; the MPM runs at answers."""
    rows = []
    for record in found.iterations:
        row: dict[str, Any] = {}
        for key, value in record.items():
            if isinstance(value, dict) and key in ("unknowns", "mean", "deviation") and len(value) <= NAMED:
                row |= {f"{'' if key == 'unknowns' else key + ', '}`{name}`": number for name, number in value.items()}
            elif isinstance(value, bool | int | float):
                row[key.replace("_", " ")] = value
        rows.append(row)
    said = f"Surrogate: {found.surrogate['reason']}.\n\n" if found.surrogate else ""
    return said + tabulate(rows, headers="keys", tablefmt="pipe", floatfmt=".4g")


def cost(found: "Result") -> str:
    """Runs, seconds and memory."""
    every = [each.purpose for each in found.mpm_runs]
    runs = {"MPM runs": found.run_count} if every else {}
    runs |= {f"of them, {purpose}": every.count(purpose) for purpose in Purpose if purpose in every}
    runs |= {"of them, the twin's own flow": 1} if found.problem.target.twin and every else {}
    counts = {key.replace("_", " "): value for key, value in found.record.items() if isinstance(value, int)}
    seconds = {f"{key.replace('_', ' ')} [s]": f"{value:.2f}" for key, value in found.seconds.items()}
    seconds["peak memory"] = f"{peak_memory_mib():.0f} MiB"
    budget = "\n\nThe budget `mpm_runs` is of those on the problem's own cells, the twin's excepted." if every else ""
    return table([{key: str(value) for key, value in (runs | counts | seconds).items()}]) + budget


def table(rows: Sequence[dict[str, str]]) -> str:
    """A table in Markdown of rows by column, whose cells are text already."""
    return tabulate(rows, headers="keys", tablefmt="pipe", disable_numparse=True)


def summary(found: "Result") -> str:
    """The outcome for the terminal: the conclusion of the report."""
    lines = "".join(f"\n  {each}" for each in conclusion(found)).replace("**", "").replace("`", "")
    return f"{found.problem.name}: {found.verdict}{lines}"
