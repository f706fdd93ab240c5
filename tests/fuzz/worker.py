"""A process that reads hostile files: `python -m tests.fuzz.worker` takes a kind and a path a line, tells what came.

| outcome | when |
|---|---|
| `accepted` | it was read, and what can be run of it ran |
| `refused` | one line of an InputError |
| `failed` | one line of a WorkFailed: right input, and a flow that blew up |
| `fell` | anything else that was raised; more than 5 s or 1 GiB; something printed in many lines; something executed |

A process that takes longer than its time is ended by the one that asked (`tests.fuzz.asking`).
"""

import gc
import importlib
import io
import json
import os
import resource
import sys
import time
import traceback
import warnings
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

from datasets import memory
from datasets.command_line import WorkFailed
from datasets.errors import InputError
from tests.fuzz import seeds
from tests.fuzz.asking import MARK
from tests.fuzz.kinds import KINDS
from validation.report.measuring import peak, reset_peak, resident

MOST_MEMORY = 2**30
"""Bytes above the start."""
CEILING = 6 * 2**30
"""Bytes of addresses above the start, so that nothing takes the machine down."""
LONGEST_LINE = 2000
SLOWEST = {"simulated": 60.0}
"""Seconds that a case of a kind may compute, 5 unless it stands here: a kernel that is new is compiled."""
MODULES = (
    *("datasets.training.memory_mapped", "datasets.exchange.lagrangebench", "datasets.definitions", "gns.card"),
    *(
        "datasets.geometry.spatial",
        "datasets.geometry.overlaps",
        "datasets.geometry.surface",
        "datasets.geometry.masses",
    ),
    *("inverse.observations.reading", "mpm.simulation", "mpm.initial.stress", "meshio", "rasterio", "pydantic"),
)
"""All that the kinds import, before the first of them is timed."""


def main() -> None:
    """Answer each line of the standard input with one of JSON."""
    answers = sys.stdout
    for module in MODULES:
        importlib.import_module(module)
    seeds.state()
    seeds.new_run()
    # What is here stays: collecting garbage then looks at that of the cases alone.
    gc.collect()
    gc.freeze()
    limit = memory.address_space() + CEILING
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    # As on a small machine: what is larger must be refused by its size.
    memory.free = lambda: MOST_MEMORY  # type: ignore[assignment]
    warnings.simplefilter("ignore", FutureWarning)
    warnings.simplefilter("ignore", UserWarning)
    print(json.dumps({"outcome": "ready"}), file=answers, flush=True)
    for line in sys.stdin:
        asked = json.loads(line)
        path = Path(asked["path"])
        os.chdir(path.parent)
        printed = io.StringIO()
        reset_peak()
        before, begin = resident() or 0, time.process_time()
        with redirect_stdout(printed), redirect_stderr(printed):
            outcome, text = attempt(KINDS[asked["kind"]].read, path)
        seconds, extra = time.process_time() - begin, peak() - before
        if extra > MOST_MEMORY:
            outcome, text = "fell", f"took {memory.spoken(extra)}; {text}"
        if seconds > SLOWEST.get(asked["kind"], 5.0):
            outcome, text = "fell", f"took {seconds:.1f} s; {text}"
        if outcome != "fell" and ("\n" in text or len(text) > LONGEST_LINE):
            outcome, text = "fell", f"many lines: {text[:LONGEST_LINE]}"
        if outcome != "fell" and "Traceback" in printed.getvalue():
            outcome, text = "fell", printed.getvalue()[-LONGEST_LINE:]
        if (path.parent / MARK).exists():
            outcome, text = "fell", "executed what the file named"
        gc.collect()
        answer = {"outcome": outcome, "text": text, "seconds": seconds, "bytes": max(0, extra)}
        print(json.dumps(answer), file=answers, flush=True)


def attempt(read: object, path: Path) -> tuple[str, str]:
    """The outcome of a reading, and its line."""
    try:
        read(path)  # type: ignore[operator]
    except InputError as error:
        return "refused", str(error)
    except WorkFailed as error:
        return "failed", str(error)
    except BaseException as error:
        where = [f"{Path(f.filename).name}:{f.lineno}" for f in traceback.extract_tb(error.__traceback__)][-4:]
        return "fell", f"{type(error).__name__}: {str(error)[:200]} ({' < '.join(reversed(where))})".replace("\n", " ")
    return "accepted", ""


if __name__ == "__main__":
    main()
