"""`python -m validation.bench NAME --out DIR [--quick] [--keep DIR]`: measure, write the page, print its conclusion.

`--list` shows the names, `NAME --help` the flags of a page. Without `--keep` finished runs go at the end.
"""

import functools
import importlib
import inspect
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

from datasets.command_line import run
from datasets.errors import InputError
from datasets.lock import locked

COMMAND = "python -m validation.bench"


BENCHES = {
    "experiments": "measured experiments: forward with independently measured angles, backward from their fronts",
    "accuracy": "error over seconds of the MPM, whether --tolerance holds",
    "stability": "hard cases and exact solutions of the MPM; fronts over stiffness and step",
    "problems": "the shipped inverse problems, beside their criteria and the reference paper",
    "coverage": "how often the posterior of an inverse problem holds the truth, in twin experiments",
    "speed": "rates of the MPM over sizes, price of a gradient, a network's step, a large terrain",
    "gpu": "rates of the MPM over sizes and a network's step on a GPU, beside all processors",
    "efficiency": "price of a gradient by surrogate, adjoint and differences",
    "gns": "the shipped surrogates beside the MPM: error, price, bands, ranges",
}
"""Pages that can be measured, each by the module of its name, or the module `bench` of the package of its name."""


def bench_of(name: str) -> Callable[..., str]:
    """`bench(out: Path, *, quick: bool, keep: Path, ...)` of a page, imported when it is asked for.

    It measures, writes its page and pictures into `out`, and returns what is printed. quick: coarse cells or few runs,
    to try the command. keep: where finished runs stay, so that work that was cut short goes on. Further keywords with
    defaults are further flags.
    """
    module = importlib.import_module(f"validation.bench.{name}")
    if not hasattr(module, "bench") or inspect.ismodule(module.bench):
        module = importlib.import_module(f"validation.bench.{name}.bench")
    found: Callable[..., str] = module.bench
    return found


def command_of(bench: Callable[..., str]) -> Callable[..., None]:
    """`bench` as a command: keep is a folder that goes at the end unless it is given; what it returns is printed."""

    @functools.wraps(bench)
    def command(*, out: Path, quick: bool = False, keep: Path | None = None, **flags: Any) -> None:
        began = time.perf_counter()
        with TemporaryDirectory() if keep is None else locked(keep) as folder:
            print(bench(out, quick=quick, keep=Path(folder), **flags))
        print(f"{time.perf_counter() - began:.0f} s")

    from cyclopts import Parameter

    kept = Parameter(help="Folder of what is finished, which is not done again; it goes at the end unless given.")
    kinds = {"out": Annotated[Path, Parameter(help="Folder of the page and its pictures.")]}
    kinds |= {"keep": Annotated[Path | None, kept]}
    own = {each.name: each.replace(kind=each.KEYWORD_ONLY) for each in inspect.signature(bench).parameters.values()}
    own |= {name: own[name].replace(annotation=kind) for name, kind in kinds.items()}
    own |= {"quick": own["quick"].replace(default=False), "keep": own["keep"].replace(default=None)}
    command.__signature__ = inspect.Signature([*own.values()])  # type: ignore[attr-defined]
    command.__annotations__ |= kinds
    return command


def main(arguments: Sequence[str]) -> int:
    """Measure the page that the first argument names, and return the exit status."""
    name, *flags = arguments or ("",)

    def unknown() -> None:
        raise InputError(f"expected the name of a page, one of {', '.join(BENCHES)}", where=name or "bench")

    if name in ("--list", "--help", "-h"):
        print(__doc__, *(f"{each}: {summary}" for each, summary in BENCHES.items()), sep="\n")
        return 0
    if name not in BENCHES:
        return run(unknown, COMMAND, [])
    return run(command_of(bench_of(name)), f"{COMMAND} {name}", flags)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
