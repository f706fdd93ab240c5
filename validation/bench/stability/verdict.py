"""Rows -> flows -> findings: every check that applies, in f32 and in f64; and of changed scenes, in f64."""

import dataclasses
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from datasets.command_line import WorkFailed
from datasets.measures import front
from datasets.scene import Domain, Scene
from datasets.trajectory import Trajectory
from mpm import LAST, WITH_FIELDS, simulate_each, simulate_many
from mpm.arrays.layout import Precision
from validation.bench.stability import deposit
from validation.bench.stability.finding import Finding
from validation.bench.stability.invariants import INVARIANTS, energy, finite
from validation.bench.stability.rows import Row

PRECISIONS: tuple[Precision, ...] = ("f32", "f64")

Flow = Trajectory | WorkFailed
"""The result of a scene: a trajectory with fields, or the message of a run that blew up."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What the checks found of one row."""

    row: Row
    findings: dict[Precision, tuple[Finding, ...]]
    """In f32, what was compared with f64 is among them."""
    blown_up: dict[Precision, str]
    """Messages of runs that gave no trajectory."""

    def green(self, precision: Precision) -> bool:
        """Whether all checks passed in one precision."""
        return precision not in self.blown_up and not self.failures(precision)

    @property
    def all_green(self) -> bool:
        """Whether all checks passed in both."""
        return all(self.green(precision) for precision in PRECISIONS)

    def failures(self, precision: Precision) -> list[Finding]:
        """The checks that did not pass."""
        return [finding for finding in self.findings[precision] if not finding.ok]

    def worst(self, check: str) -> Finding | None:
        """What a check found in the precision that did worse; None where it does not apply."""
        found = [finding for each in self.findings.values() for finding in each if finding.check == check]
        return max(found, key=lambda finding: (finding.excess, abs(finding.value)), default=None)


def simulate_scenes(
    scenes: Mapping[str, Scene], precision: Precision, until_rest: Collection[str] = ()
) -> dict[str, Flow]:
    """The result of each scene, with fields; those named in `until_rest` end when they rest.

    Each runs in the kernel that it would get alone (`mpm.simulate_each`).
    """
    flows: dict[str, Flow] = {}
    for ends in (False, True):
        group = {name: scene for name, scene in scenes.items() if (name in until_rest) is ends}
        if group:
            record = dataclasses.replace(WITH_FIELDS, until_rest=ends)
            outcomes = simulate_each(list(group.values()), precision=precision, record=record, progress=True)
            flows.update(zip(group, outcomes, strict=True))
    return flows


def front_scatter(scene: Scene) -> float:
    """Standard deviation of the front of `scene` over JITTERS jitters of its particles, in f64 [cells]."""
    jitters = [dataclasses.replace(scene, seed=scene.seed + number) for number in range(deposit.JITTERS)]
    fronts = [front(flow.positions[-1]) for flow in simulate_many(jitters, precision="f64", record=LAST)]
    return float(np.std(fronts, ddof=1)) / scene.domain.cell


def verdicts_of(rows: Sequence[Row]) -> list[Verdict]:
    """Run rows in both precisions and check them."""
    scenes = {row.name: row.scene for row in rows}
    until_rest = {row.name for row in rows if row.until_rest}
    flows = {precision: simulate_scenes(scenes, precision, until_rest) for precision in PRECISIONS}
    within = {row.name: deposit.DEVIATIONS * front_scatter(row.scene) for row in rows if row.sprays}
    return [verdict(row, flows, within=within.get(row.name, deposit.AGREEMENT)) for row in rows]


def verdict(row: Row, flows: Mapping[Precision, Mapping[str, Flow]], *, within: float = deposit.AGREEMENT) -> Verdict:
    """All findings of one row; `flows` by precision and by the name of the row.

    within: distance that may lie between the fronts in f32 and in f64 [cells].
    """
    findings: dict[Precision, tuple[Finding, ...]] = {}
    blown_up: dict[Precision, str] = {}
    for precision in PRECISIONS:
        flow = flows[precision][row.name]
        if isinstance(flow, WorkFailed):
            findings[precision], blown_up[precision] = (), str(flow)
            continue
        found = findings_of(row, flow)
        if found[0].ok:
            beside = flows[precision].get(row.beside)
            if isinstance(beside, Trajectory):
                found += [compare(flow, beside) for compare in row.comparisons]
            double = flows["f64"][row.name]
            if precision == "f32" and isinstance(double, Trajectory) and finite(double).ok:
                found += [compare(flow, double) for compare in row.precisions]
                if not row.spalls:
                    found.append(deposit.agreement(flow, double, within=within))
        findings[precision] = tuple(found)
    return Verdict(row=row, findings=findings, blown_up=blown_up)


def findings_of(row: Row, flow: Trajectory) -> list[Finding]:
    """What can be found of one trajectory alone; of one with NaN in it nothing but that."""
    numbers = finite(flow)
    if not numbers.ok:
        return [numbers]
    checks = [*(check for check in INVARIANTS if not (row.rings and check is energy)), *row.checks]
    if row.rests:
        checks += [deposit.rest, deposit.repose, deposit.volume]
    return [finding for check in checks if (finding := check(flow)) is not None]


@dataclass(frozen=True, kw_only=True)
class Variant:
    """A row whose scene was changed in one respect, in f64."""

    change: str
    verdict: Verdict


def half_step(scene: Scene) -> Scene:
    """The scene at half its step."""
    return dataclasses.replace(scene, step_fraction=0.5 * scene.step_fraction)


def half_cell(scene: Scene) -> Scene:
    """The scene on half its cell; in 3D as it is."""
    domain = Domain(size=scene.domain.size, cell=0.5 * scene.domain.cell)
    return dataclasses.replace(scene, domain=domain) if scene.dimension == 2 else scene


def without_correction(scene: Scene) -> Scene:
    """The scene without the volume correction that it has."""
    return dataclasses.replace(scene, volume_correction=False) if scene.remembers_gaps else scene


def variants(rows: Sequence[Row], change: str, changed: Callable[[Scene], Scene]) -> list[Variant]:
    """The rows whose scene `changed` changes, so changed, by themselves."""
    scenes = {row.name: changed(row.scene) for row in rows}
    scenes = {row.name: scenes[row.name] for row in rows if scenes[row.name] != row.scene}
    flows = simulate_scenes(scenes, "f64", {row.name for row in rows if row.until_rest})
    # A row that it is compared with was not changed: without it.
    alone = [dataclasses.replace(row, beside="", comparisons=(), precisions=()) for row in rows if row.name in flows]
    return [Variant(change=change, verdict=verdict(row, {"f32": flows, "f64": flows})) for row in alone]
