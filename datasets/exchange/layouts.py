"""The peers' layouts as values, and the folder that a conversion fills: its own, or none."""

import hashlib
import json
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from datasets.errors import InputError
from datasets.exchange import geoelements, lagrangebench
from datasets.exchange.common import Described, Particles, read_json
from datasets.exchange.foreign_npz import open_foreign_npz
from datasets.files import write_json

RECORD = "exchange.json"
"""What a conversion is from, and with which options; written first, so that the same command can finish it."""


@dataclass(frozen=True, kw_only=True)
class Layout:
    """How one of the peers lays out a dataset: a file per split and `metadata.json`."""

    name: str
    suffix: str
    """Ending of the file of a split."""
    write: Callable[[Path, Iterable[Particles]], None]
    """Write a split."""
    names: Callable[[Path], list[str]]
    """The trajectories of a split, in order."""
    read: Callable[[Path, Container[str]], Iterator[Particles]]
    """Those trajectories of a split whose names are asked for."""
    metadata: Callable[[Described], dict[str, Any]]
    """What `metadata.json` says of a dataset."""


LAYOUTS = {
    layout.name: layout
    for layout in (
        Layout(
            name="geoelements",
            suffix=geoelements.SUFFIX,
            write=geoelements.write,
            names=geoelements.names,
            read=geoelements.read,
            metadata=geoelements.metadata,
        ),
        Layout(
            name="lagrangebench",
            suffix=lagrangebench.SUFFIX,
            write=lagrangebench.write,
            names=lagrangebench.names,
            read=lagrangebench.read,
            metadata=lagrangebench.metadata,
        ),
    )
}


def begin(out: Path, record: dict[str, Any]) -> None:
    """Claim the folder `out` for the conversion that `record` describes.

    Raises InputError where it holds something else: nothing is overwritten.
    """
    place = out / RECORD
    if place.exists():
        if read_json(place) != json.loads(json.dumps(record)):
            raise InputError("expected the conversion that this folder was begun with, found another", where=str(place))
    elif out.exists() and (not out.is_dir() or any(path.name[0] != "." for path in out.iterdir())):
        raise InputError("expected an empty folder, or one that this conversion has begun", where=str(out))
    else:
        write_json(place, record)


def digest(paths: Sequence[Path], folder: Path) -> str:
    """A fingerprint of files in `folder`: of an NPZ from the checksums it states, of any other from all its bytes."""
    total = hashlib.sha256()
    for path in paths:
        if path.suffix == ".npz":
            with open_foreign_npz(path) as file:
                content = json.dumps(file.checksums)
        else:
            with path.open("rb") as raw:
                content = hashlib.file_digest(raw, "sha256").hexdigest()
        total.update(f"{path.relative_to(folder).as_posix()} {content}\n".encode())
    return total.hexdigest()
