"""`python -m validation.bench stability`: hard cases, a flume, factors of safety, fronts over stiffness and step."""

import difflib
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from datasets.errors import InputError, WorkFailed
from datasets.files import read_toml
from datasets.geometry.surface import surface_of
from datasets.library import read_scene
from datasets.measures import front
from datasets.records import Record, from_mapping
from datasets.scene import Scene
from datasets.trajectory import Trajectory
from mpm import LAST, WITH_FIELDS, simulate_each, simulate_many
from mpm.arrays.layout import Precision
from mpm.resolution import Resolution, with_resolution
from validation.bench.accuracy.flows import Flow
from validation.bench.stability import slopes
from validation.bench.stability.invariants import ALWAYS, DEPOSIT, Finding, finite
from validation.bench.stability.quantities import QUANTITIES
from validation.report.page import Page, emphasised, percent
from validation.report.plots import BLUE, INK, ORANGE, figure

FOLDER = Path(__file__).parent
COLUMNS = {"energy": "energy gained", "momentum": "momentum error", "volume": "volume", "slope": "slope [°]"}
"""Checks that have a column of their own."""
FLUME = "flume"
SHOWN = (0.4, 2.0)
"""Times of the flume in the picture [s]."""
STIFFNESSES, STEPS = (1.0, 10.0, 100.0), (0.9, 0.3)
"""Young's moduli over 150 rho g H, and steps over cell / wave speed."""
RELEASED = {
    2: (Flow(aspect=2.0, friction_deg=30.0, box=8.0), 10),
    3: (Flow(aspect=1.0, friction_deg=30.0, depth=1.0, box=6.0, duration=5.0), 6),
}
"""Columns whose fronts are compared, and cells across them, by dimension."""
TRANSFERS = {"AFLIP, default": None, "APIC": 0.0}
"""Relaxation times of the transfer."""


@dataclass(frozen=True, kw_only=True)
class Check(Record):
    """A quantity of `quantities.py`, with another range where one is given."""

    quantity: str
    minimum: float | None = None
    maximum: float | None = None

    def finding(self, flow: Trajectory) -> Finding:
        found = QUANTITIES[self.quantity](flow)
        return replace(
            found,
            minimum=found.minimum if self.minimum is None else self.minimum,
            maximum=found.maximum if self.maximum is None else self.maximum,
        )


@dataclass(frozen=True, kw_only=True)
class Row(Record):
    """A row of `rows.toml`."""

    name: str
    """Of the scene file."""
    what: str
    exact: bool = False
    """Whether its outcome is an exact solution."""
    rests: bool = False
    rings: bool = False
    until_rest: bool = False
    energy: float | None = None
    """Energy that it may gain, over the available one, where that is more than usual."""
    checks: tuple[Check, ...] = ()
    over: str = ""
    within: float = 0.0
    remark: str = ""

    @property
    def scene(self) -> Scene:
        return read_scene(str(FOLDER / "hard_cases" / f"{self.name}.toml"))


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What was found of a row; a run that gave no trajectory has a message alone."""

    row: Row
    kept: tuple[Finding, ...] = ()
    """What every flow, and every deposit, has to keep."""
    own: tuple[Finding, ...] = ()
    blown_up: str = ""

    @property
    def failures(self) -> list[str]:
        """What is wrong; empty for a green row."""
        return [self.blown_up] * bool(self.blown_up) + [str(each) for each in (*self.kept, *self.own) if not each.ok]


def read_rows(names: Sequence[str] = ()) -> list[Row]:
    """The rows of these names and those they are compared with; all where there are none. Raises InputError."""
    rows = {each["name"]: from_mapping(Row, each) for each in read_toml(FOLDER / "rows.toml")["rows"]}
    for name in names:
        if name not in rows:
            near = difflib.get_close_matches(name, rows, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"one of {', '.join(rows)}"
            raise InputError(f"expected the name of a row: {hint}", where=name)
    chosen = {*names, *(rows[name].over for name in names)} if names else rows.keys()
    return [row for name, row in rows.items() if name in chosen]


def run(rows: Sequence[Row], precision: Precision) -> dict[str, Trajectory | WorkFailed]:
    """The flow of each row with fields, or why there is none."""
    flows: dict[str, Trajectory | WorkFailed] = {}
    for ends in (False, True):
        group = {row.name: row.scene for row in rows if row.until_rest is ends}
        record = replace(WITH_FIELDS, until_rest=ends)
        if group:
            outcomes = simulate_each(list(group.values()), precision=precision, record=record, progress=True)
            flows.update(zip(group, outcomes, strict=True))
    return flows


def verdict(row: Row, flow: Trajectory | WorkFailed, other: Trajectory | WorkFailed | None = None) -> Verdict:
    """All findings of a row; of a flow with NaN in it nothing but that. other: the flow of the row `over`."""
    if isinstance(flow, WorkFailed):
        return Verdict(row=row, blown_up=str(flow))
    if not (numbers := finite(flow)).ok:
        return Verdict(row=row, kept=(numbers,))
    kept = [found for each in (*ALWAYS, *(DEPOSIT if row.rests else ())) if (found := each(flow)) is not None]
    if row.rings:
        kept = [each for each in kept if each.check != "energy"]
    if row.energy is not None:
        kept = [replace(each, maximum=row.energy) if each.check == "energy" else each for each in kept]
    own = [check.finding(flow) for check in row.checks]
    if isinstance(other, Trajectory):
        value = front(flow.positions[-1], flow.volumes) / front(other.positions[-1], other.volumes)
        name = f"front over that of {row.over}"
        own.append(Finding(check=name, value=value, minimum=1.0 - row.within, maximum=1.0 + row.within))
    return Verdict(row=row, kept=tuple(kept), own=tuple(own))


Fronts = Mapping[tuple[int, str, float, float], float]
"""Fronts [m] by dimension, transfer, stiffness and step."""


def fronts(dimensions: Sequence[int] = (2, 3)) -> Fronts:
    """Of the columns over stiffness and step, by each transfer."""
    scenes = {}
    for dimension, transfer, stiffness, step in itertools.product(dimensions, TRANSFERS, STIFFNESSES, STEPS):
        flow, cells = RELEASED[dimension]
        stiff = replace(flow, stiffness=stiffness * flow.stiffness).scene()
        chosen = Resolution(cells=cells, particles_per_axis=2, step_fraction=step, precision="f32")
        scene = replace(with_resolution(stiff, chosen), relaxation_time=TRANSFERS[transfer])
        scenes[dimension, transfer, stiffness, step] = scene
    flows = simulate_many(list(scenes.values()), record=LAST, progress=True)
    return {key: front(flow.positions[-1], flow.volumes) for key, flow in zip(scenes, flows, strict=True)}


def spread(found: Fronts, dimension: int, transfer: str) -> str:
    """Largest less smallest front over their mean."""
    some = [value for (*kind, _, _), value in found.items() if kind == [dimension, transfer]]
    return percent((max(some) - min(some)) / float(np.mean(some)))


def bench(out: Path, *, quick: bool, keep: Path, rows: tuple[str, ...] = (), precision: Precision = "f32") -> str:
    """Check every hard case, and write stability.md; what is wrong with a red row fails the command.

    quick: six short rows. keep: not used. rows: names of rows, all unless given. precision: of the rows.
    """
    chosen = read_rows(rows or (("one-point", "block-24", "block-35", "far-slow", "plate", FLUME) if quick else ()))
    found = fronts((2,) if quick else (2, 3))
    safety = (
        slopes.factors((slopes.TAYLOR,), (10,))
        if quick
        else slopes.factors(slopes.KNOWN + slopes.WITHOUT_DILATION, slopes.CELLS)
    )
    flows = run(chosen, precision)
    verdicts = [verdict(row, flows[row.name], flows.get(row.over)) for row in chosen]
    text = page(verdicts, found, safety, precision=precision, quick=quick)
    if isinstance(flume := flows.get(FLUME), Trajectory):
        draw(out / "stability.png", flume, found)
        text.picture("stability.png", "the flume; fronts of a column over its stiffness")
    text.write(out / "stability.md")
    if red := [each for each in verdicts if each.failures]:
        lines = [f"{each.row.name}: {'; '.join(each.failures)}" for each in red]
        raise WorkFailed("red rows: " + ". ".join(lines))
    return text.conclusion


def page(verdicts: Sequence[Verdict], found: Fronts, safety: slopes.Factors, *, precision: str, quick: bool) -> Page:
    said = conclusion(verdicts, found, safety)
    text = Page("Stability of the MPM", f"stability --precision {precision}", said, quick=quick)
    text.section("Hard cases")
    text.text(f"""
        {len(verdicts)} scenes (`validation/bench/stability/rows.toml`) in {precision}. **Required** is the row's own;
        of all rows: finite numbers, no particle outside the box or inside a baffle, no mass lost, and the limits of
        `validation/bench/stability/invariants.py` on the gain of energy, on the balance of momentum with the impulses
        on walls and solids (of undamped flows), and, of sand that has come to rest, on its volume and its slope against
        the angle of friction. What is wrong is bold.
    """)
    text.table([row_of(each) for each in verdicts])
    text.text("\n".join(f"- `{each.row.name}`: {each.row.remark}" for each in verdicts if each.row.remark))
    text.section("Factor of safety")
    text.text("""
        `python -m mpm.run SCENE --safety` over known factors of slopes on a rough floor, by cells over the height;
        seconds of each (`validation/bench/stability/slopes.py`). Charts and limit analysis let soil dilate by ψ = φ;
        without dilation the factor is not unique, sin φ / tan β the least of sand (Davis 1968).
    """)
    text.table(slopes.rows(safety))
    text.section("Stiffness and step")
    cells = " and ".join(f"{count} cells across in {dimension}D" for dimension, (_, count) in RELEASED.items())
    text.text(f"""
        Fronts [m] of dry columns of 30° with {cells}, Young's modulus over 150 rho g H, step over cell / wave speed.
        The default transfer is AFLIP with a relaxation time, APIC a relaxation time of 0 (`mpm/physics/transfer.py`).
    """)
    text.table(
        [
            {"": f"{dimension}D", "stiffness": f"{stiffness:g}", "step": f"{step:g}"}
            | {transfer: f"{found[dimension, transfer, stiffness, step]:.4f}" for transfer in TRANSFERS}
            for dimension, stiffness, step in dict.fromkeys((d, s, t) for d, _, s, t in found)
        ]
    )
    return text


def conclusion(verdicts: Sequence[Verdict], found: Fronts, safety: slopes.Factors) -> list[str]:
    red = [each.row.name for each in verdicts if each.failures]
    exact = [not each.failures for each in verdicts if each.row.exact]
    sliding = [each.own[0].value for each in verdicts if each.row.checks and each.row.checks[0].quantity == "slides"]
    off = max((abs(each - 1.0) for each in sliding), default=0.0)
    rise, balance = (
        max(found.value for each in verdicts for found in each.kept if found.check == check)
        for check in ("energy", "momentum")
    )
    own, other = TRANSFERS
    moved = [
        f"{spread(found, dimension, own)} in {dimension}D (by APIC {spread(found, dimension, other)})"
        for dimension in dict.fromkeys(dimension for dimension, *_ in found)
    ]
    return [
        f"{len(verdicts) - len(red)} of {len(verdicts)} hard cases hold{'; **red**: ' + ', '.join(red) if red else ''}."
        f" Of {len(exact)} with an exact solution {sum(exact)} agree with it.",
        *([f"Blocks slide down inclines as far as the closed form within {percent(off)}."] if sliding else []),
        f"No flow gains more than {percent(rise)} of its energy; momentum balances with the impulses on walls and"
        f" solids within {balance:.0e}.",
        f"Over {STIFFNESSES[-1]:g} times the stiffness and a third of the step a front moves by {', '.join(moved)}.",
        slopes.conclusion(safety),
    ]


def row_of(each: Verdict) -> dict[str, object]:
    known = {finding.check: finding for finding in each.kept}
    own = "; ".join(f"{found.check} {found.range} {found.unit}".strip() for found in each.own)
    value = ", ".join(emphasised(f"{found.value:.4g}", found.ok) for found in each.own)
    cells = {head: written(known[check]) if check in known else "" for check, head in COLUMNS.items()}
    rest = [str(found) for found in each.kept if not found.ok and found.check not in COLUMNS]
    wrong = [f"**{text}**" for text in (each.blown_up, *rest) if text]
    return {
        "scene": f"`{each.row.name}`",
        "what happens": each.row.what,
        "required": own,
        "found": "; ".join([value, *wrong] if value else wrong),
        **cells,
    }


def written(found: Finding) -> str:
    """A cell of what every flow keeps."""
    forms = {"volume": f"{100.0 * found.value:+.1f} %", "slope": f"{found.value:.1f}"}
    return emphasised(forms.get(found.check, f"{found.value:.0e}"), found.ok)


def draw(path: Path, flow: Trajectory, found: Fronts) -> None:
    """The flume at two times, the force on its end wall, and fronts over the stiffness."""
    scene, surface = flow.scene, surface_of(flow.scene)
    assert surface is not None
    assert flow.solid_impulse is not None
    with figure(path, rows=2, columns=2, size=(5.0, 3.0)) as axes:
        for column, time in enumerate(SHOWN):
            axis, frame = axes[0, column], int(np.abs(flow.time - time).argmin())
            for a, b in surface.corners:
                axis.plot([a[0], b[0]], [a[1], b[1]], color=INK, linewidth=1.0)
            axis.plot(flow.positions[frame, :, 0], flow.positions[frame, :, 1], ".", color=ORANGE, markersize=1.0)
            axis.set(xlim=(0.0, scene.domain.size[0]), ylim=(0.0, scene.domain.size[1]), aspect="equal")
            axis.set(title=f"flume, {flow.time[frame]:.2f} s", xlabel="x [m]", ylabel="y [m]")
        force, stiff = axes[1, 0], axes[1, 1]
        force.plot(flow.time[1:], np.diff(flow.solid_impulse[:, -1, 0]) / np.diff(flow.time), linewidth=1.0)
        force.set(title="flume", xlabel="time [s]", ylabel="force on the end wall [N/m]")
        for (transfer, colour), (step, style) in itertools.product(
            zip(TRANSFERS, (BLUE, ORANGE), strict=True), zip(STEPS, ("o-", "s--"), strict=True)
        ):
            values = [found[2, transfer, each, step] for each in STIFFNESSES]
            stiff.plot(STIFFNESSES, values, style, color=colour, markersize=4, label=f"{transfer}, step {step:g}")
        stiff.set(xscale="log", title="column in 2D", xlabel="E / (150 rho g H)", ylabel="front [m]")
        stiff.set_ylim(bottom=0.0)
        stiff.legend()
