"""`python -m validation.bench gpu`: rates of the MPM and a step of the network on a GPU, beside the processor."""

from dataclasses import replace
from functools import partial
from pathlib import Path

from datasets.errors import InputError
from datasets.processes import processors
from validation.bench.network import network_rows
from validation.bench.speed import Case, Mode, rate, rate_rows
from validation.report.measuring import Spread, turns
from validation.report.page import GNS, MPM, Page, between

CASES = (
    Case(dimension=2, cells=100, scenes=1, frames=200),
    Case(dimension=2, cells=100, scenes=64, frames=40),
    Case(dimension=2, cells=1770, scenes=1, frames=4),
    Case(dimension=3, cells=32, scenes=1, frames=100),
    Case(dimension=3, cells=32, scenes=64, frames=20),
    Case(dimension=3, cells=106, scenes=1, frames=20),
    Case(dimension=3, cells=212, scenes=1, frames=4),
)


def bench(out: Path, *, quick: bool, keep: Path, rounds: int = 2) -> str:
    """Measure rates over sizes and steps of the networks on a GPU, in turn with all processors of the same machine.

    Nothing is kept in KEEP. Raises InputError where there is no GPU.

    Parameters
    ----------
    quick
        A single frame of the small cases.
    rounds
        How often everything is measured, in turn; the tables give the median and the range.
    """
    from torch import cuda

    if not cuda.is_available():
        raise InputError("expected a GPU that torch can use, there is none", where="bench gpu")
    rounds = 1 if quick else rounds
    cases = [replace(each, frames=1) for each in CASES[:2]] if quick else CASES
    threads = processors()
    modes: list[Mode] = [("f32", threads), ("f32", 0), ("f64", 0)]
    timed = turns({(case, mode): partial(rate, case, mode) for mode in modes for case in cases}, rounds, "rates")
    rates = {key: Spread(found) for key, found in timed.items()}
    beside = [network_rows(rounds=rounds, sizes=1 if quick else 3, device=device) for device in ("cpu", "cuda")]
    gains = {case: rates[case, ("f32", 0)].median / rates[case, ("f32", threads)].median for case in cases}
    least, most = min(gains, key=gains.__getitem__), max(gains, key=gains.__getitem__)
    sizes = {case.dimension: case for case in sorted(cases, key=lambda case: rates[case, ("f32", 0)].median)}
    best = [f"{rates[case, ('f32', 0)].median:.0f} ({size}D)" for size, case in sorted(sizes.items())]
    on_cpu, on_gpu = ([float(row["µs per node"]) for row in rows] for rows in beside)
    said = [
        f"One {cuda.get_device_name()} makes up to {' and '.join(best)} million particle-steps a second:"
        f" {gains[least]:.1f} ({described(least)}) to {gains[most]:.1f} times ({described(most)}) what {threads}"
        " threads beside it make of the same scenes.",
        f"A step of the networks with its gradient takes {between(on_gpu, '.0f')} µs for each node there, the fewest"
        f" where there are the most nodes; {between(on_cpu, '.0f')} on one thread.",
    ]
    text = Page("Speed on a GPU", f"gpu --rounds {rounds}", said, packages=MPM | GNS, quick=quick)
    text.section("Million particle-steps a second of the MPM")
    text.text("""
        The scenes of [speed](speed.md), one or copies side by side, and a body of 4 million particles. Medians of
        rounds in turn, in brackets minimum and maximum. The transfer to and from the GPU is included, compilation not.
    """)
    text.table(rate_rows(rates))
    text.section("A step of the network")
    text.text("Seconds of one step, with its gradient with respect to the friction; the processor on one thread.")
    text.table([row | {f"GPU, {key}": other[key] for key in list(row)[2:]} for row, other in zip(*beside, strict=True)])
    return text.write(out / "gpu.md")


def described(case: Case) -> str:
    """The size of a case, for a sentence."""
    copies = "" if case.scenes == 1 else f"{case.scenes} scenes of "
    return f"{copies}{case.particles:,} particles in {case.dimension}D"
