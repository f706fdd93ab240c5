"""Fronts of half columns by other codes (`codes.toml`) and by ours on the same grids, by the default and by APIC."""

import dataclasses
import itertools
import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets.records import Record, from_mapping, read_toml
from mpm import AT_REST
from validation.bench.columns.collapse import half_column, measured
from validation.report.page import percent, signed
from validation.runs import Run, RunStore

PUBLISHED = Path(__file__).with_suffix(".toml")
ASPECTS = (0.5, 1.0, 2.0, 4.0, 8.0)
SEEDS = {16: 4, 32: 1}
"""Jitters by cells across the smaller of length and height; of columns higher than twice their length one."""
DEFAULT, APIC = "Talus AFLIP", "Talus APIC"
RELAXATION_TIMES = {DEFAULT: None, APIC: 0.0}
"""Of our transfers; None is the default."""

Fronts = Mapping[tuple[str, int, float], Sequence[float]]
"""(x - L) / L of 99.5 % of the particles, one per jitter, by code and transfer, cells and aspect ratio."""


@dataclass(frozen=True, kw_only=True)
class Code(Record):
    """Another code."""

    name: str
    repository: str
    commit: str
    settings: str


@dataclass(frozen=True, kw_only=True)
class Front(Record):
    """A column that came to rest in another code, in units of its length L."""

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


@dataclass(frozen=True, kw_only=True)
class OtherCodes(Record):
    """The contents of `codes.toml`."""

    codes: tuple[Code, ...]
    fronts: tuple[Front, ...]


def read_codes() -> OtherCodes:
    """Results of other codes."""
    return from_mapping(OtherCodes, read_toml(PUBLISHED))


def our_runs(aspects: Sequence[float], seeds: Mapping[int, int]) -> list[tuple[tuple[str, int, float], Run]]:
    """Our columns, each with its transfer, cells and aspect ratio."""
    return [
        (
            (name, cells, aspect),
            Run(scene=dataclasses.replace(half_column(aspect, cells, seed=seed), relaxation_time=time), record=AT_REST),
        )
        for (name, time), (cells, count), aspect in itertools.product(RELAXATION_TIMES.items(), seeds.items(), aspects)
        for seed in range(count if aspect <= 2.0 else 1)
    ]


def fronts_of_all(store: RunStore, *, quick: bool) -> Fronts:
    """Ours and those of the other codes. quick: low and coarse columns of ours, which the others did not run."""
    ours = our_runs(ASPECTS[:2], {5: 1, 8: 1}) if quick else our_runs(ASPECTS, SEEDS)
    flows = store.run([run for _, run in ours])
    every: Iterable[tuple[tuple[str, int, float], float]] = (
        *((key, measured(key[2], flow.positions[-1], None).front) for (key, _), flow in zip(ours, flows, strict=True)),
        *(((f"{each.code} {each.transfer}", each.cells, each.aspect), each.front) for each in read_codes().fronts),
    )
    found = defaultdict(list)
    for key, front in every:
        found[key].append(front)
    return dict(found)


def grids(fronts: Fronts) -> list[int]:
    """Cells on which ours ran, ascending."""
    return sorted({cells for name, cells, _ in fronts if name == DEFAULT})


def ratios(fronts: Fronts, name: str, other: str) -> dict[tuple[int, float], float]:
    """Mean fronts of `name` over those of `other`, less 1, by cells and aspect ratio, where both ran."""
    return {
        (cells, aspect): float(np.mean(values) / np.mean(fronts[other, cells, aspect])) - 1.0
        for (each, cells, aspect), values in fronts.items()
        if each == name and (other, cells, aspect) in fronts
    }


def front_rows(fronts: Fronts, cells: int) -> list[dict[str, str]]:
    """A row per code and transfer: fronts over the aspect ratio, and their difference from the default's."""
    rows: dict[str, dict[str, str]] = {}
    heads = [f"a = {aspect:g}" for aspect in sorted({aspect for *_, aspect in fronts})]
    for (name, grid, aspect), values in fronts.items():
        if grid == cells:
            scatter = f" ± {np.std(values, ddof=1):.2f}" if len(values) > 2 else ""
            off = None if name == DEFAULT else ratios(fronts, name, DEFAULT).get((cells, aspect))
            row = rows.setdefault(name, {"": name} | dict.fromkeys(heads, "-"))
            row[f"a = {aspect:g}"] = f"{np.mean(values):.2f}{scatter}" + ("" if off is None else f" ({signed(off)})")
    return list(rows.values())


def codes_conclusion(fronts: Fronts) -> str:
    """Our APIC beside that of other codes, and the default beside our APIC."""
    parts = []
    for name in dict.fromkeys(name for name, *_ in fronts if name.endswith(" APIC") and name != APIC):
        if off := ratios(fronts, APIC, name):
            cells, aspect = max(off, key=lambda key: abs(off[key]))
            parts.append(
                f"{APIC}'s fronts differ from {name}'s by {percent(math.sqrt(np.mean(np.square(list(off.values())))))}"
                f" rms over {len(off)} columns, {signed(off[cells, aspect])} at most (a = {aspect:g}, {cells} cells)"
            )
    fine = grids(fronts)[-1]
    own = {aspect: off for (cells, aspect), off in ratios(fronts, DEFAULT, APIC).items() if cells == fine}
    parts.append(
        f"the default's from our APIC's on {fine} cells by"
        f" {', '.join(f'{signed(off)} at a = {aspect:g}' for aspect, off in own.items())}"
    )
    return f"**Other codes**: {'; '.join(parts)}."
