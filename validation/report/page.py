"""Pages of figures in Markdown: a conclusion, the command and the machine, then text, tables and pictures."""

import math
import os
import platform
import textwrap
from collections.abc import Collection, Mapping, Sequence
from datetime import date
from importlib.metadata import version
from pathlib import Path

from tabulate import tabulate

from datasets.files import write_text

CONCLUSION = 5
"""Most sentences of a conclusion."""
MPM = {"Taichi": "taichi", "NumPy": "numpy"}
GNS = {"PyTorch": "torch", "Numba": "numba"}
"""What a part of Talus computes with, by name, and its package."""
CPUINFO = Path("/proc/cpuinfo")

Row = Mapping[str, object]
"""A row of a table: its cells by column heading."""


def percent(fraction: float) -> str:
    """0.0213 as 2.1 %; nan as -."""
    return "-" if math.isnan(fraction) else f"{100.0 * fraction:.2g} %"


def signed(fraction: float) -> str:
    """0.0213 as +2.1 %; nan as -."""
    return "-" if math.isnan(fraction) else f"{100.0 * fraction:+.1f} %"


def between(values: Collection[float], form: str) -> str:
    """From the smallest to the largest of some numbers."""
    low, high = format(min(values), form), format(max(values), form)
    return low if low == high else f"{low} to {high}"


def emphasised(text: str, ok: bool) -> str:
    """Bold where it is not."""
    return text if ok else f"**{text}**"


def rms(values: Collection[float]) -> float:
    """Root mean square; nan of none."""
    return math.sqrt(sum(value**2 for value in values) / len(values)) if values else math.nan


class Page:
    """A page that is written once everything on it has been measured.

    Every sentence of the conclusion is made from the numbers of the page, never from a constant of its writer.
    """

    def __init__(
        self, title: str, bench: str, conclusion: Sequence[str], *, packages: Mapping[str, str] = MPM, quick: bool
    ) -> None:
        """bench: name and flags of what measured the page, today and here. packages: those whose version matters.

        quick: the figures are of coarse cells or few runs, and the page says so.
        """
        if not 0 < len(conclusion) <= CONCLUSION:
            raise ValueError(f"expected one to {CONCLUSION} sentences of conclusion, got {len(conclusion)}")
        self.conclusion = "\n".join(f"- {sentence}" for sentence in conclusion)
        self._parts = [f"# {title}", self.conclusion]
        self.text(f"`python -m validation.bench {bench}`, {date.today().isoformat()}, on {machine(packages)}.")
        if quick:
            self.text("**Measured with `--quick`: the figures show that the command works, and little else.**")

    def section(self, title: str, *, level: int = 2) -> None:
        self._parts.append(f"{'#' * level} {title}")

    def text(self, text: str) -> None:
        """Paragraphs or lists; the indentation of a triple-quoted string is removed, its line breaks are kept."""
        self._parts.append(textwrap.dedent(text).strip())

    def table(self, rows: Sequence[Row]) -> None:
        """A table with the headings of the first row; none without rows."""
        self._parts.append(tabulate(rows, headers="keys", tablefmt="pipe", disable_numparse=True))

    def picture(self, name: str, caption: str) -> None:
        """A picture beside the page, by its file's name."""
        self._parts.append(f"![{caption}]({name})")

    def frozen(self, path: Path) -> None:
        """A section that was measured once and that no command measures again: the text of a Markdown file."""
        self._parts.append(path.read_text(encoding="utf-8").strip())

    def __str__(self) -> str:
        return "\n\n".join(part for part in self._parts if part) + "\n"

    def write(self, path: Path) -> str:
        """Write the page, beside its place and moved into it, and return its conclusion, for the terminal."""
        write_text(path, str(self))
        return self.conclusion


def machine(packages: Mapping[str, str] = MPM) -> str:
    """Processor, cores and versions in a line: what a figure was measured on."""
    features = " with AVX-512" if "avx512f" in cpuinfo("flags").split() else ""
    processor = cpuinfo("model name") or platform.processor() or platform.machine()
    versions = ", ".join(f"{name} {version(package)}" for name, package in packages.items())
    return f"{processor}{features}, {os.cpu_count()} cores; Python {platform.python_version()}, {versions}"


def cpuinfo(key: str) -> str:
    """The first value of `key` in Linux's description of its processors, empty elsewhere."""
    if not CPUINFO.exists():
        return ""
    lines = (line.partition(":") for line in CPUINFO.read_text(encoding="utf-8").splitlines())
    return next((value.strip() for name, _, value in lines if name.strip() == key), "")
