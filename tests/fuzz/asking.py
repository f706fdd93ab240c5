"""Hands hostile files to a worker process, and counts what came."""

import contextlib
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter, deque
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[2]
PATIENCE = 120.0
"""Seconds after which a worker hangs, however busy the machine is; it counts the seconds that it computes itself."""
MARK = "executed"
"""A file beside the case that its pickles would make."""
AHEAD = 32
"""Cases that the worker is given before the first of them is answered."""
START = 600.0
"""Seconds in which a worker must be ready."""


@dataclass
class Tally:
    """What came of the cases of one kind."""

    outcomes: Counter[str] = field(default_factory=Counter)
    slowest: float = 0.0
    largest: int = 0
    """Bytes above the start."""
    fallen: dict[str, tuple[str, bytes]] = field(default_factory=dict)
    """Where it fell -> what it said and the shortest file that did it."""

    def __str__(self) -> str:
        counts = ", ".join(f"{self.outcomes[name]} {name}" for name in ("accepted", "refused", "failed", "fell"))
        return (
            f"{self.outcomes.total():6d} cases: {counts}; at most {self.slowest:.2f} s, {self.largest / 2**20:.0f} MiB"
        )


@dataclass(frozen=True)
class Case:
    """A file that was handed over."""

    kind: str
    path: Path
    content: bytes


class Worker:
    """A worker process, begun anew where one died or hung; it is given some cases ahead, so that neither waits."""

    def __init__(self) -> None:
        self.process: subprocess.Popen[bytes] | None = None
        self.folder = tempfile.TemporaryDirectory(prefix="talus-fuzz-")
        self.tallies: dict[str, Tally] = {}
        self.waiting: deque[Case] = deque()
        self.answers = b""
        self.count = 0

    def ask(self, kind: str, name: str, content: bytes, beside: dict[str, bytes] | None = None) -> tuple[str, str]:
        """The outcome of a file of this name and content, with others `beside` it, and its line."""
        self.drain()
        self.hand_over(kind, name, content, beside)
        return self.next()

    def hand_over(self, kind: str, name: str, content: bytes, beside: dict[str, bytes] | None = None) -> None:
        """Ask for a file without waiting for the answer."""
        self.count += 1
        folder = Path(self.folder.name) / f"{kind}-{self.count}"
        folder.mkdir()
        for other, bytes_ in {**(beside or {}), name: content}.items():
            (folder / other).write_bytes(bytes_)
        case = Case(kind, folder / name, content)
        self.waiting.append(case)
        self.tell(case)
        if len(self.waiting) >= AHEAD:
            self.next()

    def drain(self) -> None:
        """Wait for all answers."""
        while self.waiting:
            self.next()

    def next(self) -> tuple[str, str]:
        """The next answer, counted: outcome and line. A worker that says nothing in time, or dies, fell."""
        case = self.waiting.popleft()
        line = self.line(PATIENCE)
        if line:
            answer = json.loads(line)
        else:
            status = None if self.process is None else self.process.poll()
            self.stop()
            said = "hung" if status is None else f"the process died with status {status}"
            answer = {"outcome": "fell", "text": said, "seconds": PATIENCE, "bytes": 0}
            for each in self.waiting:
                self.tell(each)
        shutil.rmtree(case.path.parent)
        tally = self.tallies.setdefault(case.kind, Tally())
        outcome, text = answer["outcome"], answer["text"]
        tally.outcomes[outcome] += 1
        tally.slowest = max(tally.slowest, answer["seconds"])
        tally.largest = max(tally.largest, answer["bytes"])
        if outcome == "fell":
            origin = text[text.rfind("(") :] if "(" in text else text[:40]
            known = tally.fallen.get(origin)
            if known is None or len(case.content) < len(known[1]):
                tally.fallen[origin] = (text, case.content)
        return outcome, text

    def tell(self, case: Case) -> None:
        """Hand a case to the process, a new one where there is none."""
        if self.process is None:
            self.start()
        assert self.process is not None
        assert self.process.stdin is not None
        question = json.dumps({"kind": case.kind, "path": str(case.path)}) + "\n"
        with contextlib.suppress(BrokenPipeError):  # it died: `next` says so
            self.process.stdin.write(question.encode())
            self.process.stdin.flush()

    def line(self, seconds: float) -> bytes:
        """The next line of the worker; empty where there is none in time."""
        assert self.process is not None
        assert self.process.stdout is not None
        end = time.monotonic() + seconds
        while b"\n" not in self.answers:
            ready, _, _ = select.select([self.process.stdout], [], [], max(0.0, end - time.monotonic()))
            piece = os.read(self.process.stdout.fileno(), 2**16) if ready else b""
            if not piece:
                return b""
            self.answers += piece
        line, _, self.answers = self.answers.partition(b"\n")
        return line

    def close(self) -> None:
        """End the worker, and its folder."""
        self.stop()
        self.folder.cleanup()

    def start(self) -> None:
        """A new worker, ready."""
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "2"}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tests.fuzz.worker"],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])},
        )
        self.answers = b""
        assert self.line(START), "the worker did not begin"

    def stop(self) -> None:
        """End the worker."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            for pipe in (self.process.stdin, self.process.stdout):
                if pipe is not None:
                    with contextlib.suppress(BrokenPipeError):
                        pipe.close()
            self.process = None
