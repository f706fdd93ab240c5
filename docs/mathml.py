"""A MkDocs hook: formulas become MathML, which browsers draw themselves; no script and no font is fetched."""

import html
import re
from typing import Any

from latex2mathml.converter import convert

FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)


def on_page_content(content: str, **_: Any) -> str:
    """`content`, with every formula that arithmatex marked as MathML."""

    def drawn(found: re.Match[str]) -> str:
        tag, opening, formula = found.groups()
        display = "block" if opening == "[" else "inline"
        return f'<{tag} class="formula">{convert(html.unescape(formula), display=display)}</{tag}>'

    return FORMULA.sub(drawn, content)
