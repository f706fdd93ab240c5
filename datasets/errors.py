"""The exceptions that mean "the input is wrong" or "the work failed", rather than "the program is wrong"."""

import difflib
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

LONGEST = 1000
"""Characters of what is said: a file may be anybody's, and what it has in place of a number may be long."""


class InputError(ValueError):
    """A user's mistake in one line: which file, which key, what was expected; exit status 2."""

    def __init__(self, message: str, *, where: str = "", key: str = "") -> None:
        self.message, self.where, self.key = shortened(message), where, key
        super().__init__(": ".join(shortened(part) for part in (where, key, message) if part))

    def at(self, where: str, key: str = "") -> "InputError":
        """The same mistake with the file it stands in, and with `key` where it names none."""
        return InputError(self.message, where=where, key=self.key or key)


class OutOfRange(InputError):
    """Known keys and right types, but a value, or values together, that cannot be."""


class WorkFailed(RuntimeError):
    """The input was right, the work did not succeed: exit status 1."""


@contextmanager
def naming(path: Path, key: str = "") -> Iterator[None]:
    """A mistake that the block finds, with the file `path` where it names no file, and with the key where none."""
    try:
        yield
    except InputError as error:
        raise error.at(error.where or str(path), key) from None


@contextmanager
def keyed(key: str) -> Iterator[None]:
    """A mistake that the block finds, with `key` before its own key where it names no file."""
    try:
        yield
    except InputError as error:
        raise error if error.where else type(error)(error.message, key=f"{key}.{error.key}".removesuffix(".")) from None


def require(ok: bool, key: str, expected: str, got: object = ..., *, where: str = "") -> None:
    """Raise InputError where `ok` does not hold of `key`; got: where there is more to say than what was expected."""
    if not ok:
        raise InputError(f"expected {expected}" + ("" if got is ... else f", got {got}"), where=where, key=key)


def suggestion(name: str, names: Collection[str]) -> str:
    """Which of the known names may be meant by one that is none of them: the nearest, otherwise any."""
    near = difflib.get_close_matches(name, names, n=1)
    return f"did you mean {near[0]!r}?" if near else f"one of {', '.join(names)}"


def shortened(text: str, most: int = LONGEST) -> str:
    """The first characters of a text, in one line."""
    text = " ".join(text.splitlines())
    return text if len(text) <= most else f"{text[:most]}..."
