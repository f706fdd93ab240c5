"""`python -m validation.bench NAME --out DIR [--quick] [--keep DIR]`: measure, write the page, print its conclusion.

`--list` shows the names, `NAME --help` the flags of a page. Without `--keep` finished runs go at the end.
"""

import functools
import importlib
import inspect
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from datasets.command_line import run
from datasets.errors import InputError
from datasets.lock import locked

COMMAND = "python -m validation.bench"


@dataclass(frozen=True, kw_only=True)
class Bench:
    """A page that can be measured.

    `module` has `bench(out: Path, *, quick: bool, keep: Path, ...) -> str`, imported when it is called: it measures,
    writes its page and pictures into `out`, and returns what is printed. quick: coarse cells or few runs, to try the
    command. keep: where finished runs stay, so that work that was cut short goes on. Further keywords with defaults
    are further flags.
    """

    module: str
    summary: str


BENCHES = {
    "experiments": Bench(
        module="validation.bench.experiments",
        summary="measured experiments: forward with independently measured angles, backward from their fronts",
    ),
    "accuracy": Bench(
        module="validation.bench.accuracy.bench",
        summary="error over seconds of the MPM, whether --tolerance holds, columns beside the paper and other codes",
    ),
    "stability": Bench(
        module="validation.bench.stability.bench",
        summary="hard cases and exact solutions of the MPM; fronts over stiffness and step",
    ),
    "problems": Bench(
        module="validation.bench.problems",
        summary="the shipped inverse problems, beside their criteria and the reference paper",
    ),
    "coverage": Bench(
        module="validation.bench.coverage",
        summary="how often the posterior of an inverse problem holds the truth, in twin experiments",
    ),
    "speed": Bench(
        module="validation.bench.speed",
        summary="rates of the MPM over sizes, price of a gradient by the adjoint, a network's step",
    ),
    "efficiency": Bench(
        module="validation.bench.efficiency",
        summary="price of a gradient by surrogate, adjoint and differences; whole searches by each, and by Optuna",
    ),
    "gns": Bench(
        module="validation.bench.gns", summary="the shipped surrogates beside the MPM: error, price, bands, ranges"
    ),
}


def command_of(bench: Callable[..., str]) -> Callable[..., None]:
    """`bench` as a command: keep is a folder that goes at the end unless it is given; what it returns is printed."""

    @functools.wraps(bench)
    def command(*, out: Path, quick: bool = False, keep: Path | None = None, **flags: Any) -> None:
        began = time.perf_counter()
        with TemporaryDirectory() if keep is None else locked(keep) as folder:
            print(bench(out, quick=quick, keep=Path(folder), **flags))
        print(f"{time.perf_counter() - began:.0f} s")

    flags = [each.replace(kind=each.KEYWORD_ONLY) for each in inspect.signature(bench).parameters.values()]
    common = {"quick": (bool, False), "keep": (Path | None, None)}
    command.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [
            each.replace(annotation=common[each.name][0], default=common[each.name][1]) if each.name in common else each
            for each in flags
        ]
    )
    command.__annotations__["keep"] = Path | None
    return command


def main(arguments: Sequence[str]) -> int:
    """Measure the page that the first argument names, and return the exit status."""
    name, *flags = arguments or ("",)

    def unknown() -> None:
        raise InputError(f"expected the name of a page, one of {', '.join(BENCHES)}", where=name or "bench")

    if name in ("--list", "--help", "-h"):
        print(__doc__, *(f"{each}: {bench.summary}" for each, bench in BENCHES.items()), sep="\n")
        return 0
    if name not in BENCHES:
        return run(unknown, COMMAND, [])
    return run(command_of(importlib.import_module(BENCHES[name].module).bench), f"{COMMAND} {name}", flags)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
