"""`report.md` of an inversion for fields, with its pictures and files."""

from pathlib import Path

from datasets.files import write_text
from inverse.fields import pictures
from inverse.fields.result import IDENTIFIED, FieldResult, FoundField
from inverse.report.markdown import markdown_table

LEFT = 2.0
"""Promised decrease of the objective beyond which the report says so: two standard deviations along one direction."""


def write(result: FieldResult, folder: Path) -> None:
    """Write everything that a command leaves into `folder`."""
    result.write(folder)
    for each in result.fields:
        pictures.draw_field(folder / picture_of(each), each)
    pictures.draw_observation(folder / "observation.png", result)
    write_text(folder / "report.md", "\n\n".join(lines(result)) + "\n")


def picture_of(found: FoundField) -> str:
    """The name of the picture of a field."""
    return f"{found.unknown.name.replace('.', '-')}.png"


def lines(result: FieldResult) -> list[str]:
    """The paragraphs of the report."""
    price = result.price
    parts = [f"# {result.problem.name}: {result.verdict}", *sentences(result)]
    for each in result.fields:
        parts += [
            f"## {each.unknown.name}",
            identified(each),
            table_of(each),
            f"![{each.unknown.name}]({picture_of(each)})",
        ]
    steps = [
        [str(index), f"{each.objective:.1f}", f"{each.misfit:.2f}", f"{each.step:g}"]
        for index, each in enumerate(result.iterates)
    ]
    parts += [
        "## Observation",
        "Each number, in standard deviations of one run from what was observed (errors of measurement, scatter of two "
        "flows); the bar is the mean of the seeds of the search.",
        "![observation](observation.png)",
        "## How it was found",
        markdown_table(["iteration", "objective", "misfit [-]", "part of the step"], steps),
        "## Cost",
        f"{price.seconds:.0f} s ({price.processor_s:.0f} s of processors), {price.runs} MPM runs, {price.reverses} "
        f"reverse passes ({price.combinations} combinations of {len(result.target.values)} numbers in every Jacobian).",
    ]
    return parts


def sentences(result: FieldResult) -> list[str]:
    """What was found, in sentences made from the numbers."""
    values = sum(int(each.unknown.inside.sum()) for each in result.fields)
    within = "within" if result.distance <= result.tolerance else "beyond"
    found = [
        f"{values} values from {len(result.target.values)} numbers: {result.posterior.informative} directions of the "
        "fields in which the observation tells more than the prior.",
        f"A run with another jitter seed is {result.distance:.2f} standard deviations from the observation (root mean "
        f"square), {within} the {result.tolerance:.2f} that chance allows.",
    ]
    if result.promised > LEFT:
        found.append(
            f"**The search ended where its derivatives promise {result.promised:.1f} more of the objective, which no "
            "step brought: the fields are known less well than their widths say. More `search.seeds` make derivatives "
            "smoother.**"
        )
    return found


def identified(found: FoundField) -> str:
    """Which part of a field the observation tells, in a sentence."""
    inside, box = found.unknown.inside, found.identified_box()
    share = float(found.identified[inside].mean())
    if box is None:
        return f"The observation removes less than {100.0 * IDENTIFIED:.0f} % of the prior's variance of every value."
    between = ", ".join(f"{name} from {low:.3g} to {high:.3g} m" for name, (low, high) in zip("xyz", box, strict=False))
    return (
        f"The observation removes more than {100.0 * IDENTIFIED:.0f} % of the prior's variance of "
        f"{100.0 * share:.0f} % of the values, all of them at {between}; of the others the prior says more than "
        "the observation."
    )


def table_of(found: FoundField) -> str:
    """Widths and, of a twin, errors: of all values and of those that are identified."""
    unit = found.unknown.unit
    head = ["", "values", f"deviation, prior [{unit}]", f"posterior [{unit}]"]
    identified, inside = found.identified, found.unknown.inside
    rows = []
    for name, where in (("all", inside), ("identified", identified), ("others", inside & ~identified)):
        if not where.any():
            continue
        row = [
            name,
            str(int(where.sum())),
            f"{found.prior_deviation[where].mean():.3g}",
            f"{found.deviation[where].mean():.3g}",
        ]
        if found.truth is not None:
            before, after = found.error(where, found.unknown.settings.mean), found.error(where)
            covered = found.covered(where)
            row += [f"{before:.3g}", f"{after:.3g}", f"{100.0 * (covered or 0.0):.0f} %"]
        rows.append(row)
    if found.truth is not None:
        head += [f"error of the prior's mean [{unit}]", f"of the found field [{unit}]", "truth within 95 %"]
    return markdown_table(head, rows)
