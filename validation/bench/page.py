"""Pages of figures in Markdown: templates filled with a conclusion, the command, the machine and tables.

Also the flags that all pages share.
"""

import math
import os
import platform
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter
from cyclopts.validators import Number

from datasets.files import write_text
from datasets.markdown import markdown_table

Out = Annotated[Path, Parameter(help="Folder of the page and its pictures.")]
Keep = Annotated[Path | None, Parameter(help="Folder of finished work, which is reused; default: a temporary folder.")]
Many = Parameter(validator=Number(gte=1))  # a number of at least one
Rounds = Annotated[int, Many, Parameter(help="Number of repetitions; tables give median and range.")]
TEMPLATES = Path(__file__).parent / "pages"
CONCLUSION = 5  # most sentences of a conclusion
PACKAGES = {"Taichi": "taichi", "NumPy": "numpy", "PyTorch": "torch", "Numba": "numba"}
"""Name -> package with which Talus computes."""
CPUINFO = Path("/proc/cpuinfo")

Row = Mapping[str, object]  # a row of a table: its cells by column heading


def percent(fraction: float, form: str = ".2g") -> str:
    """0.0213 as 2.1 %; nan as -."""
    return "-" if math.isnan(fraction) else f"{100.0 * fraction:{form}} %"


def between(values: Collection[float], form: str) -> str:
    """From the smallest to the largest of some numbers."""
    low, high = format(min(values), form), format(max(values), form)
    return low if low == high else f"{low} to {high}"


def emphasised(text: str, ok: bool) -> str:
    """The text, bold unless `ok`."""
    return text if ok else f"**{text}**"


def tables(many: Iterable[Sequence[Row]]) -> str:
    """Tables one after the other, each with the headings of its first row; none without rows."""
    return "\n\n".join(markdown_table(rows) for rows in many if rows)


def formatted(rows: Iterable[Mapping[str, Any]], forms: Mapping[str, str]) -> list[Row]:
    """Rows with each number in the form of its column."""
    return [{key: format(cell, forms[key]) if key in forms else cell for key, cell in row.items()} for row in rows]


def write_page(
    out: Path, name: str, conclusion: Sequence[str], *, flags: str = "", **parts: Sequence[Row] | str | float
) -> str:
    """Write `out`/NAME.md, its template with the parts that it names, and return its conclusion, for the terminal.
    Every sentence of the conclusion comes from the numbers of the page, never from a constant of its writer. flags:
    flags with which the page was measured, today and here; parts: rows are written as a table."""
    if not 0 < len(conclusion) <= CONCLUSION:
        raise ValueError(f"expected one to {CONCLUSION} sentences of conclusion, got {len(conclusion)}")
    command, day = f"python -m validation.bench {name}{flags} --out docs", date.today().isoformat()
    written = {key: part if isinstance(part, (str, float, int)) else tables([part]) for key, part in parts.items()}
    written["conclusion"] = "\n".join(f"- {sentence}" for sentence in conclusion)
    written["made"] = f"`{command}`, {day}, on {machine()}."
    filled = (TEMPLATES / f"{name}.md").read_text(encoding="utf-8").format_map(written)
    # A part may be empty.
    write_text(out / f"{name}.md", re.sub(r"\n{3,}", "\n\n", filled).strip() + "\n")
    return str(written["conclusion"])


def machine() -> str:
    """Processor, cores and versions of the measurement, in a line."""
    features = " with AVX-512" if "avx512f" in cpuinfo("flags").split() else ""
    processor = cpuinfo("model name") or platform.processor() or platform.machine()
    versions = ", ".join(f"{name} {version(package)}" for name, package in PACKAGES.items())
    return f"{processor}{features}, {os.cpu_count()} cores; Python {platform.python_version()}, {versions}"


def cpuinfo(key: str) -> str:
    """The first value of `key` in Linux's description of its processors, empty elsewhere."""
    text = CPUINFO.read_text(encoding="utf-8") if CPUINFO.exists() else ""
    match = re.search(rf"^{key}\s*: (.*)$", text, re.MULTILINE)
    return "" if match is None else match[1].strip()
