"""`gns.md`: sections and tables, and the conclusion made of them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf

import numpy as np

from validation.bench.surrogate import rest
from validation.bench.surrogate.accuracy import Accuracy
from validation.bench.surrogate.calibration import COVERAGE, LEVEL, Coverage, Warnings
from validation.bench.surrogate.friction import OBSERVED, STEP_DEG, WITHIN, Strengths, within
from validation.bench.surrogate.held_out import SEED
from validation.bench.surrogate.models import Model
from validation.bench.surrogate.price import Prices, said
from validation.bench.surrogate.rest import Rest
from validation.bench.surrogate.scores import Deposit, Score, mean, rms, worst
from validation.bench.surrogate.velocities import CRITERIA, Gradients
from validation.report.page import GNS, MPM, Page, Row, signed

COMMAND = "python -m validation.bench surrogate --out docs"
FRONT = {2: (0.01, 0.04), 3: (0.02, inf)}
"""Criteria of the front by dimension: mean and worst over the extent [-]."""
TRANSPORT, ENERGY, RUNOUT, DEPTH = 0.02, 0.05, 0.03, 0.06
"""Other criteria: mean profile, largest difference of an energy, largest x, depth upstream of baffles [-]."""
ALL = "all"


@dataclass(frozen=True, kw_only=True)
class Found:
    """All that was measured; what was not is empty. By dimension where there can be two."""

    models: Sequence[Model]
    accuracy: Mapping[int, Accuracy] = field(default_factory=dict)
    prices: Mapping[int, Prices] = field(default_factory=dict)
    gradients: Sequence[Gradients] = ()
    friction: Mapping[str, Sequence[Strengths]] = field(default_factory=dict)
    rest: Mapping[int, Rest] = field(default_factory=dict)
    coverages: Mapping[str, Coverage | str] = field(default_factory=dict)
    warnings: Mapping[str, Warnings] = field(default_factory=dict)


def page(found: Found, *, quick: bool, flags: str = "") -> Page:
    """The page; sections without measurements are left out. flags: of the command that measured."""
    text = Page(
        "The surrogate beside the MPM",
        command=f"{COMMAND}{flags}",
        conclusion=conclusion(found),
        packages=GNS | MPM,
        quick=quick,
    )
    text.text(f"""
        The models against the MPM on fine cells, on scenes that are in no training data: drawn by the definition that
        draws the training data with seed {SEED}, computed and stored in the same way. A rollout begins with positions
        and velocities alone. What exceeds its criterion is bold.
    """)
    models_section(text, found.models)
    for dimension, accuracy in found.accuracy.items():
        accuracy_section(text, dimension, accuracy)
    if found.prices:
        prices_section(text, found.prices)
    if found.gradients:
        gradients_section(text, found.gradients)
    if found.friction:
        friction_section(text, found.friction)
    if found.rest:
        rest_section(text, found.rest)
    if found.coverages or found.warnings:
        calibration_section(text, found.coverages, found.warnings)
    return text


def conclusion(found: Found) -> list[str]:
    """At most five sentences, each over all models."""
    sentences = []
    if found.accuracy:
        parts = [
            f"`{model}` {fronts_said(accuracy.of_kind(model, None))}"
            for accuracy in found.accuracy.values()
            for model in accuracy.scores
        ]
        sentences.append(f"Fronts of held-out scenes, free of walls, over the extent: {'; '.join(parts)}.")
    if found.prices:
        parts = [said(name, prices) for prices in found.prices.values() for name in prices.models]
        sentences.append(f"Error over seconds: {'; '.join(parts)}.")
    if found.gradients or found.friction:
        parts = [
            f"cosine {each.cosine:.3f} in {gradient.unknowns} velocities (`{each.method}`, {each.seconds:.2g} s)"
            for gradient in found.gradients
            for each in gradient.models
        ]
        parts += [
            f"front and profile answer to friction within {WITHIN:.0%} in {within(some, 'front')} and"
            f" {within(some, 'profile')} of {len(some)} columns (`{name}`)"
            for name, some in found.friction.items()
            if name in {model.name for model in found.models}
        ]
        sentences.append(f"Gradients beside the MPM's differences: {'; '.join(parts)}.")
    if any(each.scenes for each in found.rest.values()):
        parts = [
            f"{worst([each.creep for each in some]):+.2g} mm/s (`{name}`)"
            for still in found.rest.values()
            for name, some in still.rollouts.items()
        ]
        sentences.append(f"Deposits at rest creep by at most {', '.join(parts)}.")
    parts = [
        f"its {LEVEL:.0%} bands hold {each.share:.0%} of {each.fronts} fronts (`{name}`)"
        for name, each in found.coverages.items()
        if isinstance(each, Coverage)
    ]
    parts += [
        f"its card warns of {sum(each.outside.values())} of {len(each.outside)} scenes out of range and of"
        f" {len(each.false)} of {len(each.inside)} in range (`{name}`)"
        for name, each in found.warnings.items()
    ]
    if parts:
        sentences.append(f"What it knows of itself: {'; '.join(parts)}.")
    return sentences or ["Nothing was measured."]


def fronts_said(scores: Sequence[Score]) -> str:
    """Mean and worst front error of the scenes whose front is free."""
    free = [each.deposit.front for each in scores if not each.at_wall]
    profile = mean([each.deposit.transport for each in scores])
    if not free:
        return f"none is free, profile {profile:.1%}"
    return f"{mean(free):.1%} on average, worst {signed(worst(free))} of {len(free)}, profile {profile:.1%}"


def bold(text: str, whether: bool) -> str:
    """In Markdown."""
    return f"**{text}**" if whether else text


def percent(value: float, limit: float = inf) -> str:
    """0.0213 as 2.1 %, bold beyond `limit`; nan as -."""
    return "-" if np.isnan(value) else bold(f"{100.0 * value:.1f} %", abs(value) > limit)


def both(values: Sequence[float], limit: float = inf, extreme: float = inf) -> str:
    """Mean of the amounts and, in brackets, the worst with its sign; - of none."""
    if not values:
        return "-"
    return f"{percent(mean(values), limit)} ({bold(signed(worst(values)), abs(worst(values)) > extreme)})"


def models_section(text: Page, models: Sequence[Model]) -> None:
    """Sizes, resolution and training of the models, a column each."""
    facts: dict[str, Callable[[Model], str]] = {
        "dimension": lambda each: f"{each.settings.dimension}D",
        "parameters": lambda each: f"{sum(weight.numel() for weight in each.simulator.parameters()):,}",
        "cell": lambda each: f"{1000 * each.settings.cell:g} mm",
        "step": lambda each: f"{1000 * each.settings.step:g} ms",
        "cutoff radius": lambda each: f"{1000 * each.settings.radius:g} mm",
        "width x layers": lambda each: f"{each.settings.width} x {each.settings.layers}",
        "size of a body": lambda each: (
            f"{1000 * each.settings.body_length:.0f} mm" if each.settings.body_length else "as it is"
        ),
        "updates": lambda each: f"{each.updates:,}" if each.updates else "-",
        "data": lambda each: ", ".join(str(name) for name in each.provenance.get("datasets", ())) or "-",
    }
    text.section("The models")
    text.table([{"": name} | {f"`{each.name}`": fact(each) for each in models} for name, fact in facts.items()])
    text.text("Their cards, with the commands that made them, are beside their weights in `gns/weights`.")


def accuracy_section(text: Page, dimension: int, found: Accuracy) -> None:
    """Errors by kind of scene, and the reference's own."""
    mean_front, worst_front = FRONT[dimension]
    text.section(f"Held-out scenes in {dimension}D")
    text.text(f"""
        **Front**: the end of the deposit that the flow has moved farther, which 99.5 % of the particles are behind,
        without the scenes where the wall ahead holds it ("at the wall"), of which it says nothing; **profile**: rms
        distance along x of equal shares of the two deposits, of all scenes. Both over the deposit's extent; criteria:
        front {mean_front:.0%} on average{"" if worst_front == inf else f", {worst_front:.0%} at worst"}, profile
        {TRANSPORT:.0%} on average. **Energies**: largest difference over time over all energy at the start, above the
        lowest point of the flow; criterion {ENERGY:.0%} on average. Mean and, in brackets, worst. Seconds: of the
        reference on one core, its share of the wall time beside others times the cores; of a rollout, beside others.
        The worst profile's scene stands in the last column.
    """)
    kinds = list(dict.fromkeys(each.kind for each in found.scenes))
    for model in found.scores:
        text.table([kind_row(found, model, kind, dimension) for kind in [*kinds, *([ALL] if len(kinds) > 1 else [])]])
    text.picture(f"gns-held-out-{dimension}d.png", "errors of fronts and profiles by kind of scene")
    text.picture(f"gns-deposits-{dimension}d.png", "deposits of a scene of each kind")
    if found.finer:
        text.text(f"""
            The reference itself, {len(found.finer)} scenes: on cells half as large its fronts are
            {deposits_said(found.finer)}; with another jitter {deposits_said(found.jitter)}.
        """)
    if dimension == 3:
        text.text("""
            The impulse on baffles is not compared: a rollout has positions alone, and the momentum that it loses goes
            to floor, walls and baffles in shares that it does not give.
        """)


def kind_row(found: Accuracy, model: str, kind: str, dimension: int) -> Row:
    """The errors of a model on scenes of a kind."""
    chosen = [
        (scene, score)
        for scene, score in zip(found.scenes, found.scores[model], strict=True)
        if kind in (ALL, scene.kind)
    ]
    scores = [score for _, score in chosen]
    free = [each.deposit.front for each in scores if not each.at_wall]
    row: dict[str, object] = {
        f"`{model}`": kind,
        "scenes": len(scores),
        "at the wall": len(scores) - len(free),
        "front": both(free, *FRONT[dimension]),
        "profile": both([each.deposit.transport for each in scores], TRANSPORT),
        "kinetic energy": both([each.kinetic for each in scores], ENERGY),
        "potential energy": both([each.potential for each in scores], ENERGY),
    }
    if dimension == 3:
        depths = [each.depth for each in scores if each.depth is not None]
        row |= {
            "largest x": both([each.runout for each in scores if not each.at_wall], RUNOUT),
            "depth before baffles": both(depths, DEPTH),
        }
    return row | {
        "MPM [s]": f"{np.mean([each.mpm_seconds for each in scores]):.1f}",
        "rollout [s]": f"{np.mean([each.seconds for each in scores]):.2f}",
        "worst profile": max(chosen, key=lambda pair: pair[1].deposit.transport)[0].name,
    }


def deposits_said(found: Sequence[Deposit]) -> str:
    """How far deposits are apart."""
    fronts, profiles = [each.front for each in found], [each.transport for each in found]
    return (
        f"{percent(rms(fronts))} off (rms, worst {signed(worst(fronts))}) and its profiles {percent(rms(profiles))}"
        f" (worst {percent(worst(profiles))})"
    )


def prices_section(text: Page, found: Mapping[int, Prices]) -> None:
    """Error over seconds."""
    scenes = " and ".join(f"{each.scenes} in {dimension}D" for dimension, each in found.items())
    text.section("Error over seconds")
    text.text(f"""
        Held-out scenes and the shipped ones: {scenes}. Each by the MPM on cells that are a fraction of the smallest
        side of the body (single precision, step 0.9, until the deposit rests) and by the models, one after the other on
        one thread, without compilation. Error: the larger of the front's and the profile's, rms over the scenes,
        against the fine reference, whose own error bounds what can be seen at the right end.
    """)
    text.picture("gns-price.png", "error over seconds")
    for dimension, each in found.items():
        rows = [(f"MPM, {cells} cells across", point) for cells, point in each.mpm.items()]
        rows += [(f"`{name}`", point) for name, point in each.models.items()]
        text.table(
            [
                {f"{dimension}D": name, "seconds": f"{point.seconds:.3g}", "error": percent(point.error)}
                for name, point in rows
            ]
        )
        text.text("\n".join(f"- {said(name, each)}." for name in each.models))


def gradients_section(text: Page, found: Sequence[Gradients]) -> None:
    """Gradients in velocities."""
    text.section("Gradients in velocities")
    text.text(f"""
        The paper's ten layers, whole and each cut into ten blocks, at half of their true velocities; the gradient of
        the misfit of the whole deposit. Reference: central differences of the MPM on {found[0].cells} cells across the
        column, the mean over pairs of jitter seeds of run and target. The models' by automatic differentiation, against
        the MPM's target; beside it differences of one coarse run each. One thread.
    """)
    text.picture("gns-gradients.png", "cosine and length of gradients over seconds")
    for each in found:
        limit = CRITERIA.get(each.unknowns, -1.0)
        some = "" if each.compared == each.unknowns else f", compared in {each.compared} of them"
        text.text(
            f"{each.unknowns} unknowns{some}; one pair of seeds has a cosine of {each.own:.3f} to the mean of the"
            " others" + (f"; criterion {limit:g}." if limit > 0.0 else ".")
        )
        models = {model.method for model in each.models}
        text.table(
            [
                {
                    "gradient": f"`{one.method}`" if one.method in models else f"differences, {one.method}",
                    "seconds": f"{one.seconds:.3g}",
                    "cosine": bold(f"{one.cosine:.3f}", one.method in models and one.cosine < limit),
                    "length": f"{one.length:.2f}",
                }
                for one in [*each.models, *each.mpm]
            ]
        )


def friction_section(text: Page, found: Mapping[str, Sequence[Strengths]]) -> None:
    """Slopes with the angle of friction."""
    text.section("Slopes with the angle of friction")
    text.text(f"""
        Held-out columns of dry or weak sand. Strength: the derivative of front or profile with the angle along the
        MPM's, over the MPM's, which is that of central differences of {STEP_DEG:g}° on fine cells averaged over jitter
        seeds; criterion: 1 within {WITHIN:g}. The models' by automatic differentiation.
    """)
    text.table(
        [
            {"method": name}
            | {f"{what}: within": f"{within(some, what)} of {len(some)}" for what in OBSERVED}
            | {
                f"{what}: mean, least, most": "{:.2f}, {:.2f}, {:.2f}".format(
                    *(float(take([getattr(each, what) for each in some])) for take in (np.mean, min, max))
                )
                for what in OBSERVED
            }
            | {"seconds": f"{np.mean([each.seconds for each in some]):.2g}"}
            for name, some in found.items()
        ]
    )


def rest_section(text: Page, found: Mapping[int, Rest]) -> None:
    """Long rollouts."""
    text.section("Rest")
    text.text(f"""
        {" and ".join(f"{len(each.scenes)} scenes in {dimension}D" for dimension, each in found.items())} whose deposits
        come to rest, rolled out {rest.TIMES} times as long. Creep: speed of
        the faster end of the deposit over the second half; criterion {rest.CREEP:g} mm/s. Profile: rms distance that
        equal shares move, over the same time. Contained: no particle outside the box or inside a baffle in any frame.
    """)
    text.table(
        [
            {
                "model": f"`{name}`",
                "creep, mean [mm/s]": f"{mean([each.creep for each in some]):.3f}",
                "worst [mm/s]": bold(
                    f"{worst([each.creep for each in some]):+.3f}",
                    abs(worst([each.creep for each in some])) > rest.CREEP,
                ),
                "within": f"{sum(abs(each.creep) <= rest.CREEP for each in some)} of {len(some)}",
                "profile, worst [mm/s]": f"{worst([each.transport for each in some]):.3f}",
                "contained": f"{sum(each.contained for each in some)} of {len(some)}",
            }
            for still in found.values()
            for name, some in still.rollouts.items()
            if some
        ]
    )


def calibration_section(text: Page, coverages: Mapping[str, Coverage | str], warnings: Mapping[str, Warnings]) -> None:
    """Bands and warnings."""
    text.section("What it knows of itself")
    if coverages:
        low, high = COVERAGE
        text.text(f"""
            Bands of {LEVEL:.0%} (`gns.uncertainty`) on held-out fronts at larger x that no wall holds; criterion: they
            hold {low:.0%} to {high:.0%}.
        """)
        text.table([coverage_row(name, each) for name, each in coverages.items()])
    for name, each in warnings.items():
        text.text(
            f"The card of `{name}` warns of {sum(each.outside.values())} of {len(each.outside)} scenes out of range"
            f" (`validation/bench/surrogate/outside.py`){_listed(each.missed, 'not of')} and of {len(each.false)}"
            f" of {len(each.inside)} held-out scenes, which are in range{_listed(each.false, 'of')}."
        )


def coverage_row(name: str, each: Coverage | str) -> Row:
    """The coverage of a model, or why there is none."""
    if isinstance(each, str):
        return {"model": f"`{name}`", "fronts": "-", "inside": each, "half-width over the extent": "-"}
    outside = not COVERAGE[0] <= each.share <= COVERAGE[1]
    return {
        "model": f"`{name}`",
        "fronts": each.fronts,
        "inside": bold(f"{each.inside} ({each.share:.0%})", outside),
        "half-width over the extent": percent(each.width),
    }


def _listed(names: Sequence[str], how: str) -> str:
    return f" ({how}: {'; '.join(names)})" if names else ""
