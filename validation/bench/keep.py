"""Flags that all pages share, and where finished work of a page stays."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

from cyclopts import Parameter

from datasets.lock import locked

Out = Annotated[Path, Parameter(help="Folder of the page and its pictures.")]
Keep = Annotated[
    Path | None, Parameter(help="Folder of finished work, which is not done again; temporary if not given.")
]


@contextmanager
def kept(folder: Path | None) -> Iterator[Path]:
    """The folder of finished work, held for this process, or a temporary one."""
    with TemporaryDirectory() if folder is None else locked(folder) as found:
        yield Path(found)
