"""`python -m validation.bench NAME --out DIR`: measure, print the tables, write the page."""

import importlib
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from datasets.command_line import run
from datasets.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Bench:
    """A page that can be measured: `module` has `bench(out, *, quick, keep)`, which returns the tables to print."""

    says: str
    module: str


BENCHES = {
    "contact": Bench(
        says="contact with baffles, terrain and plates: rest, sliding, leaks, smoothness",
        module="validation.bench.contact.bench",
    ),
    "experiments": Bench(
        says="measured experiments, forward with independently measured angles and backward from their fronts",
        module="validation.bench.experiments.bench",
    ),
    "case-history": Bench(
        says="the friction of a bed back-analysed from a runout at field scale",
        module="validation.bench.case_history.bench",
    ),
    "efficiency": Bench(
        says="cost and quality of a gradient by each method, on problems, over unknowns and over particles",
        module="validation.bench.efficiency.bench",
    ),
}


def command(
    name: str = "",
    /,
    *,
    out: Path | None = None,
    quick: bool = False,
    keep: Path | None = None,
    show: Annotated[bool, Parameter(name="--list", negative=())] = False,
) -> None:
    """Measure a page by its name, print its tables and write it into a folder.

    Parameters
    ----------
    name
        Of the page; `--list` shows them.
    out
        Folder for NAME.md and its pictures; without it the tables are printed alone.
    quick
        On coarse cells, to try the command; the figures mean little.
    keep
        Folder where finished runs stay, so that work that was cut short goes on; it must not hold runs of another
        version. Without it they go at the end.
    show
        List the names and end.
    """
    if show:
        print("\n".join(f"{each}: {bench.says}" for each, bench in BENCHES.items()))
        return
    if name not in BENCHES:
        raise InputError(f"expected the name of a page, one of {', '.join(BENCHES)}", where=name or "bench")
    began = time.perf_counter()
    print(importlib.import_module(BENCHES[name].module).bench(out, quick=quick, keep=keep))
    print(f"{time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    sys.exit(run(command, "python -m validation.bench"))
