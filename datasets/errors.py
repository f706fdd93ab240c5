"""The exceptions that mean "the input is wrong" or "the work failed", rather than "the program is wrong"."""

import difflib
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

LONGEST = 1000
"""Longest message in characters: the input may contain a very long text instead of a number."""


class InputError(ValueError):
    """A user's error in one line: the file, the key, the expected value; exit status 2."""

    def __init__(self, message: str, *, where: str = "", key: str = "") -> None:
        self.message, self.where, self.key = shortened(message), where, key
        super().__init__(": ".join(shortened(part) for part in (where, key, message) if part))

    def at(self, where: str, key: str = "") -> "InputError":
        """The same error with its file, and with `key` if it names no key."""
        return InputError(self.message, where=where, key=self.key or key)


class OutOfRange(InputError):
    """Known keys and right types, but an impossible value or combination of values."""


class WorkFailed(RuntimeError):
    """The input was right, but the work did not succeed: exit status 1."""


@contextmanager
def naming(path: Path, key: str = "") -> Iterator[None]:
    """Adds the file `path` and the key to an InputError of the block that names none."""
    try:
        yield
    except InputError as error:
        raise error.at(error.where or str(path), key) from None


@contextmanager
def keyed(key: str) -> Iterator[None]:
    """Puts `key` before the key of an InputError of the block that names no file."""
    try:
        yield
    except InputError as error:
        raise error if error.where else type(error)(error.message, key=f"{key}.{error.key}".removesuffix(".")) from None


def require(ok: bool, key: str, expected: str, got: object = ..., *, where: str = "") -> None:
    """Raise InputError for `key` unless `ok`; got: the actual value, if the message should contain it."""
    if not ok:
        raise InputError(f"expected {expected}" + ("" if got is ... else f", got {got}"), where=where, key=key)


def suggestion(name: str, names: Collection[str]) -> str:
    """The known names that an unknown name may mean: the nearest, otherwise all."""
    near = difflib.get_close_matches(name, names, n=1)
    return f"did you mean {near[0]!r}?" if near else f"one of {', '.join(names)}"


def shortened(text: str, most: int = LONGEST) -> str:
    """The first characters of a text, in one line."""
    text = " ".join(text.splitlines())
    return text if len(text) <= most else f"{text[:most]}..."
