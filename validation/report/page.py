"""Pages of figures in Markdown: a conclusion, the command and the machine, then text, tables and pictures."""

import textwrap
from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path

from tabulate import tabulate

from datasets.files import write_text
from validation.report.machine import MPM, machine

CONCLUSION = 5
"""Most sentences of a conclusion."""

Row = Mapping[str, object]
"""A row of a table: its cells by column heading, formatted where a format matters."""


def table(rows: Sequence[Row], *, formats: Mapping[str, str] | None = None) -> str:
    """`rows` as a Markdown table with the headings of the first row; empty without rows.

    formats: by heading, e.g. {"error [%]": ".1f"}; text and None stay as they are, None as an empty cell.
    """
    shown = [
        {
            head: format(cell, (formats or {})[head])
            if head in (formats or {}) and not isinstance(cell, str | None)
            else cell
            for head, cell in row.items()
        }
        for row in rows
    ]
    return tabulate(shown, headers="keys", tablefmt="pipe", disable_numparse=True) if shown else ""


class Page:
    """A page that is written once everything on it has been measured.

    Every sentence of the conclusion is made from the numbers of the page, never from a constant of its writer.
    """

    def __init__(
        self,
        title: str,
        *,
        command: str,
        conclusion: Sequence[str],
        packages: Mapping[str, str] = MPM,
        measured: str = "",
        quick: bool = False,
    ) -> None:
        """command: what measured the page. packages: those whose version matters, see `validation.report.machine`.

        measured: when and on what, of a page of kept measurements; today and here unless given.
        quick: the figures are of coarse cells or few runs, and the page says so.
        """
        if not 0 < len(conclusion) <= CONCLUSION:
            raise ValueError(f"expected one to {CONCLUSION} sentences of conclusion, got {len(conclusion)}")
        self._parts = [f"# {title}", "\n".join(f"- {sentence}" for sentence in conclusion)]
        self.text(f"`{command}`, {measured or f'{date.today().isoformat()}, on {machine(packages)}'}.")
        if quick:
            self.text("**Measured with `--quick`: the figures show that the command works, and little else.**")

    def section(self, title: str, *, level: int = 2) -> None:
        """Begin a section."""
        self._parts.append(f"{'#' * level} {title}")

    def text(self, text: str) -> None:
        """One or more paragraphs or lists; the indentation of a triple-quoted string goes, its line breaks stay."""
        self._parts.append(textwrap.dedent(text).strip())

    def table(self, rows: Sequence[Row], *, formats: Mapping[str, str] | None = None) -> None:
        """A table, see `table`."""
        self._parts.append(table(rows, formats=formats))

    def picture(self, name: str, caption: str) -> None:
        """A picture beside the page, by its file's name."""
        self._parts.append(f"![{caption}]({name})")

    def __str__(self) -> str:
        return "\n\n".join(part for part in self._parts if part) + "\n"

    def write(self, path: Path) -> None:
        """Write the page, beside its place and moved into it."""
        write_text(path, str(self))
