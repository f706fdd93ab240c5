"""Tables in Markdown; the only module that imports tabulate."""

from collections.abc import Iterable, Sequence
from typing import Any

from tabulate import tabulate


def markdown_table(rows: Iterable[Any], headings: Sequence[str] = "keys", style: str = "pipe", **options: Any) -> str:
    """Rows as a table: mappings, or sequences with `headings`. Cells are text, unless tabulate's `options` differ."""
    return tabulate(rows, headings, style, **{"disable_numparse": True} | options)
