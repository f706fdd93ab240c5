"""Measurements that stay on disk, so that an interrupted command goes on: one JSON file per kind of record."""

import dataclasses
import hashlib
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Generic, TypeVar

from datasets import __version__
from datasets.errors import InputError
from datasets.files import write_json
from datasets.records import Record, from_mapping

T = TypeVar("T", bound=Record)


def digest(*parts: Any) -> str:
    """The key of a record: of all that decides it, and of the version of this package."""
    return hashlib.sha256(repr((__version__, *parts)).encode()).hexdigest()[:16]


class Records(Generic[T]):
    """The records of one kind in a file, by their keys (`digest`). Every new one is written at once."""

    def __init__(self, path: Path, kind: type[T]) -> None:
        """Raises InputError, which names the file, for one that cannot be read."""
        self.path, self.found = path, dict[str, T]()
        if path.exists():
            try:
                self.found = {key: from_mapping(kind, each) for key, each in json.loads(path.read_text()).items()}
            except json.JSONDecodeError as error:
                raise InputError(f"expected JSON, {error}; delete it to begin anew", where=str(path)) from None
            except InputError as error:
                raise error.at(str(path)) from None

    def made(self, key: str, make: Callable[[], T]) -> T:
        """The record of a key; made and stored where there is none."""
        if key not in self.found:
            self.add([(key, make())])
        return self.found[key]

    def add(self, records: Iterable[tuple[str, T]]) -> None:
        """Store records under their keys."""
        self.found.update(records)
        write_json(self.path, {key: dataclasses.asdict(each) for key, each in self.found.items()})  # type: ignore[call-overload]
