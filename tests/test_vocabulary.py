"""The words of the field: names that only we would understand are gone from the code, the keys and the pages."""

import io
import re
import tokenize
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("datasets", "gns", "inverse", "mpm", "tests", "validation")
GONE = {
    *("badness", "dams", "hair", "heap", "heaps", "hears", "hidden", "house"),
    *("judgement", "meet", "meets", "note", "pace", "peers", "reach", "reaches"),
    *("several", "solved", "taken", "told", "tells", "wanted", "worth"),
}
"""Words that no part of a name is made of."""
WHOLE = {"of", "strict"}
"""Words that are no names by themselves; in a longer name they may be the right ones (`least_squares`)."""
THEIRS = {"hidden", "hidden_layers", "needs_input_grad", "strict"}
"""Names of others: of a perceptron's layers, of autograd, of zip and of loading weights."""
PROSE = re.compile(
    r"\b(badness|dams|hair's|heaps?|hears|judgements?|told|worth|look around|who hears whom)\b", re.IGNORECASE
)
"""Words that no page and no docstring has either."""


def parts(name: str) -> set[str]:
    """`KeptRun_of` -> {kept, run, of}."""
    return {part.lower() for part in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)}


def private(text: str) -> list[str]:
    """Names of the code `text` that have gone words in them, and gone words in its strings and comments."""
    found = []
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.NAME and token.string not in THEIRS:
            if parts(token.string) & GONE or token.string.lower() in WHOLE or token.string == "Launch":
                found.append(f"{token.start[0]}: {token.string}")
        elif token.type in (tokenize.STRING, tokenize.COMMENT):
            found += [f"{token.start[0]}: {word}" for word in PROSE.findall(token.string)]
    return found


@pytest.mark.parametrize("folder", FOLDERS)
def test_names_are_those_of_the_field(folder: str) -> None:
    sources = [path for path in sorted((ROOT / folder).rglob("*.py")) if path != Path(__file__)]
    found = {str(path): private(path.read_text(encoding="utf-8")) for path in sources}
    assert {path: words for path, words in found.items() if words} == {}
    assert [path for path in sources if parts(path.stem) & (GONE | WHOLE)] == []


def test_pages_use_the_words_of_the_field() -> None:
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        text = path.read_text(encoding="utf-8")
        assert PROSE.findall(text) == [], path
        assert [name for name in re.findall(r"`([\w.]+)`", text) if parts(name) & GONE] == [], path


def test_a_private_word_is_seen() -> None:
    assert all(map(private, ["def told(): ...", "class Heap: ...", "of = 1", "x.reach", "# a heap", "GAP_REACH = 1"]))
