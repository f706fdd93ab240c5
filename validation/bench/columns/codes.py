"""`python -m validation.bench codes`: fronts of columns beside those of other codes and of experiments."""

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets.records import Record, from_mapping, read_toml
from mpm import AT_REST
from validation.bench.columns.collapse import FRICTION_DEG, STEP, STIFFNESS, half_column, measured
from validation.bench.columns.laws import Law, aspect_axis, draw_laws, read_laws
from validation.report.page import Page, percent, signed
from validation.report.plots import figure
from validation.report.power_law import fit
from validation.runs import Run, RunStore

PUBLISHED = Path(__file__).with_suffix(".toml")
ASPECTS = (0.5, 1.0, 2.0, 4.0, 8.0)
SEEDS = {16: 4, 32: 1}
"""Jitters by cells across the smaller of length and height; at the highest aspect ratios one."""
DEFAULT, APIC = "Talus AFLIP", "Talus APIC"
RELAXATION_TIMES = {DEFAULT: None, APIC: 0.0}
"""Of our transfers; None is the default."""
LAW = "Lube et al. 2005, channel"
"""The experiments that fronts are compared with; exponents with those of Lajeunesse et al. too."""
BREAK = 2.0
"""Exponents are fitted to the aspect ratios up to and from here, three or more."""


@dataclass(frozen=True, kw_only=True)
class Code(Record):
    """Another code."""

    name: str
    repository: str
    commit: str
    settings: str


@dataclass(frozen=True, kw_only=True)
class Front(Record):
    """A column that came to rest, in units of its length L."""

    code: str
    transfer: str
    aspect: float
    """H / L."""
    cells: int
    """Across the smaller of L and H."""
    seed: int
    front: float
    """(x - L) / L of 99.5 % of the particles."""
    runout: float
    """The same of the furthest."""
    height: float
    """h / L at the axis."""

    @property
    def name(self) -> str:
        """Code and transfer."""
        return f"{self.code} {self.transfer}"


@dataclass(frozen=True, kw_only=True)
class OtherCodes(Record):
    """The contents of `codes.toml`."""

    codes: tuple[Code, ...]
    fronts: tuple[Front, ...]


def read_codes() -> OtherCodes:
    """Results of other codes."""
    return from_mapping(OtherCodes, read_toml(PUBLISHED))


@dataclass(frozen=True, kw_only=True)
class Fronts:
    """Fronts of all codes on all grids."""

    fronts: Sequence[Front]

    @property
    def cells(self) -> list[int]:
        """Grids on which we ran."""
        return sorted({each.cells for each in self.fronts if each.name == DEFAULT})

    @property
    def aspects(self) -> list[float]:
        """All aspect ratios."""
        return sorted({each.aspect for each in self.fronts})

    def names(self, cells: int) -> list[str]:
        """Codes and transfers on a grid."""
        return list(dict.fromkeys(each.name for each in self.fronts if each.cells == cells))

    def mean(self, name: str, cells: int, aspect: float) -> float:
        """The mean front over the jitters; nan of none."""
        return float(np.mean(fronts)) if (fronts := self.values(name, cells, aspect)) else math.nan

    def values(self, name: str, cells: int, aspect: float) -> list[float]:
        """The fronts of all jitters."""
        return [each.front for each in self.fronts if (each.name, each.cells, each.aspect) == (name, cells, aspect)]

    def ratios(self, name: str, other: str) -> dict[tuple[int, float], float]:
        """Fronts of `name` over those of `other`, less 1, by cells and aspect ratio, where both ran."""
        found = {
            (cells, aspect): self.mean(name, cells, aspect) / self.mean(other, cells, aspect) - 1.0
            for cells, aspect in itertools.product(self.cells, self.aspects)
        }
        return {key: ratio for key, ratio in found.items() if not math.isnan(ratio)}


def our_runs(aspects: Sequence[float], seeds: Mapping[int, int]) -> list[tuple[str, float, int, int, Run]]:
    """Transfer, aspect ratio, cells, jitter and run of each of our columns."""
    runs = []
    for (name, time), (cells, count), aspect in itertools.product(RELAXATION_TIMES.items(), seeds.items(), aspects):
        for seed in range(count if aspect <= BREAK else 1):
            scene = dataclasses.replace(half_column(aspect, cells, seed=seed), relaxation_time=time)
            runs.append((name, aspect, cells, seed, Run(scene=scene, record=AT_REST)))
    return runs


def bench(out: Path, *, quick: bool, keep: Path) -> str:
    """Fronts of half columns of aspect ratio 0.5 to 8 by AFLIP and by APIC: codes.md. quick: low and coarse ones."""
    runs = our_runs(ASPECTS[:2], {5: 1, 8: 1}) if quick else our_runs(ASPECTS, SEEDS)
    flows = RunStore(keep).run([run for *_, run in runs])
    ours = []
    for (name, aspect, cells, seed, _), flow in zip(runs, flows, strict=True):
        code, transfer = name.split()
        found = measured(aspect, flow.positions[-1], flow.summary["rest_time"])
        ours.append(
            Front(
                code=code,
                transfer=transfer,
                aspect=aspect,
                cells=cells,
                seed=seed,
                front=found.front,
                runout=found.runout,
                height=found.height,
            )
        )
    others = read_codes()
    return write(out, Fronts(fronts=[*ours, *others.fronts]), others.codes, quick=quick)


def write(out: Path, fronts: Fronts, codes: Sequence[Code], *, quick: bool = False) -> str:
    """Write codes.md and its picture, and return the conclusion."""
    laws = [law for law in read_laws() if (law.dimension, law.quantity) == (2, "runout")]
    page = Page(
        "Fronts of columns beside other codes",
        command="python -m validation.bench codes --out docs",
        conclusion=conclusion(fronts, laws),
        quick=quick,
    )
    page.text(f"""
        Half columns of length L and height a L in plane strain on a floor of the grains' own friction,
        {FRICTION_DEG:g}°; dry, undamped, E = {STIFFNESS:g} rho g H, step {STEP:g} of cell / wave speed, 2 particles per
        axis, no volume correction; until the kinetic energy is a thousandth of its largest. All codes have the same
        cells, particles and step. The front is that of 99.5 % of the particles, as (d - L) / L; per cents are against
        Talus' default. Cells are counted across the smaller of L and H.
    """)
    draw(out / "codes.png", fronts, laws)
    page.picture("codes.png", "fronts over the aspect ratio")
    for cells in fronts.cells:
        page.section(f"{cells} cells")
        rows = [front_row(fronts, name, cells) for name in fronts.names(cells)]
        rows += [law_row(fronts, law, cells) for law in laws if law.source == LAW and law.prefactor is not None]
        page.table(rows)
    page.section("Exponents")
    page.table(exponent_rows(fronts, laws))
    page.section("The other codes")
    for code in codes:
        page.text(f"- {code.name}: github.com/{code.repository} at `{code.commit[:10]}`. {code.settings}.")
    return page.write(out / "codes.md")


def conclusion(fronts: Fronts, laws: Sequence[Law]) -> list[str]:
    """What was found, each sentence from its numbers."""
    lines, coarse, fine = [], fronts.cells[0], fronts.cells[-1]
    for name in sorted({each.name for each in fronts.fronts if each.transfer == "APIC" and each.name != APIC}):
        if off := fronts.ratios(APIC, name):
            cells, aspect = max(off, key=lambda key: abs(off[key]))
            lines.append(
                f"The same transfer: {APIC}'s fronts differ from {name}'s by"
                f" {percent(math.sqrt(np.mean(np.square(list(off.values())))))} rms over {len(off)} columns, by"
                f" {signed(off[cells, aspect])} at most (aspect ratio {aspect:g}, {cells} cells)."
            )
    ratios = {aspect: ratio for (cells, aspect), ratio in fronts.ratios(DEFAULT, APIC).items() if cells == fine}
    lines.append(
        f"The default, AFLIP with a relaxation time, against our APIC on {fine} cells:"
        f" {', '.join(f'{signed(ratio)} at {aspect:g}' for aspect, ratio in ratios.items())}."
    )
    low = fronts.aspects[0]
    changes = [
        f"{name}'s {signed(fronts.mean(name, fine, low) / fronts.mean(name, coarse, low) - 1.0)}"
        for name in RELAXATION_TIMES
    ]
    lines.append(f"From {coarse} to {fine} cells the front at aspect ratio {low:g} moves: {', '.join(changes)}.")
    against = []
    for law in laws:
        known = [
            fronts.mean(DEFAULT, fine, aspect) / law.at(aspect) - 1.0 for aspect in fronts.aspects if law.holds(aspect)
        ]
        known = [value for value in known if not math.isnan(value)]
        if law.source == LAW and known:
            against.append(f"{signed(min(known))} to {signed(max(known))} from {law.formula}")
    if against:
        lines.append(f"Against {LAW} ({fine} cells): {', '.join(against)}.")
    return lines


def front_row(fronts: Fronts, name: str, cells: int) -> dict[str, str]:
    """Fronts of a code over the aspect ratio, with the difference from ours."""
    row = {"": name}
    for aspect in fronts.aspects:
        values, mean, ours = (
            fronts.values(name, cells, aspect),
            fronts.mean(name, cells, aspect),
            fronts.mean(DEFAULT, cells, aspect),
        )
        scatter = f" ± {np.std(values, ddof=1):.2f}" if len(values) > 2 else ""
        against = f" ({signed(mean / ours - 1.0)})" if name != DEFAULT and not math.isnan(ours) else ""
        row[f"a = {aspect:g}"] = f"{mean:.2f}{scatter}{against}" if values else "-"
    return row


def law_row(fronts: Fronts, law: Law, cells: int) -> dict[str, str]:
    """The same of a law of experiments."""
    row = {"": f"{law.source}: {law.formula}"}
    for aspect in fronts.aspects:
        off = law.at(aspect) / fronts.mean(DEFAULT, cells, aspect) - 1.0
        row[f"a = {aspect:g}"] = f"{law.at(aspect):.2f} ({signed(off)})" if law.holds(aspect) else "-"
    return row


def exponent_rows(fronts: Fronts, laws: Sequence[Law]) -> list[dict[str, str]]:
    """Exponents of the fronts over the aspect ratio by code, beside those of the experiments."""
    low, high = f"exponent, a up to {BREAK:g}", f"from {BREAK:g}"
    rows = []
    for name, cells in sorted({(each.name, each.cells) for each in fronts.fronts}):
        known = {aspect: fronts.mean(name, cells, aspect) for aspect in fronts.aspects}
        row = {"": f"{name}, {cells} cells"}
        for head, low_side in ((low, True), (high, False)):
            some = {
                a: front
                for a, front in known.items()
                if not math.isnan(front) and (a <= BREAK if low_side else a >= BREAK)
            }
            fitted = fit(np.array(list(some)), np.array(list(some.values()))) if len(some) > 2 else None
            row[head] = f"{fitted.exponent:.2f}" if fitted else "-"
        rows.append(row)
    for source in (LAW, "Lajeunesse et al. 2005, channel"):
        by_side = {law.high: f"{law.exponent:.2f}" for law in laws if law.source == source}
        rows.append({"": source, low: by_side.get(False, "-"), high: by_side.get(True, "-")})
    return rows


def draw(path: Path, fronts: Fronts, laws: Sequence[Law]) -> None:
    """Fronts over the aspect ratio, a pane per grid, a line per code, with the laws of the experiments."""
    styles = ("o-", "s-", "^--", "v--", "d:", "x:", "+:", "*:")
    with figure(path, columns=len(fronts.cells), size=(6.0, 4.6)) as axes:
        for axis, cells in zip(axes[0], fronts.cells, strict=True):
            for name, style in zip(fronts.names(cells), itertools.cycle(styles)):
                means = [fronts.mean(name, cells, aspect) for aspect in fronts.aspects]
                axis.plot(fronts.aspects, means, style, markersize=4, linewidth=1.0, label=name)
            draw_laws(axis, [law for law in laws if law.source == LAW])
            aspect_axis(axis, ticks=(0.5, 1, 2, 5, 10))
            axis.set(title=f"{cells} cells across the smaller side", ylabel="front (d - L) / L")
