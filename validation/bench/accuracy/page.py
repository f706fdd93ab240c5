"""Words of pages that are not yet written by `validation.report.page`."""

import textwrap

from validation.report.page import percent, signed

__all__ = ["paragraph", "percent", "signed"]


def paragraph(text: str) -> list[str]:
    """A paragraph in lines of Markdown, and the empty line after it."""
    return [*textwrap.wrap(" ".join(text.split()), 118), ""]
