"""`python -m validation.bench stability`: hard cases, factors of safety, fronts over stiffness and step."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from datasets.errors import InputError, WorkFailed, suggestion
from datasets.files import read_toml
from datasets.flow.measures import front
from datasets.flow.trajectory import Trajectory
from datasets.scene import Scene
from datasets.scene.library import read_scene
from datasets.schema import Record, from_mapping
from mpm import LAST, WITH_FIELDS, simulate_each, simulate_many
from mpm.arrays.layout import Precision
from mpm.resolution import with_resolution
from validation.bench.accuracy.bench import own
from validation.bench.accuracy.flows import MeasuredFlow
from validation.bench.page import Out, Row, emphasised, percent, write_page
from validation.bench.stability import quantities, slopes
from validation.bench.stability.invariants import ALWAYS, DEPOSIT, Finding, finite

FOLDER = Path(__file__).parent
COLUMNS = {"energy": ("energy gained", ".0e"), "momentum": ("momentum error", ".0e")}
COLUMNS |= {"volume": ("volume", "+.1%"), "slope": ("slope [°]", ".1f")}
"""Check with its own column -> heading and format."""
ROWS = read_toml(FOLDER / "rows.toml")
RELEASED = {
    2: (MeasuredFlow(aspect=2.0, friction_deg=30.0, box=8.0), 10),
    3: (MeasuredFlow(aspect=1.0, friction_deg=30.0, depth=1.0, box=6.0, duration=5.0), 6),
}
"""Columns whose fronts are compared, and cells across them, by dimension."""
STIFFNESSES, STEPS = (1.0, 10.0, 100.0), (0.9, 0.3)
"""Young's moduli over 150 rho g H, and time steps over cell / wave speed."""
TRANSFERS = {"AFLIP, default": None, "APIC": 0.0}  # relaxation times of the transfer
Fronts = Mapping[tuple[int, float, float], Mapping[str, float]]
"""Fronts [m] by each transfer, by dimension, stiffness and step."""


@dataclass(frozen=True, kw_only=True)
class HardCase(Record):
    """A row of `rows.toml`."""

    name: str  # of the scene file
    what: str
    exact: bool = False  # whether its outcome is an exact solution
    rests: bool = False
    rings: bool = False
    until_rest: bool = False
    energy: float | None = None  # energy that it may gain, over the available one, if that is more than usual
    checks: tuple[dict[str, Any], ...] = ()
    """Checks of `quantities.py`: `quantity`, and those of its keys in `rows.toml` that differ here."""
    over: str = ""
    within: float = 0.0

    @property
    def scene(self) -> Scene:
        return read_scene(str(FOLDER / "hard_cases" / f"{self.name}.toml"))


@dataclass(frozen=True, kw_only=True)
class CheckedCase:
    """The findings of a row; for a run without a trajectory, only a message."""

    row: HardCase
    kept: tuple[Finding, ...] = ()  # invariants of every flow and every deposit
    own: tuple[Finding, ...] = ()
    blown_up: str = ""

    @property
    def failures(self) -> list[str]:
        return [self.blown_up] * bool(self.blown_up) + [str(check) for check in (*self.kept, *self.own) if not check.ok]


def read_rows(names: Sequence[str] = ()) -> list[HardCase]:
    """The rows of these names and those they are compared with; default: all. Raises InputError."""
    rows = {table["name"]: from_mapping(HardCase, table) for table in ROWS["rows"]}
    for name in names:
        if name not in rows:
            raise InputError(f"expected the name of a row: {suggestion(name, rows)}", where=name)
    chosen = {*names, *(rows[name].over for name in names)} if names else rows.keys()
    return [row for name, row in rows.items() if name in chosen]


def run(rows: Sequence[HardCase], precision: Precision) -> dict[str, Trajectory | WorkFailed]:
    """The flow of each row with fields, or the reason why there is none."""
    flows: dict[str, Trajectory | WorkFailed] = {}
    for ends in (False, True):
        group = {row.name: row.scene for row in rows if row.until_rest is ends}
        record = replace(WITH_FIELDS, until_rest=ends)
        if group:
            outcomes = simulate_each(list(group.values()), precision=precision, record=record, progress=True)
            flows.update(zip(group, outcomes, strict=True))
    return flows


def verdict(row: HardCase, flow: Trajectory | WorkFailed, other: Trajectory | WorkFailed | None = None) -> CheckedCase:
    """All findings of a row; for a flow with NaN, only that. other: the flow of the row `over`."""
    if isinstance(flow, WorkFailed):
        return CheckedCase(row=row, blown_up=str(flow))
    if not (numbers := finite(flow)).ok:
        return CheckedCase(row=row, kept=(numbers,))
    invariants = (*ALWAYS, *(DEPOSIT if row.rests else ()))
    kept = [finding for invariant in invariants if (finding := invariant(flow)) is not None]
    kept = [finding for finding in kept if not (row.rings and finding.check == "energy")]
    if row.energy is not None:
        kept = [replace(finding, maximum=row.energy) if finding.check == "energy" else finding for finding in kept]
    required = []
    for check in row.checks:
        keys = ROWS["quantities"][check["quantity"]] | check
        value = getattr(quantities, keys.pop("quantity"))(flow)
        required.append(Finding(value=value, **keys))
    if isinstance(other, Trajectory):
        value = front(flow.positions[-1], flow.volumes) / front(other.positions[-1], other.volumes)
        name = f"front over that of {row.over}"
        required.append(Finding(check=name, value=value, minimum=1.0 - row.within, maximum=1.0 + row.within))
    return CheckedCase(row=row, kept=tuple(kept), own=tuple(required))


def fronts() -> Fronts:
    """Fronts of the columns over stiffness and step."""
    scenes = {}
    for dimension, stiffness, step in itertools.product(RELEASED, STIFFNESSES, STEPS):
        flow, cells = RELEASED[dimension]
        scene = replace(flow, stiffness=stiffness * flow.stiffness).scene()
        scene = with_resolution(scene, own(cells, step_fraction=step))
        scenes[dimension, stiffness, step] = [replace(scene, relaxation_time=time) for time in TRANSFERS.values()]
    flows = iter(simulate_many([*itertools.chain(*scenes.values())], record=LAST, progress=True))
    return {key: {by: next(flows).summary["front"] for by in TRANSFERS} for key in scenes}


def front_changes(columns: Fronts) -> str:
    """The range of the fronts over their mean, by dimension, with the default transfer and with APIC."""
    changes = []
    for dimension in RELEASED:
        x = np.array([[*by.values()] for (size, *_), by in columns.items() if size == dimension])
        default, apic = map(percent, np.ptp(x, axis=0) / x.mean(axis=0))
        changes.append(f"{default} in {dimension}D (with APIC by {apic})")
    return ", ".join(changes)


def bench(*, out: Out, rows: tuple[str, ...] = (), precision: Precision = "f32") -> str:
    """Check every hard case, and measure factors of safety and fronts over stiffness and step.

    A red row makes the command fail, after the page is written.

    Args:
        rows: Names of rows of `rows.toml`; default: all.
        precision: Precision of the rows' runs.
    """
    chosen, columns, safety = read_rows(rows), fronts(), slopes.factors(slopes.KNOWN + slopes.WITHOUT_DILATION)
    flows = run(chosen, precision)
    verdicts = [verdict(row, flows[row.name], flows.get(row.over)) for row in chosen]
    said = write_page(
        out,
        "stability",
        conclusion(verdicts, columns, safety),
        flags=f" --precision {precision}",
        count=len(verdicts),
        precision=precision,
        cases=[row_of(case) for case in verdicts],
        safety=slopes.rows(safety),
        fronts=[
            {"": f"{dimension}D", "stiffness": f"{stiffness:g}", "step": f"{step:g}"}
            | {transfer: f"{x:.4f}" for transfer, x in by.items()}
            for (dimension, stiffness, step), by in columns.items()
        ],
    )
    if red := [f"{case.row.name}: {'; '.join(case.failures)}" for case in verdicts if case.failures]:
        raise WorkFailed("red rows: " + ". ".join(red))
    return said


def conclusion(verdicts: Sequence[CheckedCase], columns: Fronts, safety: slopes.Factors) -> list[str]:
    red = [case.row.name for case in verdicts if case.failures]
    exact = [not case.failures for case in verdicts if case.row.exact]
    kept = [finding for case in verdicts for finding in case.kept]
    rise, balance = (max(one.value for one in kept if one.check == check) for check in ("energy", "momentum"))
    return [
        f"{len(verdicts) - len(red)} of {len(verdicts)} hard cases pass{'; **red**: ' * bool(red)}{', '.join(red)}.",
        f"{sum(exact)} of {len(exact)} cases with an exact solution agree with it.",
        f"No flow gains more than {percent(rise)} of its energy; momentum and the impulses on walls and solids balance"
        f" within {balance:.0e}.",
        f"When the stiffness grows {STIFFNESSES[-1]:g} times and the step shrinks to a third, a front moves by"
        f" {front_changes(columns)}.",
        slopes.conclusion(safety),
    ]


def row_of(case: CheckedCase) -> Row:
    kept = {finding.check: finding for finding in case.kept}
    values = ", ".join(emphasised(f"{finding.value:.4g}", finding.ok) for finding in case.own)
    wrong = [case.blown_up, *(str(finding) for finding in case.kept if not finding.ok)]
    return {
        "scene": f"`{case.row.name}`: {case.row.what}",
        "required": "; ".join(f"{finding.check} {finding.range} {finding.unit}".strip() for finding in case.own),
        "found": "; ".join([values] * bool(values) + [f"**{text}**" for text in wrong if text]),
    } | {head: f"{kept[check].value:{form}}" if check in kept else "" for check, (head, form) in COLUMNS.items()}
