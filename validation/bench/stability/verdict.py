"""Cases and flows -> findings: every check that applies, in f32 and in f64."""

from collections.abc import Mapping
from dataclasses import dataclass

from datasets.command_line import WorkFailed
from datasets.trajectory import Trajectory
from mpm.arrays.layout import Precision
from validation.bench.stability import deposit
from validation.bench.stability.case import Case
from validation.bench.stability.finding import Finding
from validation.bench.stability.flows import Flow
from validation.bench.stability.invariants import INVARIANTS, energy, finite

PRECISIONS: tuple[Precision, ...] = ("f32", "f64")


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What the checks found of one row."""

    case: Case
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


def judge(case: Case, flows: Mapping[Precision, Mapping[str, Flow]], *, within: float = deposit.AGREEMENT) -> Verdict:
    """All findings of one row; `flows` by precision and by the name of the row.

    within: distance that may lie between the fronts in f32 and in f64 [cells].
    """
    findings: dict[Precision, tuple[Finding, ...]] = {}
    blown_up: dict[Precision, str] = {}
    for precision in PRECISIONS:
        flow = flows[precision][case.name]
        if isinstance(flow, WorkFailed):
            findings[precision], blown_up[precision] = (), str(flow)
            continue
        found = inspect(case, flow)
        if found[0].ok:
            beside = flows[precision].get(case.beside)
            if isinstance(beside, Trajectory):
                found += [compare(flow, beside) for compare in case.comparisons]
            double = flows["f64"][case.name]
            if precision == "f32" and isinstance(double, Trajectory) and finite(double).ok:
                found += [compare(flow, double) for compare in case.precisions]
                if not case.spalls:
                    found.append(deposit.agreement(flow, double, within=within))
        findings[precision] = tuple(found)
    return Verdict(case=case, findings=findings, blown_up=blown_up)


def inspect(case: Case, flow: Trajectory) -> list[Finding]:
    """What can be found of one trajectory alone; of one with NaN in it nothing but that."""
    numbers = finite(flow)
    if not numbers.ok:
        return [numbers]
    checks = [*(check for check in INVARIANTS if not (case.rings and check is energy)), *case.checks]
    if case.rests:
        checks += [deposit.rest, deposit.repose, deposit.volume]
    return [finding for check in checks if (finding := check(flow)) is not None]
